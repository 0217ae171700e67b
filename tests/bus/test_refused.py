"""Who has no right certificate does not get in, and disturbs nobody who has one."""

import json
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zenoh

from robofleet.bus.bus import Subscription
from robofleet.bus.credentials import Credentials, session_id
from robofleet.bus.keys import STATUS
from robofleet.bus.permissions import UNIT, access_control
from robofleet.bus.zenoh_bus import Network, ZenohBus, open_router
from robofleet.core.clock import utc_now
from robofleet.hosts import authority as authorities
from robofleet.hosts.authority import ROUTER, Authority, identities
from tests.bus.contract import CLOCK, until
from tests.endpoints import free_port, own_endpoint

ARENA = "lab"
_GIVES_UP_MS = 800


class Lab(NamedTuple):
    """A router that other hosts reach, a robot that drives, and who hears it."""

    endpoint: str
    authority: Authority
    elsewhere: Authority  # of another arena
    robot: Callable[[bytes], None]  # what it says
    subscription: Subscription

    def hears_the_robot(self) -> bool:
        """Whether the robot's word still arrives."""
        payload = b"%d" % CLOCK.now_ns()
        return until(lambda: (self.robot(payload), self.subscription.take() == payload)[1])


@pytest.fixture(params=["tls", pytest.param("quic", marks=pytest.mark.slow)])
def lab(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Lab]:
    authority, elsewhere = (Authority.create(name, tmp_path / name) for name in (ARENA, "hall"))
    for keys in (authority, elsewhere):
        keys.issue(ROUTER, ROUTER, addresses=["127.0.0.1"])
        keys.issue("r1", UNIT)
    authority.issue("r2", UNIT)
    authority.issue("stolen", UNIT)
    authority.revoke("r2")
    authority.issue("r2", UNIT)
    local, beyond = own_endpoint(), f"{request.param}/127.0.0.1:{free_port()}"
    who = [keys for keys in identities(authority) if keys.name != "stolen"]  # as after its revocation
    network = Network([beyond], Credentials.at(authority.folder, ROUTER), access_control(ARENA, who))
    with closing(open_router(local, network)):
        certificate = authority.entries()["r1"].newest
        own = Credentials.at(authority.folder, "r1")
        with (
            closing(ZenohBus(ARENA, local, "supervisor", CLOCK)) as here,
            closing(ZenohBus(ARENA, beyond, "r1", CLOCK, credentials=own, session=session_id(certificate))) as robot,
        ):
            yield Lab(beyond, authority, elsewhere, robot.publisher(STATUS, "r1"), here.newest(STATUS, "r1"))


def opened(endpoint: str, own: Credentials | None, *, root: Path | None = None, **more: Any) -> zenoh.Session:
    """Open a session as a stranger may; raises where there is no link within a moment."""
    config = zenoh.Config()
    tls: dict[str, Any] = {"verify_name_on_connect": True}
    if root is not None or own is not None:
        tls["root_ca_certificate"] = str(root or own.authority)  # type: ignore[union-attr]
    if own is not None:
        tls |= {"connect_certificate": str(own.certificate), "connect_private_key": str(own.key), "enable_mtls": True}
    linked = f"{endpoint}?mixed_rel=1" if endpoint.startswith("quic/") else endpoint  # as the router says it
    settings = {
        "mode": "client", "connect/endpoints": [linked], "connect/timeout_ms": _GIVES_UP_MS,
        "scouting/multicast/enabled": False, "transport/link/tls": tls, **more,
    }  # fmt: skip
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


@pytest.mark.slow
def test_without_a_certificate_of_this_authority_there_is_no_link(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor without encryption, with a certificate that has ended, or to a router of another arena."""
    own, theirs = (Credentials.at(keys.folder, "r1") for keys in (lab.authority, lab.elsewhere))
    monkeypatch.setattr(authorities, "utc_now", lambda: utc_now() - timedelta(days=100))
    lab.authority.issue("old", UNIT, days=1)
    plain = lab.endpoint.replace("tls/", "tcp/").replace("quic/", "udp/")
    tried: list[tuple[str, Credentials | None, Path | None]] = [
        (lab.endpoint, None, own.authority),
        (lab.endpoint, theirs, own.authority),
        (lab.endpoint, Credentials.at(lab.authority.folder, "r2"), theirs.authority),
        (lab.endpoint, Credentials.at(lab.authority.folder, "old"), None),
        (plain, None, None),
    ]
    for endpoint, credentials, root in tried:
        with pytest.raises(zenoh.ZError):
            opened(endpoint, credentials, root=root).close()
        assert lab.hears_the_robot()


def test_nobody_takes_a_viewer_for_the_router_though_it_is_called_as_the_routers_host(lab: Lab) -> None:
    lab.authority.issue("localhost", "viewer")
    port, false = lab.endpoint.rpartition(":")[2], free_port()
    network = Network(
        [f"{lab.endpoint.partition('/')[0]}/localhost:{false}"], Credentials.at(lab.authority.folder, "localhost"),
        access_control(ARENA, identities(lab.authority)),
    )  # fmt: skip
    own = Credentials.at(lab.authority.folder, "r2")
    with closing(open_router(own_endpoint(), network)), pytest.raises(zenoh.ZError):
        opened(lab.endpoint.replace("127.0.0.1", "localhost").replace(port, str(false)), own).close()
    opened(lab.endpoint.replace("127.0.0.1", "localhost"), own).close()  # of the router itself
    assert lab.hears_the_robot()


def test_a_router_outside_the_networks_of_its_authority_is_not_believed(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a stolen authority may sign: for any address."""
    monkeypatch.setattr(Authority, "_refuse_not_permitted", lambda *_: None)
    for networks, believed in ((("10.0.0.0/8",), False), (("10.0.0.0/8", "127.0.0.0/8", "::1/128"), True)):
        monkeypatch.setattr(authorities, "_NETWORKS", networks)
        authority = Authority.create(ARENA, tmp_path / f"{len(networks)}")
        own = authority.issue("r1", UNIT)
        beyond = f"{lab.endpoint.partition('/')[0]}/127.0.0.1:{free_port()}"
        router = authority.issue(ROUTER, ROUTER, addresses=["127.0.0.1"])
        with closing(open_router(own_endpoint(), Network([beyond], router, access_control(ARENA, [])))):
            if believed:
                opened(beyond, own).close()
                continue
            with pytest.raises(zenoh.ZError):
                opened(beyond, own).close()


def test_an_old_tls_is_refused(lab: Lab) -> None:
    """QUIC has TLS 1.3 alone."""
    if lab.endpoint.startswith("tls/"):
        host, _, port = lab.endpoint.removeprefix("tls/").rpartition(":")
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        own = Credentials.at(lab.authority.folder, "r2")
        context.load_cert_chain(own.certificate, own.key)
        with pytest.warns(DeprecationWarning):
            context.maximum_version = ssl.TLSVersion.TLSv1_1
        with socket.create_connection((host, int(port)), timeout=5) as line, pytest.raises((ssl.SSLError, OSError)):
            context.wrap_socket(line)
    assert lab.hears_the_robot()


def test_a_copied_key_on_a_second_host_finds_its_place_taken(lab: Lab) -> None:
    own = Credentials.at(lab.authority.folder, "r1")
    session = session_id(lab.authority.entries()["r1"].newest)
    with pytest.raises(zenoh.ZError):
        opened(lab.endpoint, own, id=session).close()
    assert lab.hears_the_robot()
    with suppress(zenoh.ZError), closing(opened(lab.endpoint, own)) as copy:  # with an ID of its own it says nothing
        for _ in range(20):
            copy.put("rf/lab/unit/r1/status", b"a lie")
        assert lab.hears_the_robot()
        assert lab.subscription.take() != b"a lie"


def test_who_is_revoked_or_speaks_as_another_unit_says_nothing(lab: Lab) -> None:
    lines: list[str] = []
    for name in ("stolen", "r2"):
        own = Credentials.at(lab.authority.folder, name)
        session = session_id(lab.authority.entries()[name].newest)
        with closing(opened(lab.endpoint, own, id=session)) as stranger:
            for _ in range(20):
                stranger.put("rf/lab/unit/r1/status", b"a lie")
                stranger.put("rf/lab/unit/r1/cmd", b"a lie")
            assert lab.hears_the_robot()
            lines += [name] * (lab.subscription.take() == b"a lie")
    assert lines == []


@pytest.mark.slow
def test_the_link_of_a_certificate_that_ends_is_ended(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """A day's certificate that was made a day ago, but for some seconds."""
    monkeypatch.setattr(authorities, "utc_now", lambda: utc_now() - timedelta(days=1) + timedelta(seconds=4))
    lab.authority.issue("short", UNIT, days=1)
    own, certificate = Credentials.at(lab.authority.folder, "short"), lab.authority.entries()["short"].newest
    with closing(opened(lab.endpoint, own)) as ends:
        links = ends.info.routers_zid
        assert links()
        assert until(lambda: utc_now() > certificate.not_after, within_s=10)
        assert until(lambda: not links(), within_s=10)
    assert lab.hears_the_robot()

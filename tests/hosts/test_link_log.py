"""What the router's log says of links: who has come, and who was refused, whoever knocks how often."""

from contextlib import closing
from io import StringIO
from pathlib import Path

import pytest

from robofleet.bus.credentials import Credentials, session_id
from robofleet.bus.permissions import UNIT, access_control
from robofleet.bus.zenoh_bus import Network, ZenohBus, open_router
from robofleet.core.clock import MS, S, WallClock
from robofleet.hosts.authority import ROUTER, Authority, identities
from robofleet.hosts.link_log import FewLines, say_linked, say_refused
from tests.endpoints import free_port, own_endpoint

ANSI = "\x1b[2m2026-11-23T13:15:28.536023Z\x1b[0m \x1b[33m WARN\x1b[0m acc-0 ThreadId(04) \x1b[2m"
NO_CERTIFICATE = (
    f"{ANSI}zenoh_link_tls::unicast\x1b[0m\x1b[2m:\x1b[0m peer sent no certificates. "
    "Hint: increase the system open file limit.\n"
)
UNKNOWN = (
    f"{ANSI}zenoh_link_commons::quic::unicast\x1b[0m\x1b[2m:\x1b[0m QUIC acceptor failed: "
    'reason: "invalid peer certificate: UnknownIssuer" }) at /root/x/unicast.rs:120.\n'
)
OTHER = f"{ANSI}zenoh::net::routing\x1b[0m\x1b[2m:\x1b[0m Transport returned multiple network interfaces\n"


def said_of(lines: list[str], at_s: list[float]) -> list[str]:
    logged: list[str] = []
    times = iter(at_s)
    now = [0]

    def now_ns() -> int:
        return now[0]

    class Lines(StringIO):
        def __next__(self) -> str:
            line = super().__next__()
            now[0] = round(next(times) * 1e9)
            return line

    say_refused(Lines("".join(lines)), FewLines(logged.append, now_ns))
    return logged


def test_each_refused_link_is_said_with_its_reason_and_nothing_else_is() -> None:
    lines = said_of([NO_CERTIFICATE, OTHER, UNKNOWN], [1, 2, 3])
    assert lines == [
        "a link was refused: peer sent no certificates",
        'a link was refused: QUIC acceptor failed: reason: "invalid peer certificate: UnknownIssuer" })',
    ]


def test_a_flood_of_them_costs_twenty_lines_a_minute_and_is_counted() -> None:
    lines = said_of([NO_CERTIFICATE] * 1001, [1.0] * 1000 + [62.0])
    assert len(lines) == 20 + 1 + 1
    assert lines[20] == "980 more lines about links were left out"


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_who_links_is_named_by_its_certificate(protocol: str, tmp_path: Path) -> None:
    clock, lines = WallClock(), list[str]()
    authority = Authority.create("lab", tmp_path / "keys")
    authority.issue(ROUTER, ROUTER, addresses=["127.0.0.1"])
    for name in ("r1", "stolen"):
        authority.issue(name, UNIT)
    known = [who for who in identities(authority) if who.name != "stolen"]  # as after its revocation
    beyond = f"{protocol}/127.0.0.1:{free_port()}"
    network = Network([beyond], Credentials.at(authority.folder, ROUTER), access_control("lab", known))

    def linked(name: str, session: str | None) -> ZenohBus:
        return ZenohBus(
            "lab", beyond, name, clock, credentials=Credentials.at(authority.folder, name), session=session
        )  # fmt: skip

    def hears(line: str) -> bool:
        end_ns = clock.now_ns() + 5 * S
        while not any(text.startswith(line) for text in lines) and clock.now_ns() < end_ns:
            clock.sleep_until(clock.now_ns() + 5 * MS)
        return any(text.startswith(line) for text in lines)

    own = session_id(authority.entries()["r1"].newest)
    with closing(open_router(own_endpoint(), network)) as router:
        router.info.declare_link_events_listener(say_linked(network.permitted, lines.append), history=True)
        with closing(linked("r1", own)):
            assert hears(f"r1 has come, from {protocol}/127.0.0.1:")
        assert hears("r1 has gone")
        with closing(linked("r1", None)):
            assert hears(f"a second host with the certificate of r1, {protocol}/127.0.0.1:")
        with closing(linked("stolen", None)):
            assert hears(f"stolen is revoked, or unknown: from {protocol}/127.0.0.1:")

"""The authority of an arena: whom its certificates let in by TLS, and what its register remembers."""

import ssl
import stat
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import pytest

from robofleet.bus.credentials import KINDS, Credentials, KeysError, session_id
from robofleet.bus.permissions import ROLES, UNIT
from robofleet.core.clock import utc_now
from robofleet.hosts import authority as authorities
from robofleet.hosts.authority import Authority, identities

ADDRESS = "192.168.1.10"


@pytest.fixture
def lab(tmp_path: Path) -> Authority:
    """Return an arena's authority, with a router and a robot."""
    made = Authority.create("lab", tmp_path / "lab", hosts=["lab.example"])
    made.issue("router", "router", addresses=[ADDRESS, "lab.example"])
    made.issue("r1", "unit")
    return made


def at(lab: Authority, name: str) -> Credentials:
    return Credentials.at(lab.folder, name)


def context(protocol: int, own: Credentials | None, trusted: Path) -> ssl.SSLContext:
    made = ssl.SSLContext(protocol)
    made.check_hostname = protocol == ssl.PROTOCOL_TLS_CLIENT
    made.verify_mode = ssl.CERT_REQUIRED
    made.verify_flags |= ssl.VERIFY_X509_STRICT  # as Python 3.13 does by itself
    made.load_verify_locations(trusted)
    if own is not None:
        made.load_cert_chain(own.certificate, own.key)
    return made


def shaken(router: Credentials, unit: Credentials | None, address: str = ADDRESS, trusted: Path | None = None) -> str:
    """Return the common name by which a router knows who joins; SSLError where either side refuses."""
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = context(ssl.PROTOCOL_TLS_SERVER, router, router.authority).wrap_bio(up, down, server_side=True)
    trusts = trusted or (router if unit is None else unit).authority
    client = context(ssl.PROTOCOL_TLS_CLIENT, unit, trusts).wrap_bio(down, up, server_hostname=address)
    for side in (client, server, client, server):
        with suppress(ssl.SSLWantReadError):
            side.do_handshake()
    certificate = server.getpeercert()
    assert certificate is not None
    ((name,),) = certificate["subject"]
    return str(name[1])


@pytest.mark.parametrize("address", [ADDRESS, "lab.example", "127.0.0.1", "localhost"])
def test_router_and_unit_know_each_other_by_tls(lab: Authority, address: str) -> None:
    assert shaken(at(lab, "router"), at(lab, "r1"), address) == "r1"


def test_a_router_is_known_by_its_addresses_alone(lab: Authority) -> None:
    with pytest.raises(ssl.SSLCertVerificationError, match="IP address mismatch"):
        shaken(at(lab, "router"), at(lab, "r1"), "192.168.1.11")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("router", "web")])
def test_only_the_router_and_the_page_are_servers(lab: Authority, kind: str) -> None:
    """Whatever else is called as the host is called, and whatever address it asks for."""
    lab.issue("localhost", kind, addresses=[ADDRESS])
    assert shaken(at(lab, "router"), at(lab, "localhost")) == "localhost"
    for address in (ADDRESS, "localhost"):
        with pytest.raises(ssl.SSLCertVerificationError, match="unsuitable certificate purpose"):
            shaken(at(lab, "localhost"), at(lab, "r1"), address)


def test_the_router_is_nobodys_client_and_the_page_is_both(lab: Authority) -> None:
    lab.issue("web", "web", addresses=["192.168.1.11"])
    assert shaken(at(lab, "web"), at(lab, "r1"), "192.168.1.11") == "r1"
    assert shaken(at(lab, "router"), at(lab, "web")) == "web"
    with pytest.raises(ssl.SSLError, match="unsuitable certificate purpose"):
        shaken(at(lab, "web"), at(lab, "router"), "192.168.1.11")


@pytest.mark.parametrize(
    "address", ["example.com", "8.8.8.8", "2001:4860:4860::8888", "lab", "notlocal", "xlab.example"]
)
def test_an_authority_is_believed_for_private_networks_alone(lab: Authority, address: str) -> None:
    """Whoever has its key: what it signs for others is refused by who trusts it, as browsers do."""
    with pytest.raises(KeysError, match=f"`robofleet keys init lab --address {address}`"):
        lab.issue("web", "web", addresses=["192.168.1.11", address])
    assert "web" not in lab.entries()
    with pytest.MonkeyPatch.context() as stolen:
        stolen.setattr(Authority, "_refuse_not_permitted", lambda *_: None)
        lab.issue("web", "web", addresses=[address])
    with pytest.raises(ssl.SSLCertVerificationError, match="permitted subtree violation"):
        shaken(at(lab, "web"), at(lab, "r1"), address)


@pytest.mark.parametrize(
    "address", ["10.1.2.3", "172.16.0.9", "100.64.0.1", "169.254.7.7", "fd00::1", "fe80::1", "pi1.local", "lab.lan",
                "a.b.internal", "x.home.arpa", "localhost"],
)  # fmt: skip
def test_a_page_on_a_private_network_is_believed(lab: Authority, address: str) -> None:
    lab.issue("web", "web", addresses=[address])
    assert shaken(at(lab, "web"), at(lab, "r1"), address) == "r1"


def test_an_authority_is_believed_for_what_it_was_made_for(tmp_path: Path) -> None:
    made = Authority.create("lab", tmp_path / "lab", hosts=["lab.example.edu", "198.51.100.7", "2001:db8::7"])
    made.issue("r1", "unit")
    for number, address in enumerate(("lab.example.edu", "198.51.100.7", "2001:db8::7", "page.lab.example.edu")):
        made.issue(f"web{number}", "web", addresses=[address])
        assert shaken(at(made, f"web{number}"), at(made, "r1"), address) == "r1"
    with pytest.raises(KeysError, match=r"198\.51\.100\.8: the authority of lab signs for private networks alone"):
        made.issue("other", "web", addresses=["198.51.100.8"])


def test_nobody_joins_without_a_certificate(lab: Authority) -> None:
    with pytest.raises(ssl.SSLError, match="PEER_DID_NOT_RETURN_A_CERTIFICATE"):
        shaken(at(lab, "router"), None)


def test_nobody_joins_by_the_authority_of_another_arena_or_of_another_lab(lab: Authority, tmp_path: Path) -> None:
    for arena, folder in (("hall", "hall"), ("lab", "other")):
        other = Authority.create(arena, tmp_path / folder)
        stranger = other.issue("r1", "unit")
        with pytest.raises(ssl.SSLCertVerificationError):  # it believes this router, and the router does not believe it
            shaken(at(lab, "router"), stranger, trusted=lab.folder / "authority.pem")
        with pytest.raises(ssl.SSLCertVerificationError):
            shaken(at(lab, "router"), stranger)


def test_nobody_joins_by_a_certificate_that_has_ended(lab: Authority, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as earlier:
        earlier.setattr(authorities, "utc_now", lambda: utc_now() - timedelta(days=10))
        lab.issue("late", "unit", days=9)
        lab.issue("early", "unit", days=11)
    assert shaken(at(lab, "router"), at(lab, "early")) == "early"
    with pytest.raises(ssl.SSLCertVerificationError, match="certificate has expired"):
        shaken(at(lab, "router"), at(lab, "late"))


def test_private_keys_are_their_owners_alone(tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    folder.mkdir(mode=0o755)
    lab = Authority.create("lab", folder)
    lab.issue("r1", "unit")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {file.name: stat.S_IMODE(file.stat().st_mode) for file in folder.iterdir()} == dict.fromkeys(
        ("authority.key", "authority.pem", "register.json", "r1.key", "r1.pem", "r1.json"), 0o600
    )


def test_each_revocation_gives_the_next_certificate_another_name(lab: Authority) -> None:
    for common_name in ("r1", "r1#2", "r1#3"):
        opened = Authority("lab", lab.folder)  # the register remembers
        assert shaken(at(lab, "router"), at(lab, "r1")) == common_name
        assert [identity.common_name for identity in identities(opened)] == [common_name]
        opened.revoke("r1")
        assert not at(lab, "r1").key.exists()
        assert identities(Authority("lab", lab.folder)) == []
        opened.issue("r1", "unit")


def test_a_renewed_certificate_has_the_same_name_and_life_and_a_key_of_its_own(lab: Authority) -> None:
    lab.issue("page", "web", addresses=[ADDRESS], days=7)
    before, key = lab.entries()["page"].newest, at(lab, "page").key.read_bytes()
    lab.renew("page")
    after = lab.entries()["page"].newest
    assert (after.common_name, after.addresses) == (before.common_name, (ADDRESS,))
    assert abs((after.not_after - after.not_before) - (before.not_after - before.not_before)) < timedelta(minutes=1)
    assert at(lab, "page").key.read_bytes() != key
    assert session_id(after) != session_id(before)
    lab.renew("page", days=30)
    assert timedelta(days=29) < lab.entries()["page"].newest.not_after - utc_now() < timedelta(days=31)


def test_no_certificate_outlives_its_authority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lab = Authority.create("lab", tmp_path, days=5)
    lab.issue("r1", "unit")
    assert lab.entries()["r1"].newest.not_after - utc_now() <= timedelta(days=5)
    monkeypatch.setattr(authorities, "utc_now", lambda: utc_now() + timedelta(days=2000))
    with pytest.raises(
        KeysError, match=r"this computer's clock says .*, and the authority of lab ended on .*: set the c"
    ):
        lab.renew("r1")
    assert lab.entries()["r1"].newest.not_after < utc_now() + timedelta(days=6)


@pytest.mark.parametrize(
    "address",
    ["quic/10.0.0.1:7447", "10.0.0.1:7447", "10.0.0.256", "10.0.0", "müller", "a b", "-lab", "lab.", "", "a" * 254],
)
def test_what_is_no_address_is_refused(lab: Authority, address: str) -> None:
    with pytest.raises(KeysError, match="write a host's IP address or name alone"):
        lab.issue("page", "web", addresses=[ADDRESS, address])
    assert "page" not in lab.entries()


@pytest.mark.parametrize("name", ["authority.pem", "authority.key", "register.json"])
def test_a_damaged_authority_is_named(lab: Authority, name: str) -> None:
    (lab.folder / name).write_text("{")
    with pytest.raises(KeysError, match="the authority of lab is damaged: take its folder from a backup"):
        Authority("lab", lab.folder)


def test_kinds_are_those_to_whom_something_is_permitted() -> None:
    assert {*KINDS} == {UNIT, authorities.ROUTER, *ROLES}

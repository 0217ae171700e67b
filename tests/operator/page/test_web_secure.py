"""The operator's page beyond this computer: TLS by the arena's authority, an address for each browser, two roles."""

import os
import re
import socket
import ssl
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import InvalidStatus

from robofleet.operator.page import one_time_token
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.connection_limiter import MOST
from tests.operator.page.secureweb import HOST, Visitor, keys_in, trusting
from tests.operator.page.webstand import WebStand, web_stand

ANSWERED_WITHIN_S = 5.0
GONE_WITHIN_S = 20.0
USED = "This address has opened its page already"
STRANGER = "This browser is not logged in"
COOKIE = r"__Host-robofleet-(\d+)=([0-9a-f]{32}); HttpOnly; Path=/; SameSite=strict; Secure"

Comes = Callable[..., Visitor]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the keys."""
    return tmp_path_factory.mktemp("keys")


@pytest.fixture(scope="module")
def keys(folder: Path) -> PageKeys:
    return keys_in(folder)


@pytest.fixture
def stand(keys: PageKeys, tmp_path: Path) -> Iterator[WebStand]:
    with web_stand(tmp_path, "tracker.source=truth", host=HOST, keys=keys) as stand:
        yield stand


@pytest.fixture
def comes(stand: WebStand, folder: Path) -> Iterator[Comes]:
    """Return somebody's browser, which has opened an address."""
    with ExitStack() as opened:

        def come(address: str = "", trusts: ssl.SSLContext | None = None) -> Visitor:
            visitor = Visitor(stand, trusts or trusting(folder))
            opened.callback(visitor.client.close)
            if address:
                assert visitor.enter(address).status_code == 200
            return visitor

        yield come


def is_worded(response: httpx.Response, title: str) -> bool:
    return response.status_code == 403 and f"<h1>{title}</h1>" in response.text


def is_bare(response: httpx.Response) -> bool:
    return (response.status_code, response.content) == (403, b"")


def end_of(stand: WebStand) -> tuple[str, int]:
    host, port = stand.authority.split(":")
    return host, int(port)


def test_a_browser_that_knows_the_authority_is_sure_whose_page_it_is(stand: WebStand, comes: Comes) -> None:
    assert stand.url.startswith(f"https://{HOST}:")
    assert comes(stand.url).client.get("/").status_code == 200
    with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        comes("", ssl.create_default_context()).client.get("/")


def test_another_arenas_authority_is_not_this_ones(stand: WebStand, comes: Comes, tmp_path: Path) -> None:
    keys_in(tmp_path / "other", arena="other")
    with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        comes("", trusting(tmp_path / "other")).client.get("/")


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("version", "is_taken"),
    [(ssl.TLSVersion.TLSv1_3, True), (ssl.TLSVersion.TLSv1_2, True), (ssl.TLSVersion.TLSv1_1, False)],
)
def test_an_older_tls_is_refused(stand: WebStand, folder: Path, version: ssl.TLSVersion, is_taken: bool) -> None:
    context = trusting(folder)
    with pytest.warns(DeprecationWarning) if not is_taken else ExitStack():
        context.minimum_version = context.maximum_version = version
    context.set_ciphers("DEFAULT:@SECLEVEL=0")
    with socket.create_connection(end_of(stand)) as client, ExitStack() as refused:
        if not is_taken:
            refused.enter_context(pytest.raises(ssl.SSLError))
        with context.wrap_socket(client, server_hostname=HOST) as secured:
            assert secured.version() == {"TLSv1_3": "TLSv1.3", "TLSv1_2": "TLSv1.2"}[version.name]


@pytest.mark.parametrize(
    "opening", [b"GET / HTTP/1.1\r\nHost: {host}\r\n\r\n", b"\x00" * 100, b"\x16\x03\x01\x00\x05hello"]
)
def test_what_is_not_tls_gets_a_closed_connection_and_disturbs_nobody(
    stand: WebStand, comes: Comes, opening: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    visitor = comes(stand.addresses.viewer)
    capfd.readouterr()
    with visitor.page() as page, socket.create_connection(end_of(stand), timeout=GONE_WITHIN_S) as client:
        client.sendall(opening.replace(b"{host}", stand.authority.encode()))
        assert client.recv(4096) == b""
        page.say(do="hold")
        assert page.next("answer")["ok"]
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("refused (1 so far): a connection of 127.0.0.1: no TLS: ")


@pytest.mark.slow
def test_half_open_handshakes_delay_nobody_and_are_closed_and_a_page_that_has_left_is_missed_by_nobody(
    stand: WebStand, comes: Comes, caplog: pytest.LogCaptureFixture
) -> None:
    visitor = comes(stand.url)
    with visitor.page() as page:
        assert page.heard_one()["type"] == "hello"
    with ExitStack() as opened:
        clients = [
            opened.enter_context(socket.create_connection(end_of(stand), timeout=GONE_WITHIN_S))
            for _ in range(MOST + 50)
        ]
        for client in clients[::2]:
            client.sendall(b"\x16\x03\x01\x02\x00\x01\x00")  # the first bytes of a handshake, and no more
        for _ in range(3):
            fresh = comes()
            assert fresh.client.get("/page.js", timeout=ANSWERED_WITHIN_S).status_code == 200
        assert visitor.post("/estop").json()["to"] == "estop"
        assert b"estop" in stand.requests
        assert all(client.recv(4096) == b"" for client in clients), (
            "their time is over, and so is that of the page before"
        )
    assert [record.getMessage() for record in caplog.records if record.name == "asyncio"] == []


def test_an_address_opens_the_page_in_one_browser(stand: WebStand, comes: Comes) -> None:
    first, second = comes(), comes()
    entered = first.enter(stand.url)
    assert re.fullmatch(COOKIE, entered.headers["set-cookie"])
    assert f"-{end_of(stand)[1]}=" in entered.headers["set-cookie"], "each run's page has a cookie of its own"
    assert first.client.get("/").status_code == 200
    refused = second.enter(stand.url)
    assert is_worded(refused, USED)
    assert "set-cookie" not in refused.headers
    assert is_worded(second.client.get("/"), STRANGER)
    assert first.enter(stand.url).status_code == 200, "its own browser may open it again"


def test_no_address_gives_a_session_away(stand: WebStand, comes: Comes) -> None:
    visitor = comes(stand.url)
    ((_, session),) = visitor.client.cookies.items()
    assert not any(session in address for address in stand.addresses)
    stranger = comes()
    for query in (f"?token={session}", f"?once={session}", f"?token={stand.url.partition('once=')[2]}"):
        assert is_worded(stranger.client.get(f"/{query}"), STRANGER)
    stranger.client.cookies.set(f"__Host-robofleet-{end_of(stand)[1]}", session[:-1], domain=HOST)
    assert is_worded(stranger.client.get("/"), STRANGER)


def test_without_a_cookie_there_is_no_page_and_a_stranger_can_ask_for_nothing(stand: WebStand, comes: Comes) -> None:
    stranger = comes()
    for path in ("/", "/index.html", "/report"):
        assert is_worded(stranger.client.get(path), STRANGER)
    assert is_bare(stranger.post("/estop"))
    assert is_bare(stranger.post("/invite/operator"))
    with pytest.raises(InvalidStatus) as refused, stranger.page():
        pass
    assert refused.value.response.status_code == 403
    assert stand.requests == []


def test_the_address_for_a_browsers_command_line_is_for_this_user_only(
    stand: WebStand, comes: Comes, monkeypatch: pytest.MonkeyPatch
) -> None:
    for owner in (None, os.geteuid() + 1):  # from another computer; another user's
        with monkeypatch.context() as patched:
            patched.setattr(one_time_token, "owner", lambda *_, owner=owner: owner)
            assert is_worded(comes().enter(stand.once), USED)
    assert comes(stand.once).client.get("/").status_code == 200


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    "origin", ["http://{authority}", "https://evil.example", "null", "https://localhost:{port}", ""]
)
def test_another_sites_request_is_refused_though_it_brings_the_cookie(
    stand: WebStand, comes: Comes, origin: str
) -> None:
    visitor = comes(stand.url)
    site = origin.format(authority=stand.authority, port=end_of(stand)[1])
    for path in ("/estop", "/invite/operator"):
        assert is_bare(visitor.post(path, origin=site))
    with pytest.raises(InvalidStatus), visitor.page(origin=site or None):
        pass
    assert stand.requests == []


def test_another_name_is_refused(stand: WebStand, comes: Comes) -> None:
    visitor = comes(stand.url)
    assert visitor.client.get("/", headers={"host": f"localhost:{end_of(stand)[1]}"}).status_code == 403


def test_a_viewer_sees_holds_stops_moves_nothing_and_invites_nobody(stand: WebStand, comes: Comes) -> None:
    visitor = comes(stand.addresses.viewer)
    assert is_bare(visitor.post("/invite/viewer"))
    with visitor.page() as page:
        assert page.heard_one()["type"] == "hello"
        for what in ("arm", "start", "resume", "stop", "reset"):
            page.say(do=what)
            answer = page.next("answer")
            assert (answer["to"], answer["ok"]) == (what, False)
            assert answer["text"].startswith("refused (403): a viewer may hold the run and press the emergency stop")
        assert stand.requests == []
        page.say(do="hold")
        assert page.next("answer")["ok"]
        page.say(do="estop")
        assert page.next("answer")["to"] == "estop"
    assert visitor.post("/estop").json()["to"] == "estop"
    assert stand.requests[0] == b"hold"
    assert b"estop" in stand.requests


def test_viewers_leave_places_for_operators(stand: WebStand, comes: Comes) -> None:
    viewer, operator = comes(stand.addresses.viewer), comes(stand.url)
    with ExitStack() as opened:
        for _ in range(12):
            opened.enter_context(viewer.page())
        with pytest.raises(InvalidStatus), viewer.page():
            pass
        assert opened.enter_context(operator.page()).heard_one()["type"] == "hello"


def test_an_operator_does_everything_and_invites_others(stand: WebStand, comes: Comes) -> None:
    operator = comes(stand.url)
    with operator.page() as page:
        for what in ("arm", "start", "hold", "stop", "reset"):
            page.say(do=what)
            assert page.next("answer")["ok"]
    for role, starts in ("viewer", False), ("operator", True):
        invited = operator.post(f"/invite/{role}").json()
        assert invited["code"].startswith("data:image/svg+xml")
        with comes(invited["address"]).page() as page:
            page.say(do="start")
            assert page.next("answer")["ok"] == starts
        assert is_worded(comes().enter(invited["address"]), USED)
    assert operator.post("/invite/king").status_code == 404


def test_the_page_is_told_its_role(stand: WebStand, comes: Comes) -> None:
    assert '<body data-role="operator">' in comes(stand.url).client.get("/").text
    viewer = comes(stand.addresses.viewer)
    for path in ("/", "/index.html"):
        assert '<body data-role="viewer">' in viewer.client.get(path).text


def test_addresses_that_nobody_opens_end(stand: WebStand, comes: Comes) -> None:
    operator = comes(stand.url)
    first, *_, last = [operator.post("/invite/viewer").json()["address"] for _ in range(17)]
    assert is_worded(comes().enter(first), USED)
    assert comes().enter(last).status_code == 200


def test_on_this_computer_the_page_stays_as_it_was(tmp_path: Path) -> None:
    with web_stand(tmp_path, "tracker.source=truth") as stand:
        page = httpx.get(stand.url)
        assert stand.addresses[2:] == ("", "")
        assert "set-cookie" not in page.headers
        assert "<body>" in page.text
        headers = {"origin": f"http://{stand.authority}", "x-token": stand.token}
        assert httpx.post(f"http://{stand.authority}/invite/viewer", headers=headers).status_code == 404

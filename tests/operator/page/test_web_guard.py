"""Who may speak to the operator's page: others are told nothing secret, and nothing of theirs reaches a robot."""

import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from robofleet.operator.page import one_time_token
from tests.operator.page.webstand import WebStand, web_stand

INCOMPLETE = "This address is not complete, or it is an old one"


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run"), "tracker.source=truth") as stand:
        yield stand


def ask(stand: WebStand, method: str, path: str, **headers: str) -> httpx.Response:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return httpx.request(method, f"http://{stand.authority}{path}", headers=named)


def is_bare(response: httpx.Response) -> bool:
    """Whether it tells nothing: no body, and no header that a browser would take for a permission."""
    names = [name for name in response.headers if name not in ("connection", "content-length")]
    return (response.status_code, response.content, names) == (403, b"", [])


def is_worded(response: httpx.Response, stand: WebStand, title: str) -> bool:
    """Whether it tells a person what to do, and nobody anything else."""
    secrets = stand.token, stand.once.partition("once=")[2], stand.authority
    policy = response.headers["content-security-policy"]
    assert not any(secret in response.text for secret in secrets)
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'sha256-")
    assert not re.search("<script|<form|<a |http", response.text)
    assert not any(name.startswith("access-control") for name in response.headers)
    return response.status_code == 403 and f"<h1>{title}</h1>" in response.text


def test_the_page_is_served_to_who_has_its_address(stand: WebStand) -> None:
    page = httpx.get(stand.url)
    assert (page.status_code, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
    policy = page.headers["content-security-policy"].split("; ")
    assert {"default-src 'self'", "img-src 'self' data:", "frame-ancestors 'none'"} <= set(policy)
    assert not any("unsafe" in rule or "*" in rule for rule in policy)
    for name, value in [
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cache-control", "no-store"),
    ]:
        assert page.headers[name] == value
    assert not any(name.startswith("access-control") for name in page.headers)
    scripts = re.findall(r'(?:src|href)="([^"]+\.(?:js|css))"', page.text)
    assert scripts
    for script in scripts:
        assert httpx.get(f"http://{stand.authority}/{script}").status_code == 200
    assert not re.search(r'(?:src|href)="(?:https?:)?//', page.text), "everything that it needs is here"


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1.evil.example:{port}", ""]
)
@pytest.mark.parametrize("path", ["/?token={token}", "/page.js"])
def test_another_name_for_this_host_is_refused(stand: WebStand, host: str, path: str) -> None:
    port = stand.authority.split(":")[1]
    response = ask(stand, "GET", path.format(token=stand.token), host=host.format(port=port))
    assert is_worded(response, stand, "This page is known by another name")
    assert not host or host.format(port=port) not in response.text
    assert is_bare(ask(stand, "POST", path.format(token=stand.token), host=host.format(port=port)))


def test_localhost_is_a_name_of_this_host(stand: WebStand) -> None:
    port = stand.authority.split(":")[1]
    assert ask(stand, "GET", f"/?token={stand.token}", host=f"localhost:{port}").status_code == 200


@pytest.mark.parametrize(
    "query", ["", "index.html", "?token=", "?token={short}", "?token={token}0", "?token={token}&token=x", "?token=é"]
)
def test_without_its_token_there_is_no_page(stand: WebStand, query: str) -> None:
    refused = ask(stand, "GET", "/" + query.format(token=stand.token, short=stand.token[:-1]))
    assert is_worded(refused, stand, INCOMPLETE)


@pytest.mark.parametrize(
    "headers",
    [
        {"x_token": ""},
        {"x_token": "0" * 32},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "https://{authority}"},
        {"origin": ""},
        {"host": "evil.example"},
    ],
    ids=str,
)
def test_a_forged_emergency_stop_is_refused(stand: WebStand, headers: dict[str, str]) -> None:
    stand.requests.clear()
    headers = {"origin": "http://{authority}", "x_token": "{token}"} | headers
    filled = {name: text.format(authority=stand.authority, token=stand.token) for name, text in headers.items() if text}
    assert is_bare(ask(stand, "POST", f"/estop?token={stand.token}", **filled))
    assert stand.requests == []


def test_another_sites_script_is_given_no_permission_to_ask(stand: WebStand) -> None:
    preflight = ask(
        stand, "OPTIONS", "/estop", origin="http://evil.example", access_control_request_method="POST",
        access_control_request_headers="x-token",
    )  # fmt: skip
    assert is_bare(preflight)


@pytest.mark.parametrize(
    "changes",
    [
        {"token": ""},
        {"token": "0" * 32},
        {"origin": None},
        {"origin": "null"},
        {"origin": "http://evil.example"},
        {"origin": "http://localhost.evil.example"},
        {"host": "evil.example"},
    ],
    ids=str,
)
def test_a_forged_websocket_is_refused(stand: WebStand, changes: dict[str, Any]) -> None:
    changes = dict(changes)
    host = changes.pop("host", None)
    if host is not None:  # as after DNS rebinding: Host and Origin agree
        changes |= {"uri_host": host}
    with pytest.raises(InvalidStatus) as refused:
        forged(stand, **changes)
    assert (refused.value.response.status_code, refused.value.response.body) == (403, b"")


def forged(stand: WebStand, uri_host: str | None = None, **changes: Any) -> None:
    if uri_host is None:
        with stand.page(**changes):
            return
    name, port = stand.authority.split(":")
    with socket.create_connection((name, int(port))) as client:
        uri, origin = f"ws://{uri_host}:{port}/live?token={stand.token}", f"http://{uri_host}:{port}"
        with connect(uri, sock=client, origin=Origin(origin)):
            pass


@pytest.mark.parametrize(
    "path", ["/../guard.py", "/%2e%2e/guard.py", "/..%2fguard.py", "//etc/passwd", "/page.js/../../guard.py"]
)
def test_no_other_file_is_served(stand: WebStand, path: str) -> None:
    name, port = stand.authority.split(":")
    with socket.create_connection((name, int(port))) as client:  # httpx would tidy the path up
        client.sendall(
            f"GET {path}?token={stand.token} HTTP/1.1\r\nHost: {stand.authority}\r\nConnection: close\r\n\r\n".encode()
        )
        answer = b"".join(iter(lambda: client.recv(65536), b""))
    assert answer.startswith(b"HTTP/1.1 404 ")


@pytest.mark.parametrize("in_header", [True, False])
def test_a_request_that_is_too_large_is_refused(stand: WebStand, in_header: bool) -> None:
    stand.requests.clear()
    body = b"x" * 2000
    headers = {"origin": f"http://{stand.authority}", "x-token": stand.token}
    content = body if in_header else iter([body])
    assert httpx.post(f"http://{stand.authority}/estop", headers=headers, content=content).status_code == 413
    assert stand.requests == []


def test_a_page_that_says_too_much_is_closed(stand: WebStand) -> None:
    with stand.page() as page:
        page.socket.send("x" * 2000)
        with pytest.raises(ConnectionClosed) as closed:
            page.heard(3_000_000_000)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize(
    "frame", ["", "nonsense", "[" * 900, '{"do":"fly"}', '{"do":["estop"]}', "{}", '"estop"', b"\x00"]
)
def test_a_page_that_makes_no_sense_is_closed_and_no_other(stand: WebStand, frame: str | bytes) -> None:
    stand.requests.clear()
    with stand.page() as other, stand.page() as page:
        page.socket.send(frame)
        with pytest.raises(ConnectionClosed) as closed:
            page.heard(3_000_000_000)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        other.say(do="hold")
        assert other.next("answer")["ok"]
    assert stand.requests == [b"hold"]


def test_what_is_refused_is_counted_and_logged_without_the_token(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with web_stand(tmp_path, "tracker.source=truth") as stand:
        capsys.readouterr()
        ask(stand, "GET", f"/?token={stand.token}", host="evil.example\x1b[31m")
        ask(stand, "GET", f"/?token={stand.token[:-1]}")
        stderr = capsys.readouterr().err
    assert stderr.startswith("refused (1 so far): http '/' of 127.0.0.1: wrong Host ['evil.example")
    assert "\x1b" not in stderr
    assert len(stderr.splitlines()) == 1, "one line a second at most"
    assert stand.token[:-1] not in stderr


def test_every_start_draws_another_token_of_128_bits(tmp_path: Path, stand: WebStand) -> None:
    with web_stand(tmp_path, "tracker.source=truth") as second:
        assert re.fullmatch(r"[0-9a-f]{32}", second.token)
        assert second.token != stand.token


def test_a_one_time_token_opens_the_page_for_this_user_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with web_stand(tmp_path, "tracker.source=truth") as stand:
        assert stand.token not in stand.once, "the command line of a browser is read by everybody"
        wrong = httpx.get(stand.once[:-1])
        assert is_worded(wrong, stand, "This address has opened its page already")
        with monkeypatch.context() as patched:
            patched.setattr(one_time_token.os, "geteuid", lambda: os.getuid() + 1)
            assert httpx.get(stand.once).status_code == 403
        opened = httpx.get(stand.once)
        assert (opened.status_code, opened.headers["location"]) == (303, f"/?token={stand.token}")
        assert is_worded(httpx.get(stand.once), stand, "This address has opened its page already")


def test_the_system_says_whose_a_local_connection_is() -> None:
    for family, host in (socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1"):
        with socket.create_server((host, 0), family=family) as server:
            port = server.getsockname()[1]
            with socket.create_connection((host, port)) as client:
                assert one_time_token.owner(client.getsockname()[:2], port) == os.geteuid()
            assert one_time_token.owner(("192.0.2.1", 5), port) is None


@pytest.mark.slow
def test_no_more_pages_than_a_run_needs(stand: WebStand) -> None:
    with ExitStack() as opened:
        for _ in range(16):
            opened.enter_context(stand.page())
        with pytest.raises(InvalidStatus), stand.page():
            pass

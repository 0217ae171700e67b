"""However many connections somebody opens, and however slowly he speaks: the emergency stop is answered."""

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

import httpx
import pytest

from robofleet.core.clock import MS
from robofleet.operator.page.connection_limiter import MOST
from tests.operator.page.webstand import CLOCK, WebStand
from tests.runs.realrun import wait

ANSWERED_WITHIN_S = 5.0  # the page's own patience; an emergency stop that nobody acknowledges takes two
GONE_WITHIN_S = 20.0


def connected(stand: WebStand) -> socket.socket:
    name, port = stand.authority.split(":")
    return socket.create_connection((name, int(port)), timeout=ANSWERED_WITHIN_S)


def stopped(stand: WebStand) -> bool:
    """Ask for the emergency stop as the page does without its socket; returns whether the server did as asked."""
    headers = {"origin": f"http://{stand.authority}", "x-token": stand.token}
    answer = httpx.post(f"http://{stand.authority}/estop", headers=headers, timeout=ANSWERED_WITHIN_S)
    return answer.status_code == 200 and answer.json()["to"] == "estop"


def is_closed(client: socket.socket) -> bool:
    """Whether the other end has closed a connection; what it said before is passed over."""
    client.setblocking(False)
    try:
        while client.recv(65536):
            pass
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@contextmanager
def crowd(stand: WebStand, count: int, opening: bytes = b"") -> Iterator[list[socket.socket]]:
    """Open connections that say something and wait."""
    with ExitStack() as opened:
        clients = [opened.enter_context(connected(stand)) for _ in range(count)]
        for client in clients:
            if opening:
                client.sendall(opening)
        yield clients


HALF = b"POST /estop HTTP/1.1\r\nHost: x\r\nX-Slow: "
BODY = b"POST /estop HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nx"
UPGRADE = b"GET /live HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
KEYED = UPGRADE + b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
SAID = {"nothing": b"", "half a head": HALF, "half a body": BODY, "no page": KEYED, "no key": UPGRADE + b"\r\n",
        "garbage": b"\x00\xff\r\n\r\n" * 100, "a script": b"GET /page.js HTTP/1.1\r\nHost: x\r\n\r\n"}  # fmt: skip


@pytest.mark.slow_after_first
@pytest.mark.parametrize("opening", SAID, ids=str)
def test_a_crowd_that_waits_does_not_delay_the_emergency_stop(stand: WebStand, opening: str) -> None:
    with crowd(stand, 200, SAID[opening]):
        assert httpx.get(stand.url, timeout=ANSWERED_WITHIN_S).status_code == 200
        with stand.page() as page:
            page.say(do="hold")
            assert page.next("answer")["ok"]
        assert stopped(stand)
    assert b"estop" in stand.requests


def dripped(clients: list[socket.socket]) -> bool:
    """Say a byte on each connection that is open; returns whether none is."""
    for client in clients:
        client.setblocking(False)
        with suppress(OSError):
            client.send(b"x")
    return all(map(is_closed, clients))


@pytest.mark.slow
def test_who_asks_for_nothing_or_speaks_byte_by_byte_is_closed(stand: WebStand) -> None:
    with stand.page() as page, ExitStack() as opened:
        crowds = {kind: opened.enter_context(crowd(stand, 30, SAID[kind])) for kind in SAID}
        slow = opened.enter_context(crowd(stand, 5))
        assert sum(map(len, crowds.values())) + len(slow) < MOST, "nobody is closed for another's place"
        open_yet = dict(crowds)

        def all_are_closed() -> bool:
            for kind, few in [*open_yet.items()]:
                if all(map(is_closed, few)):
                    del open_yet[kind]
            return dripped(slow) and not open_yet

        assert wait(all_are_closed, GONE_WITHIN_S), list(open_yet)
        page.say(do="hold")
        assert page.next("answer")["ok"], "a page stays, however little it says"


@contextmanager
def meanwhile(act: Callable[[], None]) -> Iterator[None]:
    """Do something again and again in a thread."""
    over = threading.Event()

    def again() -> None:
        while not over.is_set():
            with suppress(OSError):
                act()
            CLOCK.sleep_until(CLOCK.now_ns() + MS)

    thread = threading.Thread(target=again)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.mark.slow
@pytest.mark.parametrize("opening", [b"", HALF, SAID["garbage"]])
def test_a_crowd_that_keeps_coming_does_not_delay_the_emergency_stop(
    stand: WebStand, opening: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    kept: list[socket.socket] = []

    def come() -> None:
        kept.append(connected(stand))
        if len(kept) > 400:
            kept.pop(0).close()
        kept[-1].sendall(opening)

    capsys.readouterr()
    began_ns = CLOCK.now_ns()
    with meanwhile(come):
        assert wait(lambda: len(kept) >= 400, GONE_WITHIN_S)
        for _ in range(3):
            assert stopped(stand)
    lasted_s = (CLOCK.now_ns() - began_ns) / 1e9
    for client in kept:
        client.close()
    lines = capsys.readouterr().err.splitlines()
    assert 0 < len(lines) <= lasted_s + 2, "one line a second at most"
    assert all(line.startswith("refused (") for line in lines), lines

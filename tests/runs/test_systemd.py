"""What a process tells the systemd that watches it."""

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import MS, WallClock
from robofleet.nodes.node import Lifeline, Waker, run

CLOCK = WallClock()


class Steps:
    """A process that does something at every step, and asks for the next one 10 ms later."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act

    def step(self, now_ns: int) -> int:
        self._act()
        return now_ns + 10 * MS

    def close(self) -> None:
        pass


def process(act: Callable[[], None]) -> tuple[Lifeline, threading.Thread]:
    """Run a process in a thread: cutting its lifeline ends it."""
    lifeline = Lifeline.__new__(Lifeline)
    lifeline.cut, lifeline.ready = False, lambda message="ready": None  # type: ignore[method-assign]
    thread = threading.Thread(target=run, args=(Steps(act), CLOCK, lifeline, Waker()))
    thread.start()
    return lifeline, thread


def heard(systemd: socket.socket, within_s: float) -> Iterator[bytes]:
    """Give what systemd hears until it hears nothing for so long."""
    systemd.settimeout(within_s)
    try:
        while True:
            yield systemd.recv(64)
    except TimeoutError:
        pass


@pytest.mark.parametrize("abstract", [False, True])
def test_it_is_told_that_a_process_is_ready_alive_and_ends(
    abstract: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"{tmp_path}/notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{name}" if abstract else name)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}" if abstract else name)
        lifeline, thread = process(lambda: None)
        lines = heard(systemd, 1.0)
        first = [next(lines) for _ in range(5)]
        lifeline.cut = True
        thread.join()
        last = list(heard(systemd, 0.05))
    assert first == [b"READY=1", *[b"WATCHDOG=1"] * 4]
    assert last[-1] == b"STOPPING=1"
    assert set(last[:-1]) <= {b"WATCHDOG=1"}


def test_a_loop_that_hangs_gives_no_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hangs, goes_on = threading.Event(), threading.Event()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"{tmp_path}/notify")
        monkeypatch.setenv("NOTIFY_SOCKET", f"{tmp_path}/notify")
        lifeline, thread = process(lambda: goes_on.wait(5.0) if hangs.is_set() else None)  # type: ignore[arg-type,func-returns-value]
        lines = heard(systemd, 1.0)
        assert [next(lines) for _ in range(3)][-1] == b"WATCHDOG=1"
        hangs.set()
        assert len(list(heard(systemd, 0.2))) <= 20  # it had begun a step or two
        assert list(heard(systemd, 0.2)) == []
        goes_on.set()
        lifeline.cut = True
        thread.join()


@pytest.mark.parametrize("address", [None, "/nowhere/notify"])
def test_where_there_is_no_systemd_a_process_runs_all_the_same(
    address: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    if address is not None:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    stepped = threading.Event()
    lifeline, thread = process(stepped.set)
    assert stepped.wait(1.0)
    lifeline.cut = True
    thread.join()

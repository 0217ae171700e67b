"""What every process of a run has in common, and how one is run in real time."""

import gc
import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from importlib.metadata import version
from typing import Protocol

from robofleet.core.clock import MS, Clock, S

NICE = -10
HIGHEST_PRIORITY = 20  # real-time, of the processes of a run: the controller's
_EXIT_WITHIN_S = 0.8  # of the parent's pipe closing; then the process is ended as it is


class Node(Protocol):
    """One process: read, decide, publish. It owns its state."""

    def step(self, now_ns: int) -> int:
        """Do what is due and return the instant of the next step [ns]; a message may wake it earlier."""

    def close(self) -> None:
        """Leave everything at rest. Idempotent."""


class Waker:
    """Ends a process's wait when a message comes; lockstep puts its event queue in its place."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def __call__(self, instant_ns: int) -> None:
        """Wake the process (from any thread)."""
        self._event.set()

    def wait_until(self, clock: Clock, instant_ns: int) -> None:
        remaining_s = (instant_ns - clock.now_ns()) / S
        if remaining_s > 0:
            self._event.wait(remaining_s)
        self._event.clear()


class LineWaker(Waker):
    """Ends a process's wait when bytes come on one of its ``descriptors``."""

    def __init__(self) -> None:
        super().__init__()
        self.descriptors: list[int] = []

    def wait_until(self, clock: Clock, instant_ns: int) -> None:
        """Return at the instant, or when something can be read."""
        select.select(self.descriptors, [], [], max(0.0, (instant_ns - clock.now_ns()) / S))


class Lifeline:
    """The parent's end of a socket: when it closes, or at SIGTERM, this process has a second to end well.

    Without a parent (a process started by hand or by systemd) Ctrl-C ends it too.
    """

    def __init__(self, descriptor: int | None, *, exit_within_s: float = _EXIT_WITHIN_S) -> None:
        self.cut = False
        self.by_signal = False
        self._exit_within_s = exit_within_s
        self.why = "an error"  # this process ends
        self.last_word = b""  # what the parent said before it closed its end
        self._socket = None if descriptor is None else socket.socket(fileno=descriptor)
        if self._socket is None:  # until it is ready: Python's handlers do not run while Zenoh waits for its router
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        else:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is the launcher's to answer
            threading.Thread(target=self._watch, daemon=True).start()

    def ready(self, message: str = "ready") -> None:
        """Tell the parent that this process does its work from now on; from now on a signal ends it well."""
        signal.signal(signal.SIGTERM, self._cut_by_signal)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup sets it
            signal.signal(signal.SIGHUP, self._cut_by_signal)  # a lost terminal must not leave wheels turning
        self.say(message)
        if self._socket is None:
            signal.signal(signal.SIGINT, self._cut_by_signal)
            print(message, file=sys.stderr)

    @contextmanager
    def logged(self, what: str, arena: str) -> Iterator[None]:
        """Let the log of a run's process say that it began, and why it ended: no message points to an empty log.

        A process that was started by hand has no log: its terminal shows as much.
        """
        if self._socket is None:
            yield
            return
        self._log(f"{what} of {arena}: started, robofleet {version('robofleet')}, process {os.getpid()}")
        try:
            yield
        except BaseException as error:
            self._log(f"{what}: ended by {type(error).__name__}")
            raise
        self._log(f"{what}: ended: {self.why}")

    @staticmethod
    def _log(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    def _cut_by_signal(self, number: int, _frame: object) -> None:
        self.why = signal.Signals(number).name
        self.cut = self.by_signal = True

    @property
    def newest_line(self) -> str:
        """What the parent said last, while it lives."""
        lines = self.last_word.rpartition(b"\n")[0].splitlines()
        return lines[-1].decode(errors="replace") if lines else ""

    def say(self, message: str) -> None:
        """Tell the parent something, if it is still there."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendall(message.encode() + b"\n")

    def _watch(self) -> None:
        assert self._socket is not None
        try:
            while word := self._socket.recv(4096):
                self.last_word += word
        except OSError:
            pass
        self.why = "its run ended it"
        self.cut = True
        threading.Event().wait(self._exit_within_s)
        os._exit(1)


class _Systemd:
    """Says to systemd that a service is ready and alive (Type=notify, WatchdogSec=); without systemd to nobody."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None

    def tell(self, state: bytes) -> None:
        if self._socket is not None:
            with suppress(OSError):  # systemd is too busy, or gone: the wheels go first
                self._socket.sendto(state, socket.MSG_DONTWAIT, self._address)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


def run(node: Node, clock: Clock, lifeline: Lifeline, waker: Waker, *, precise: bool = False) -> None:
    """Step a process in real time until its lifeline is cut; it is closed whatever happens.

    ``precise`` meets every instant within microseconds and is not woken by messages: the controller's tick.
    A loop that hangs gives systemd no more signs of life.
    """
    with closing(_Systemd()) as systemd:
        try:
            lifeline.ready()
            systemd.tell(b"READY=1")
            while not lifeline.cut:
                systemd.tell(b"WATCHDOG=1")
                next_ns = min(node.step(clock.now_ns()), clock.now_ns() + 100 * MS)
                if precise:
                    clock.sleep_until(next_ns, precise=True)
                else:
                    waker.wait_until(clock, next_ns)
        finally:
            systemd.tell(b"STOPPING=1")
            node.close()


def ahead_of_others() -> None:
    """Let this process, with Zenoh's threads that it starts later, go before what else the machine has to do."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    except PermissionError as error:
        print(f"no higher priority ({error}): messages may be late when the machine is busy", file=sys.stderr)


def realtime_priority(level: int) -> None:
    """Ask for SCHED_FIFO for this thread and switch the garbage collector's pauses off; go on where it is refused.

    Called after the bus is open, so that Zenoh's own threads do not inherit it.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))
    except (AttributeError, PermissionError) as error:
        print(f"no real-time priority ({error}): ticks may be late when the machine is busy", file=sys.stderr)

"""The operator's terminal: single keys, signals, what a run shows there, and whether it is still there.

Keys are heard by a thread of their own, so nothing that keeps the run's own thread delays the emergency stop.
"""

import os
import select
import signal
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from robofleet.bus.bus import Bus
from robofleet.core.clock import Clock, S
from robofleet.core.starting import Starting
from robofleet.operator.estop import Stopped, emergency_stop
from robofleet.operator.page.browser import open_page
from robofleet.operator.page.page_address import Addresses, address_lines
from robofleet.runs.console import EMERGENCY_KEYS

_PAGE = "web"  # the command whose process serves the page
_PAGE_GONE = "the page is gone, the run goes on: `robofleet web` opens another one"
_VIEWERS_GONE = "{0} sees nothing more, the run goes on: `robofleet {0}` serves it again; see {1}"
_MOST_KEYS = 64  # at once
_INPUT_MODES = 0  # index in what termios returns


class Terminal:
    """Keys without Enter while this is open; the terminal is given back as it was, whatever happens.

    Where stdin is not a terminal, or belongs to another command's foreground, there are no keys. Ctrl-S stops nothing.
    It is the launcher's ``Console``.
    """

    def __init__(self) -> None:
        self.lost = False  # it was closed
        self.note = ""  # what the operator should read
        self.starting: Starting | None = None  # how far the start is; None: it is over
        self.addresses: dict[str, str] = {}  # by command, where it serves the page or viewers, or that it is gone
        self.code = ""  # the page's address, where a phone can use it: shown once as a QR code
        self.emergency: Callable[[], object] = lambda: None  # called at once, by the thread that hears the keys
        self._before: list[Any] | None = None
        self._descriptor = -1
        self._keys = ""  # that nobody has taken
        self._pressed = threading.Condition()
        self._hearing: threading.Thread | None = None
        self._end: tuple[int, int] | None = None  # a pipe that ends the thread

    @property
    def present(self) -> bool:
        """Whether somebody can press a key."""
        return self._before is not None and not self.lost

    def __enter__(self) -> Self:
        """Take single keys, without echo; signals stay."""
        try:
            self._descriptor = sys.stdin.fileno()
            if os.tcgetpgrp(self._descriptor) == os.getpgrp():  # in the background the first read would stop us
                before = termios.tcgetattr(self._descriptor)
                _take_keys(self._descriptor)
                self._before = before
        except (OSError, ValueError, AttributeError, termios.error):  # no terminal, or no stdin at all
            self._before = None
        if self._before is not None:
            self._end = os.pipe()
            self._hearing = threading.Thread(target=self._hear, args=(self._end[0],), daemon=True)
            self._hearing.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._hearing is not None and self._end is not None:
            os.close(self._end[1])
            self._hearing.join()
            os.close(self._end[0])
            self._hearing = self._end = None
        if self._before is not None:
            with suppress(termios.error):  # there may be no terminal any more
                termios.tcsetattr(self._descriptor, termios.TCSANOW, self._before)

    def keys(self, clock: Clock, until_ns: int) -> str:
        """Return the keys pressed by an instant, as soon as there is one."""
        if not self.present and not self._keys:
            clock.sleep_until(until_ns)
            return ""
        with self._pressed:
            self._pressed.wait_for(lambda: self._keys or self.lost, max(0, until_ns - clock.now_ns()) / S)
            keys, self._keys = self._keys, ""
        return keys

    def interrupts(self) -> AbstractContextManager["Interrupts"]:
        return interrupts()

    def emergency_stop(self, bus: Bus, clock: Clock, units: Mapping[str, Sequence[str]]) -> Stopped:
        return emergency_stop(bus, clock, units)

    def page_found(self, addresses: str, *, browser: bool) -> None:
        """Show where the operator's page is, and open it if ``browser``; from any thread, as the three below."""
        at = Addresses.read(addresses)
        if at is None:
            return
        opened = browser and sys.stderr.isatty() and open_page(at.once)
        self.addresses[_PAGE] = address_lines(at, opened=opened)
        self.code = at.page if at.viewer else ""  # a phone cannot reach the others

    def page_gone(self) -> None:
        self.addresses[_PAGE], self.code = _PAGE_GONE, ""

    def viewers_found(self, viewer: str, line: str) -> None:
        self.addresses[viewer] = line

    def viewers_gone(self, viewer: str, log: Path) -> None:
        self.addresses[viewer] = _VIEWERS_GONE.format(viewer, log)

    def _hear(self, end: int) -> None:
        """Hear keys until this is closed or the terminal is."""
        while not self.lost:
            readable, _, _ = select.select([self._descriptor, end], [], [])
            if end in readable:
                return
            try:
                pressed = os.read(self._descriptor, _MOST_KEYS)
            except OSError:
                pressed = b""
            keys = pressed.decode("ascii", "ignore")
            with self._pressed:
                self._keys += keys
                self.lost = not pressed
                self._pressed.notify_all()
            if EMERGENCY_KEYS.intersection(keys):
                self.emergency()


def _take_keys(descriptor: int) -> None:
    """Set a terminal's mode, without waiting for what it has not shown yet; drop what was typed before."""
    tty.setcbreak(descriptor, termios.TCSANOW)
    mode = termios.tcgetattr(descriptor)
    mode[_INPUT_MODES] &= ~termios.IXON
    termios.tcsetattr(descriptor, termios.TCSANOW, mode)
    termios.tcflush(descriptor, termios.TCIFLUSH)


class Interrupts:
    """Ctrl-C, SIGTERM, a closed terminal and Ctrl-Z (a stopped launcher would leave the robots driving), counted."""

    def __init__(self) -> None:
        self.count = 0
        self.hung_up = False

    def __call__(self, number: int, _frame: object) -> None:
        self.count += 1
        self.hung_up = self.hung_up or number == signal.SIGHUP


@contextmanager
def interrupts() -> Iterator[Interrupts]:
    """Count the terminal's signals instead of ending by them; nohup's setting stays in force."""
    counted = Interrupts()
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGTSTP]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, counted) for number in numbers}
    try:
        yield counted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def hangup_interrupts() -> Iterator[None]:
    """Let a terminal that is closed interrupt as Ctrl-C does; nohup's setting stays in force."""
    before = signal.getsignal(signal.SIGHUP)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)

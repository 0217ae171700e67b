"""The operator's terminal: single keys, signals, and whether it is still there."""

import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Any, Self

from robofleet.clock import Clock, S

_MOST = 64  # keys at once


class Terminal:
    """Keys without Enter while this is open; the terminal is given back as it was, whatever happens.

    Where stdin is no terminal, or belongs to another command's foreground, there are no keys.
    """

    def __init__(self) -> None:
        self.lost = False  # it was closed
        self.note = ""  # what the operator should read
        self.page = ""  # where the operator's page is, or that it is gone
        self._before: list[Any] | None = None
        self._descriptor = -1

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
                tty.setcbreak(self._descriptor)
                self._before = before
        except (OSError, ValueError, AttributeError, termios.error):  # no terminal, or no stdin at all
            self._before = None
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Give it back."""
        if self._before is not None:
            with suppress(termios.error):  # there may be no terminal any more
                termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)

    def keys(self, clock: Clock, until_ns: int) -> str:
        """Return the keys pressed by an instant, as soon as there is one."""
        if not self.present:
            clock.sleep_until(until_ns)
            return ""
        try:
            readable, _, _ = select.select([self._descriptor], [], [], max(0, until_ns - clock.now_ns()) / S)
            pressed = os.read(self._descriptor, _MOST) if readable else None
        except OSError:
            pressed = b""
        if pressed == b"":
            self.lost = True
        return (pressed or b"").decode("ascii", "ignore")


class Interrupts:
    """Ctrl-C, SIGTERM, a closed terminal and Ctrl-Z (a stopped launcher would leave the robots driving), counted."""

    def __init__(self) -> None:
        self.count = 0
        self.hung_up = False

    def __call__(self, number: int, _frame: object) -> None:
        """Count a signal."""
        self.count += 1
        self.hung_up = self.hung_up or number == signal.SIGHUP


@contextmanager
def interrupts() -> Iterator[Interrupts]:
    """Count the terminal's signals instead of ending by them; nohup's wish stands."""
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

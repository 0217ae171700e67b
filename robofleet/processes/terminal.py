"""The operator's terminal: single keys, and whether it is still there."""

import os
import select
import sys
import termios
import tty
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
            try:
                termios.tcsetattr(self._descriptor, termios.TCSADRAIN, self._before)
            except termios.error:
                pass  # there is no terminal any more

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

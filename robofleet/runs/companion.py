"""A process beside a run that serves people: the operator's page, or viewers. The run goes on without it.

It is started before the kernels are compiled. After the end of the run it may stay for those who still look at it.
"""

import select
import socket
import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from robofleet.core.clock import Clock, S
from robofleet.runs.children import Child

ENDS = "ends: "  # before the launcher's last words, which say how the run ends
STAYS = "stays"  # what it says after the end of the run, where somebody looks
_LEAVE_WITHIN_S = 1.2
_LONGEST_LINE_BYTES = 1024


class PageWanted(NamedTuple):
    """How the operator wants the page."""

    host: str  # which of this machine's addresses
    browser: bool  # open one


class Companion:
    """Waits in a thread for the address at which the process serves, since the launcher may be compiling."""

    def __init__(self, child: Child, found: Callable[[str], None], gone: Callable[[], None]) -> None:
        """``found`` is called, from that thread, with the line that says where it serves; ``gone`` when it has died."""
        self._child, self._found, self._gone = child, found, gone
        self._last_word = ""
        self._over = False
        self._hearing = threading.Thread(target=self._hear, daemon=True)
        self._hearing.start()

    def tell(self, words: str) -> None:
        """Say what the launcher does, for as long as nobody else of the run speaks."""
        if words != self._last_word:
            self._last_word = words
            with suppress(OSError):
                self._child.lifeline.send(words.encode() + b"\n", socket.MSG_DONTWAIT)

    def look(self) -> None:
        if self._child.died:
            self._gone()

    def end(self) -> None:
        self._over = True
        with suppress(OSError):  # it is gone
            self._child.lifeline.shutdown(socket.SHUT_WR)

    def leave(self, clock: Clock) -> None:
        """Leave the process running while somebody uses it, else wait for its end. Kill it if it hangs."""
        child = self._child
        self._hearing.join(_LEAVE_WITHIN_S)
        end_ns = clock.now_ns() + round(_LEAVE_WITHIN_S * S)
        word = b""
        with child.lifeline:
            while (left_s := (end_ns - clock.now_ns()) / S) > 0 and not self._hearing.is_alive():
                readable, _, _ = select.select([child.lifeline], [], [], left_s)
                with suppress(OSError):
                    word = child.lifeline.recv(_LONGEST_LINE_BYTES) if readable else b""
                if not word or STAYS.encode() in word:
                    break
        if STAYS.encode() in word:
            _left.append(child.process)
            return
        try:
            child.process.wait(max(0.0, (end_ns - clock.now_ns()) / S))
        except subprocess.TimeoutExpired:
            child.process.kill()
            child.process.wait()

    def _hear(self) -> None:
        with suppress(OSError):
            word = self._child.lifeline.recv(_LONGEST_LINE_BYTES).decode(errors="replace").strip()
            if word and not self._over:
                self._found(word)


_left: list["subprocess.Popen[bytes]"] = []  # they end by themselves

"""The operator's page as its launcher has it: started before the kernels are compiled, and left to who still reads it.

The run does not need it: whatever becomes of it, the run goes on.
"""

import select
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from typing import NamedTuple

from robofleet.core.clock import Clock, S
from robofleet.operator.page.browser import open_page
from robofleet.operator.page.page_address import Addresses, address_lines
from robofleet.operator.terminal.terminal import Terminal
from robofleet.runs.children import Child

STAYS = "stays"  # what it says after the end of the run, where somebody looks
_LEAVE_WITHIN_S = 1.2
_LONGEST_WORD = 1024  # [bytes]
_GONE = "the page is gone, the run goes on: `robofleet web` opens another one"


class PageWanted(NamedTuple):
    """How the operator wants the page."""

    host: str  # which of this machine's addresses
    browser: bool  # open one


class PageProcess:
    """Hears in a thread where the page is, and opens it: the launcher may be compiling."""

    def __init__(self, child: Child, wanted: PageWanted, terminal: Terminal) -> None:
        self._child, self._wanted, self._terminal = child, wanted, terminal
        self._told = ""
        self._over = False
        self._hearing = threading.Thread(target=self._open, daemon=True)
        self._hearing.start()

    def tell(self, words: str) -> None:
        """Say what the launcher does, for as long as nobody else of the run speaks."""
        if words != self._told:
            self._told = words
            with suppress(OSError):
                self._child.lifeline.send(words.encode() + b"\n", socket.MSG_DONTWAIT)

    def look(self) -> None:
        """See whether it is there still."""
        if self._child.died:
            self._terminal.page, self._terminal.code = _GONE, ""

    def end(self) -> None:
        """Say that the run is over."""
        self._over = True
        with suppress(OSError):  # it is gone
            self._child.lifeline.shutdown(socket.SHUT_WR)

    def leave(self, clock: Clock) -> None:
        """Leave it to who looks at it after the end, or see it end; one that hangs is killed."""
        child = self._child
        self._hearing.join(_LEAVE_WITHIN_S)
        end_ns = clock.now_ns() + round(_LEAVE_WITHIN_S * S)
        said = b""
        with child.lifeline:
            while (left_s := (end_ns - clock.now_ns()) / S) > 0 and not self._hearing.is_alive():
                readable, _, _ = select.select([child.lifeline], [], [], left_s)
                with suppress(OSError):
                    said = child.lifeline.recv(_LONGEST_WORD) if readable else b""
                if not said or STAYS.encode() in said:
                    break
        if STAYS.encode() in said:
            _left.append(child.process)
            return
        try:
            child.process.wait(max(0.0, (end_ns - clock.now_ns()) / S))
        except subprocess.TimeoutExpired:
            child.process.kill()
            child.process.wait()

    def _open(self) -> None:
        try:
            said = self._child.lifeline.recv(_LONGEST_WORD)
        except OSError:
            return
        at = Addresses.read(said.decode(errors="replace"))
        if at is None or self._over:
            return
        opened = self._wanted.browser and sys.stderr.isatty() and open_page(at.once)
        self._terminal.page = address_lines(at, opened=opened)
        if at.viewer:  # a phone cannot reach the others
            self._terminal.code = at.page


_left: list["subprocess.Popen[bytes]"] = []  # they end by themselves

"""The launcher's side of a viewers' process. If that process fails, the run goes on."""

import socket
import subprocess
import threading
from contextlib import suppress

from robofleet.operator.terminal.terminal import Terminal
from robofleet.runs.children import Child

_LEAVE_WITHIN_S = 1.2
_LONGEST_WORD = 1024  # [bytes]
_GONE = "{0} sees nothing more, the run goes on: `robofleet {0}` serves it again; see {1}"


class ViewersProcess:
    """Hears in a thread where viewers find the run: the launcher may be compiling."""

    def __init__(self, child: Child, terminal: Terminal) -> None:
        self._child, self._terminal = child, terminal
        self._hearing = threading.Thread(target=self._hear, daemon=True)
        self._hearing.start()

    def look(self) -> None:
        """See whether it is there still."""
        if self._child.died:
            self._terminal.viewers[self._child.name] = _GONE.format(self._child.name, self._child.log)

    def end(self) -> None:
        """Say that the run is over."""
        with suppress(OSError):  # it is gone
            self._child.lifeline.shutdown(socket.SHUT_WR)

    def leave(self) -> None:
        """See it end; one that hangs is killed."""
        try:
            self._child.process.wait(_LEAVE_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._child.process.kill()
            self._child.process.wait()
        self._hearing.join()
        self._child.lifeline.close()

    def _hear(self) -> None:
        with suppress(OSError):
            said = self._child.lifeline.recv(_LONGEST_WORD).decode(errors="replace").strip()
            if said:
                self._terminal.viewers[self._child.name] = said

"""Stops a robot whose driver hangs or dies, for a robot that does not stop by itself soon enough.

A small process of its own inherits the open line. The driver gives it a sign of life with every ``write`` and ``read``.
When none has come for 0.2 s (the driver hangs, or is stopped), or when the driver is gone without a goodbye (kill -9),
it writes the robot's stop bytes. It goes on watching one that hangs, and ends 0.2 s after one that died.

What it cannot do: the cable is pulled, the computer dies, the robot takes no bytes, or both processes are killed at
once (a whole control group, for example). Then only the robot's own firmware can stop it, if it does.

Nothing old moves the robot when a driver that hung goes on. What it had written stands before the stop on the line.
What it was about to write comes after: choose stop bytes after which an old command moves nothing where the robot's
protocol has such. Its gate was held up too, and would now bring the robot to rest: ``allow`` keeps it at rest.
"""

import contextlib
import select
import socket
import subprocess
import sys
from pathlib import Path

from robofleet.drivers.dead_man_process import ALIVE, GOODBYE, READY, STOPPED
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds

SILENT_S = 0.2
"""A driver that gave no sign of life for so long hangs: its loop is 10 ms, and what a gate goes by is valid for 120."""
_START_S = 5.0
_END_S = 1.0
_BUSY_S = 0.05  # less than a gate waits for its driver
_OLD_NS = 300_000_000  # longer than a gate takes to rest, and than what it goes by is valid


class DeadMan:
    """One line's dead man: there from its making on, watching from the first sign of life on, until closed."""

    def __init__(self, descriptor: int, stop: bytes) -> None:
        self._signs, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-I", "-S", str(Path(__file__).with_name("dead_man_process.py"))),
                    *(str(descriptor), str(theirs.fileno()), stop.hex(), str(SILENT_S)),
                ],
                pass_fds=(descriptor, theirs.fileno()),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is the driver's
            )
        self._signs.settimeout(_START_S)
        try:
            ready = self._signs.recv(1) == READY
        except OSError:
            ready = False
        if not ready:
            self.close()
            raise DriverError(f"the dead man's process of its line does not start: {sys.executable} -I -S")
        self._signs.setblocking(False)
        self._stopped = False  # and nobody was told yet
        self._rests_until_ns = 0

    def sign(self) -> None:
        """Give a sign of life. Raises DriverError when nobody takes it: the robot must not move unwatched."""
        try:
            self._send_alive()
            with contextlib.suppress(BlockingIOError):
                self._stopped = self._signs.recv(1) == STOPPED or self._stopped
        except OSError as error:
            raise DriverError("the dead man's process of its line is gone: open the robot again") from error

    def _send_alive(self) -> None:
        try:
            self._signs.send(ALIVE)
        except BlockingIOError:  # hundreds are unread: on a busy machine it gets no processor for a moment
            select.select([], [self._signs], [], _BUSY_S)
            self._signs.send(ALIVE)

    def allow(self, wheels: WheelSpeeds, now_ns: int) -> WheelSpeeds:
        """Give a sign of life, and return what the robot may be told: rest, when it has just been stopped."""
        self.sign()
        if self._stopped:
            self._stopped, self._rests_until_ns = False, now_ns + _OLD_NS
        return STOP if now_ns < self._rests_until_ns else wheels

    def close(self) -> None:
        """Say goodbye, and wait for its end: then it does not hold the line any more. Idempotent."""
        with contextlib.suppress(OSError):  # it is gone already, or does not read: then it is killed
            self._signs.send(GOODBYE)
        self._signs.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

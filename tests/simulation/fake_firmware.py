"""The least firmware: ``left,right`` in hundredths of a rad/s and a line's end.

It answers its encoders' counts, and to nonsense what it feels.
"""

from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.interface import STOP, WheelSpeeds

_WATCHDOG_S = 0.5


class FakeFirmware:
    """Stops without a line for half a second; starts anew when its port is opened."""

    baud = 57600
    watchdog_s = _WATCHDOG_S

    def __init__(self, hardware: Hardware) -> None:
        self.hardware = hardware
        self.opened(0)

    def opened(self, now_ns: int) -> None:
        """Start anew."""
        self.hardware.command = STOP
        self._line = b""
        self._off_ns = 0

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take lines."""
        *lines, self._line = (self._line + data).split(b"\n")
        return b"".join(self._obeyed(line, now_ns) for line in lines)

    def _obeyed(self, line: bytes, now_ns: int) -> bytes:
        try:
            left, right = map(int, line.split(b","))
        except ValueError:
            return b"?%d\n" % self.hardware.feels
        self.hardware.command = WheelSpeeds(left / 100, right / 100)
        self._off_ns = now_ns + round(_WATCHDOG_S * 1e9)
        return b"%d,%d\n" % self.hardware.counts

    def loop(self, now_ns: int) -> bytes:
        """Stop when nothing has come for too long."""
        if now_ns >= self._off_ns:
            self.hardware.command = STOP
        return b""

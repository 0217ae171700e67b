"""The made-up robot of drivers/YOUR_OWN.md: its driver, as it stands there, and a twin's firmware.

It is as good as a serial robot can be, so the contract's checks are tried on it: ``broken.py`` spoils the driver.
"""

import re
import zlib
from pathlib import Path

from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.interface import STOP, WheelSpeeds

GUIDE = Path(__file__).parents[2] / "drivers" / "YOUR_OWN.md"
(CODE,) = re.findall(r"^```python\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)
exec(compile(CODE, str(GUIDE), "exec"), globals())  # defines Sparrow

_OFF_NS = 300_000_000


class SparrowFirmware:
    """Lines with a checksum: hears ``w LEFT RIGHT`` [mrad/s], says ``s LEFT RIGHT PERCENT`` in every loop."""

    baud = 115200
    watchdog_s: float | None = _OFF_NS * 1e-9

    def __init__(self, hardware: Hardware) -> None:
        self._hardware, self._rest, self._off_ns = hardware, b"", 0

    def opened(self, now_ns: int) -> None:
        self._rest = b""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        *lines, self._rest = (self._rest + data)[-256:].split(b"\n")
        for text, _, check in (line.rpartition(b" ") for line in lines):
            if text.startswith(b"w ") and check == b"%08x" % zlib.crc32(text):
                self._hardware.command = WheelSpeeds(*(1e-3 * int(field) for field in text.split()[1:]))
                self._off_ns = now_ns + _OFF_NS
        return b""

    def loop(self, now_ns: int) -> bytes:
        if now_ns >= self._off_ns:
            self._hardware.command = STOP
        text = b"s %d %d %d" % (*self._hardware.counts, round(100 * self._hardware.charge))
        return b"\n%b %08x\n" % (text, zlib.crc32(text))

"""A made-up robot that is as good as one can be: a driver and a firmware, to try the contract's checks on.

Lines with a checksum, both ways. The host says ``w LEFT RIGHT`` [mrad/s]; the robot says ``s LEFT RIGHT CHARGE`` in
every loop: encoders' counts, and the charge in per cent.
"""

import math
import zlib
from contextlib import suppress

from pydantic import BaseModel, ConfigDict, Field

from drivers.serial_port import SerialPort
from robofleet.simulation.firmware import Hardware
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, WheelSpeeds

BAUD = 115200
_OFF_NS = 300_000_000
_WINDOW = 10  # loops over which a speed is measured


def _framed(text: str) -> bytes:
    return f"\n{text} {zlib.crc32(text.encode()):08x}\n".encode()


def _fields(line: bytes, kind: bytes) -> list[int]:
    """Return the numbers of a sound line of that kind; none of any other."""
    text, _, check = line.rpartition(b" ")
    if not text.startswith(kind) or check != b"%08x" % zlib.crc32(text):
        return []
    return [int(field) for field in text.split()[1:]]


class LineSettings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)
    port: str
    counts_per_turn: float = Field(default=2800.0, gt=0.0, allow_inf_nan=False)


class LineRobot:
    """Drives it."""

    Settings = LineSettings
    silent_ns = 500_000_000
    greeting: bytes | None = None  # None: to stand

    def __init__(self, context: DriverContext) -> None:
        self._now_ns = context.now_ns
        self._scale = math.tau / context.settings.counts_per_turn
        self._rest, self.closed = b"", False
        self._counts: list[tuple[int, int, int]] = []  # instant, left, right
        self._first, self._charge = (0, 0), math.nan
        self._path = context.settings.port
        self._port = SerialPort(self._path, BAUD)
        try:
            self._greet()
        except BaseException:
            self.close()
            raise

    def write(self, wheels: WheelSpeeds) -> None:
        if self.closed:
            raise DriverError(f"{self._path}: closed")
        self._port.write(_framed(f"w {1e3 * wheels.left:.0f} {1e3 * wheels.right:.0f}"))

    def read(self) -> DriverReading:
        if self.closed:
            raise DriverError(f"{self._path}: closed")
        self._listen()
        if self._now_ns() - self._counts[-1][0] > self.silent_ns:
            raise DriverError(f"{self._path}: the robot does not answer: look at its power and its cable")
        (then_ns, then_left, then_right), (now_ns, left, right) = self._counts[0], self._counts[-1]
        per_s = 1e9 * self._scale / max(1, now_ns - then_ns)
        angles = (self._scale * (left - self._first[0]), self._scale * (right - self._first[1]))
        return DriverReading(*angles, per_s * (left - then_left), per_s * (right - then_right), self._charge, 0)

    def close(self) -> None:
        if not self.closed:
            with suppress(DriverError):
                self.write(STOP)
            self.closed = True
            self._port.close()

    def _greet(self) -> None:
        deadline_ns = self._now_ns() + 1_000_000_000
        while not self._counts:
            self._port.write(_framed("w 0 0") if self.greeting is None else self.greeting)
            self._port.wait(0.05)
            self._listen()
            if not self._counts and self._now_ns() > deadline_ns:
                raise DriverError(f"{self._path}: what answers there is no line robot: mend settings.port")
        self._first = self._counts[0][1:]

    def _listen(self) -> None:
        *lines, self._rest = (self._rest + self._port.read())[-4096:].split(b"\n")
        for line in lines:
            if fields := self._fields(line):
                left, right, charge = fields
                self._counts.append((self._now_ns(), left, right))
                self._charge = charge / 100
        del self._counts[:-_WINDOW]

    def _fields(self, line: bytes) -> list[int]:
        return _fields(line, b"s ")


class LineFirmware:
    """Is it."""

    baud = BAUD
    watchdog_s: float | None = 0.3

    def __init__(self, hardware: Hardware) -> None:
        self._hardware, self._rest, self._off_ns = hardware, b"", 0

    def opened(self, now_ns: int) -> None:
        self._rest = b""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        *lines, self._rest = (self._rest + data)[-256:].split(b"\n")
        for line in lines:
            if fields := _fields(line, b"w "):
                self._hardware.command = WheelSpeeds(1e-3 * fields[0], 1e-3 * fields[1])
                self._off_ns = now_ns + _OFF_NS
        return b""

    def loop(self, now_ns: int) -> bytes:
        if now_ns >= self._off_ns:
            self._hardware.command = STOP
        left, right = self._hardware.counts
        return _framed(f"s {left} {right} {100 * self._hardware.charge:.0f}")

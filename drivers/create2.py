"""iRobot Create 2 (Open Interface, 115200 baud): wheels in mm/s, what it feels from a stream every 15 ms.

Nothing in the interface tells an opcode from data, and nothing is acknowledged. A command that lost bytes on its way
would eat those of the next one, and what is left of that would be opcodes: 135, of 135 mm/s, starts to clean. So each
write begins with as many zeros as a broken command can lack: they complete it (a wheel that went forward stands or is
slower, one that went backward gets -256 mm/s) until the command behind them comes, 0.8 ms later. As opcodes they are
none. Changed bytes cannot be told from right ones: they stand until the next write.

The robot does not stop by itself when nobody talks to it: ``dead_man.py`` does, while the computer lives.
"""

import contextlib
import math
import struct
from collections import deque
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from drivers.dead_man import DeadMan
from drivers.serial_port import SerialPort
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import DriverContext, DriverError, DriverReading, RobotFault, WheelSpeeds

MODE_LOST = RobotFault.OWN
"""It is not in its mode and does not return to it: somebody pressed its buttons, or it saves power."""

_BAUD = 115200
_FASTEST_MM_S = 500
_MODES = {"safe": 2, "full": 3}  # as packet 35 says them; their opcodes are 129 more
_START, _MODE, _DRIVE, _STREAM, _STOP_OI = 128, 129, 145, 148, 173
_LACK = bytes(4)  # what a broken command lacks at most
_ANY_LACK = bytes(16)  # what a broken list of packets lacks at most
_STOP = _ANY_LACK + struct.pack(">Bhh", _DRIVE, 0, 0) + bytes((_START,))  # passive: an old command moves nothing
_ANSWER_NS, _GREET_NS, _STALE_NS = 1_000_000_000, 100_000_000, 500_000_000
_MODE_LOST_NS = 100_000_000
_OVERCURRENT_NS = 300_000_000  # shorter ones are the start of a motor, or noise: real ones report them on the way
_SPEED_NS = 100_000_000  # one count in it is 0.12 rad/s
_SLACK_S = 0.1  # what is read may be older than what was read before by so much less
_FASTEST_RAD_S = 30.0  # twice what its motors do: pushed by hand

_BYTES, _WORDS = (7, 9, 10, 11, 12, 14, 34, 35), (25, 26, 43, 44)
_IDS = _BYTES + _WORDS
_MOST = (15, 1, 1, 1, 1, 31, 3, 3)  # of the bytes' values; more is garbage that adds up
_FRAME = struct.Struct(">BB" + "BB" * len(_BYTES) + "BH" * len(_WORDS) + "B")
_HEADER = bytes((19, _FRAME.size - 3))
_GREETING = bytes((_STREAM, len(_IDS), *_IDS))


class Settings(BaseModel):
    """What ``robots[].settings`` may say."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)

    port: Annotated[str, Field(min_length=1)]
    """Its serial line, such as /dev/serial/by-id/usb-FTDI_..."""
    mode: Literal["safe", "full"] = "safe"
    """``safe``: at a cliff, lifted, or at its charger it stops by itself; ``full``: it does not."""
    wheel_diameter_m: Annotated[float, Field(gt=0.03, lt=0.3, allow_inf_nan=False)] = 0.072
    """By which it makes mm/s of its wheels' turning; the published one. What was calibrated is not meant."""
    counts_per_turn: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 508.8
    """Encoder counts of a wheel's turn; the published number."""


class Frame(NamedTuple):
    """What the robot streams."""

    touch: int  # right bumper 1, left bumper 2, right wheel dropped 4, left wheel dropped 8
    cliffs: tuple[int, int, int, int]
    overcurrent: int  # left wheel 16, right wheel 8
    chargers: int
    mode: int
    charge: int  # [mAh]
    capacity: int  # [mAh]
    counts: tuple[int, int]  # left, right; modulo 65536


class Stream:
    """Finds frames in what comes. It falls into step again after lost and changed bytes."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that ``data`` completes."""
        self._bytes += data
        frames = []
        while len(self._bytes) >= _FRAME.size:
            frame = _frame(self._bytes[: _FRAME.size])
            if frame is None:
                start = self._bytes.find(_HEADER, 1)
                del self._bytes[: start if start > 0 else len(self._bytes) - 1]
            else:
                frames.append(frame)
                del self._bytes[: _FRAME.size]
        return frames


def _frame(data: bytes | bytearray) -> Frame | None:
    values = _FRAME.unpack(data)
    if data[:2] != _HEADER or sum(data) % 256 or values[2:-1:2] != _IDS:
        return None
    touch, *cliffs, overcurrent, chargers, mode, charge, capacity, left, right = values[3:-1:2]
    if any(value > most for value, most in zip(values[3::2], _MOST, strict=False)):
        return None
    return Frame(touch, (*cliffs,), overcurrent, chargers, mode, charge, capacity, (left, right))


class Create2:
    """One Create 2. Its angles count from its opening on."""

    def __init__(self, context: DriverContext) -> None:
        settings: Settings = context.settings
        self._now_ns, self._name = context.now_ns, settings.port
        self._mm_per_rad = 500.0 * settings.wheel_diameter_m
        self._rad_per_count = math.tau / settings.counts_per_turn
        self._limit_mm_s = min(_FASTEST_MM_S, math.floor(context.drive.max_wheel_speed * self._mm_per_rad))
        self._mode = _MODES[settings.mode]
        self._stream = Stream()
        self._frame: Frame | None = None
        self._turned = (0, 0)  # counts
        self._past = deque[tuple[int, tuple[int, int]]]()  # when, and counts
        self._faults = RobotFault(0)
        self._at_ns = self._greeted_ns = self._well_ns = self._free_ns = context.now_ns()
        self._closed = False
        self._port = SerialPort(settings.port, _BAUD)
        try:
            self._wait_for_answer()
            self._dead_man = DeadMan(self._port.descriptor, _STOP)
        except BaseException:
            self._port.close()
            raise

    @staticmethod
    def refusals(settings: Settings, drive: DifferentialDrive) -> list[tuple[str, str]]:
        """Return what cannot work."""
        most = _FASTEST_MM_S / (500.0 * settings.wheel_diameter_m)
        if drive.max_wheel_speed <= most:
            return []
        return [("vehicle.max_wheel_speed_rad_s", f"a Create 2 turns its wheels at {most:.1f} rad/s at most: lower it")]

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s], rounded to 1 mm/s; if it lost its mode by itself, put it back into it first."""
        self._dead_man.sign()
        astray = self._frame is not None and self._frame.mode != self._mode and not self._faults & ~MODE_LOST
        mode = bytes((_MODE + self._mode,)) if astray else b""
        right, left = self._mm_s(wheels.right), self._mm_s(wheels.left)
        self._port.write(_LACK + mode + struct.pack(">Bhh", _DRIVE, right, left))

    def read(self) -> DriverReading:
        """Return what it streamed last; what it felt since the last call counts."""
        self._dead_man.sign()
        now_ns = self._now_ns()
        self._listen(now_ns)
        if now_ns - self._at_ns > _STALE_NS:
            raise DriverError(f"{self._name}: the Create 2 has said nothing for 0.5 s: is it on, does it sleep?")
        if now_ns - max(self._at_ns, self._greeted_ns) > _GREET_NS:
            self._greet(now_ns)
        return self._reading()

    def close(self) -> None:
        """Motors off, interface off. Idempotent."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DriverError):  # the line is gone: nobody can tell it anything
            self._port.write(_STOP + bytes((_STOP_OI,)))
        self._dead_man.close()
        self._port.close()

    def _wait_for_answer(self) -> None:
        self._greet(began_ns := self._now_ns())
        while self._frame is None:
            now_ns = self._now_ns()
            if now_ns - began_ns > _ANSWER_NS:
                raise DriverError(
                    f"{self._name}: what answers there is no Create 2 (or it sleeps: press its Clean button)"
                )
            if now_ns - self._greeted_ns > _GREET_NS:
                self._greet(now_ns)
            self._port.wait(0.02)
            self._listen(self._now_ns())

    def _greet(self, now_ns: int) -> None:
        """Stop it, whatever it did, and let it stream, whatever it did not understand."""
        self._greeted_ns = now_ns
        self._port.write(_STOP + bytes((_MODE + self._mode,)) + _GREETING)

    def _listen(self, now_ns: int) -> None:
        faults = RobotFault(0)
        for frame in self._stream.feed(self._port.read()):
            if self._adopt(frame, now_ns):
                faults |= self._felt(frame, now_ns)
                self._faults = faults

    def _adopt(self, frame: Frame, now_ns: int) -> bool:
        """Count on; returns whether it can be: no wheel turns that fast."""
        before = frame.counts if self._frame is None else self._frame.counts
        left, right = ((new - old + 32768) % 65536 - 32768 for new, old in zip(frame.counts, before, strict=True))
        most = _FASTEST_RAD_S * ((now_ns - self._at_ns) * 1e-9 + _SLACK_S) / self._rad_per_count
        if max(abs(left), abs(right)) > most:
            return False
        self._turned = (self._turned[0] + left, self._turned[1] + right)
        self._frame, self._at_ns = frame, now_ns
        if self._past and self._past[-1][0] == now_ns:
            self._past.pop()
        self._past.append((now_ns, self._turned))
        while len(self._past) > 2 and now_ns - self._past[1][0] >= _SPEED_NS:
            self._past.popleft()
        return True

    def _felt(self, frame: Frame, now_ns: int) -> RobotFault:
        faults = RobotFault(0)
        if frame.touch & 0b0011:
            faults |= RobotFault.BUMPED
        if frame.touch & 0b1100:
            faults |= RobotFault.WHEEL_DROPPED
        if any(frame.cliffs):
            faults |= RobotFault.CLIFF
        if frame.chargers:
            faults |= RobotFault.CHARGING
        if not frame.overcurrent & 0b11000:
            self._free_ns = now_ns
        if now_ns - self._free_ns > _OVERCURRENT_NS:
            faults |= RobotFault.OVERCURRENT
        if frame.mode == self._mode:
            self._well_ns = now_ns
        if now_ns - self._well_ns > _MODE_LOST_NS:
            faults |= MODE_LOST
        return faults

    def _reading(self) -> DriverReading:
        assert self._frame is not None
        (then_ns, (left_then, right_then)), (left, right) = self._past[0], self._turned
        seconds = max(self._at_ns - then_ns, 1) * 1e-9
        scale, capacity = self._rad_per_count, self._frame.capacity
        return DriverReading(
            left * scale,
            right * scale,
            (left - left_then) * scale / seconds,
            (right - right_then) * scale / seconds,
            min(1.0, self._frame.charge / capacity) if capacity else math.nan,
            int(self._faults),
        )

    def _mm_s(self, speed: float) -> int:
        return max(-self._limit_mm_s, min(self._limit_mm_s, round(speed * self._mm_per_rad)))

"""iRobot Create 2 (Open Interface, 115200 baud): wheels in mm/s; what it feels, from a stream every 15 ms.

Nothing in the interface tells an opcode from data, nothing is acknowledged, and no command has a checksum.

Lost bytes. A broken command would eat those of the next one, and what is left of that would be opcodes: 135, of
135 mm/s, starts to clean. So a write begins with as many zeros as a broken command can lack, unless the robot has shown
that it went by the last one; and what it goes by already is not said again: each byte that noise can change may become
any opcode. The zeros complete a broken command: a wheel that was to go forward stands or is slower, one that was to go
backward gets -256 mm/s. As opcodes they are none. The command behind them heals it 0.8 ms after the first of them.

Changed bytes cannot be told from right ones, and the robot does what they say: wrong wheel speeds, another mode, even
to clean. It says by which wheel speeds it goes, and in which mode: what it was never told is answered with the command
once more, 25 ms later at most if no frame is lost.

It does not stop by itself when nobody talks to it: ``dead_man.py`` stops it, while the computer lives.
"""

import contextlib
import math
import struct
from collections import deque
from functools import reduce
from operator import or_
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from robofleet.drivers.create2_stream import PACKETS, Frame, Stream
from robofleet.drivers.dead_man import DeadMan
from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, RobotFault, WheelSpeeds

MODE_LOST = RobotFault.OWN
"""It is not in its mode and does not come back to it: somebody presses its buttons, or its battery is empty."""

_BAUD = 115200
_FASTEST_MM_S = 500
_PASSIVE, _MODES = 1, {"safe": 2, "full": 3}  # as packet 35 says them; the latters' opcodes are 129 more
_START, _MODE, _DRIVE, _STREAM, _STOP_OI = 128, 129, 145, 148, 173
_LACK = bytes(4)  # what a broken command lacks at most
_LIST_LACK = bytes(16)  # what a broken subscription lacks
_SWALLOWED = bytes(64)  # for an opcode that garbage made, which swallows up to 512 bytes: it is fed
_SUBSCRIPTION = bytes((_STREAM, len(PACKETS), *PACKETS))
# Motors off, then passive: an old command that a driver still writes after a hang moves nothing.
MOTORS_OFF = _LIST_LACK + struct.pack(">Bhh", _DRIVE, 0, 0) + bytes((_START,))

_ANSWER_NS, _STALE_NS = 1_000_000_000, 500_000_000
_SILENT_NS = _GREET_NS = 100_000_000
_VALID_NS = 100_000_000  # it may still go by what it was told so long ago: lines are late
_MODE_LOST_NS = 100_000_000
_AGAIN_NS = 30_000_000  # the gate tells its ramp every 5 ms, which is often the same in mm/s
_STOP_PATIENCE_NS, _STOP_TRIES = 50_000_000, 4
_OVERCURRENT_NS = 300_000_000  # shorter ones are a motor's start, or noise
_SPEED_WINDOW_NS = 100_000_000  # one count in it is 0.12 rad/s
_FASTEST_RAD_S = 30.0  # twice what its motors do: pushed by hand
_FRAME_DELAY_S = 0.1  # at most, beyond the time since the last one


class Create2:
    """One Create 2. Its angles count from its opening on."""

    concurrent: ClassVar[bool] = True

    class Settings(BaseModel):
        """What ``robots[].settings`` may say."""

        model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)

        port: Annotated[str, Field(min_length=1)]
        """Its serial line, such as /dev/serial/by-id/usb-FTDI_..."""
        mode: Literal["safe", "full"] = "safe"
        """``safe``: at a cliff, lifted, or at its charger it stops by itself; ``full``: it does not."""
        wheel_diameter_m: Annotated[float, Field(gt=0.03, lt=0.3)] = 0.072
        """By which its firmware makes turning of mm/s; the published one. What was calibrated is not meant."""
        counts_per_turn: Annotated[float, Field(gt=1, lt=1e6)] = 508.8
        """Encoder counts of a wheel's turn; the published number."""

    def __init__(self, context: DriverContext) -> None:
        settings: Create2.Settings = context.settings
        self._now_ns, self._name = context.now_ns, settings.port
        self._mm_per_rad = 500.0 * settings.wheel_diameter_m
        self._rad_per_count = math.tau / settings.counts_per_turn
        self._limit_mm_s = min(_FASTEST_MM_S, math.floor(context.drive.max_wheel_speed * self._mm_per_rad))
        self._mode = _MODES[settings.mode]
        self._stream = Stream()
        self._frame: Frame | None = None
        self._faults = RobotFault(0)
        self._turned = (0, 0)  # counts
        self._at_ns = self._well_ns = self._free_ns = context.now_ns()
        self._greeted_ns = self._at_ns - _GREET_NS
        self._past = deque[tuple[int, tuple[int, int]]]()  # when it had turned how far
        self._wheels = STOP
        self._requested = (0, 0)  # the same: right, left [mm/s]
        self._sent_at_ns: dict[tuple[int, int], int] = {}  # and lately, with when last
        self._sent: tuple[int, int] | None = None  # by the newest command, and when
        self._sent_ns = 0
        self._new = False  # it was not told that before, lately
        self._proof: tuple[int, int] | None = None  # what nothing but the newest command can have made it say,
        self._obeyed = False  # and it has said that since: it need not be told again
        self._closed = False
        self._port = SerialPort(settings.port, _BAUD)
        try:
            self._wait_for_answer()
            self._dead_man = DeadMan(self._port.descriptor, MOTORS_OFF)
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
        """Command the wheels [rad/s], rounded to 1 mm/s: in a platoon that costs 0.001 mm, so none is carried."""
        now_ns = self._now_ns()
        self._aim(wheels, now_ns)
        self._listen(now_ns)
        if self._requested != self._sent or not (self._obeyed or now_ns - self._sent_ns < _AGAIN_NS):
            self._tell(now_ns)

    def read(self) -> DriverReading:
        """Return what it streamed last, with all that it felt since the last call."""
        now_ns = self._now_ns()
        self._aim(self._wheels, now_ns)
        self._listen(now_ns)
        silent_ns = now_ns - self._at_ns
        if silent_ns > _STALE_NS:
            raise DriverError(f"{self._name}: the Create 2 has said nothing for 0.5 s: is it on, does it sleep?")
        if silent_ns > _SILENT_NS:
            self._greet(now_ns)
        elif self._astray or self._misled:
            self._tell(now_ns, _SWALLOWED)
        return self._reading()

    def close(self) -> None:
        """Motors off, interface off. Idempotent."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(DriverError):  # the line is gone: nobody can tell it anything
            any(self._obeys_motors_off() for _ in range(_STOP_TRIES))
            self._port.write(bytes((_STOP_OI,)))
        self._dead_man.close()
        self._port.close()

    def _obeys_motors_off(self) -> bool:
        """Take its motors; returns whether it then says that it is passive."""
        self._port.write(MOTORS_OFF)
        until_ns = self._now_ns() + _STOP_PATIENCE_NS
        while (left_ns := until_ns - self._now_ns()) > 0 and self._port.wait(left_ns * 1e-9):
            self._listen(self._now_ns())
            if self._frame is not None and self._frame.mode == _PASSIVE:
                return True
        return False

    def _wait_for_answer(self) -> None:
        began_ns = self._now_ns()
        self._greet(began_ns)
        while self._frame is None:
            self._port.wait(0.02)
            now_ns = self._now_ns()
            self._listen(now_ns)
            self._greet(now_ns)
            if now_ns - began_ns > _ANSWER_NS:
                raise DriverError(
                    f"{self._name}: the device that answers is not a Create 2 (or it sleeps: press its Clean button)"
                )

    def _greet(self, now_ns: int) -> None:
        """Stop it, whatever it does, and let it stream, whatever it did not understand; once in a while."""
        if now_ns - self._greeted_ns < _GREET_NS:
            return
        self._greeted_ns = now_ns
        self._sent = self._proof = None
        self._obeyed = False
        self._port.write(MOTORS_OFF + bytes((_MODE + self._mode,)) + _SUBSCRIPTION)

    def _aim(self, wheels: WheelSpeeds, now_ns: int) -> None:
        """Take what the robot is to do from now on."""
        self._wheels = self._dead_man.allow(wheels, now_ns)
        self._requested = self._mm_s(self._wheels.right), self._mm_s(self._wheels.left)
        self._sent_at_ns = {speeds: at_ns for speeds, at_ns in self._sent_at_ns.items() if now_ns - at_ns <= _VALID_NS}
        self._new = self._requested not in self._sent_at_ns
        self._sent_at_ns[self._requested] = now_ns

    def _tell(self, now_ns: int, more: bytes = b"") -> None:
        """Say it, and bring the robot back into its mode if that must be."""
        mode = bytes((_MODE + self._mode,)) if self._astray else b""
        lack = b"" if self._obeyed else _LACK
        self._sent, self._sent_ns = self._requested, now_ns
        self._obeyed, self._proof = False, self._requested if self._new else None
        self._port.write(lack + mode + struct.pack(">Bhh", _DRIVE, *self._requested) + more)

    @property
    def _astray(self) -> bool:
        """Whether it left its mode, and no reason is known."""
        return self._frame is not None and self._frame.mode != self._mode and not self._faults & ~MODE_LOST

    @property
    def _misled(self) -> bool:
        """Whether it goes by wheel speeds that it was never told, or too long ago."""
        frame = self._frame
        if frame is None or frame.mode != self._mode:
            return False
        return (frame.right_requested, frame.left_requested) not in self._sent_at_ns

    def _listen(self, now_ns: int) -> None:
        frames = self._stream.feed(self._port.read())
        faults = [self._felt(frame, now_ns) for frame in frames if self._count(frame, now_ns)]
        if faults:
            self._faults = reduce(or_, faults)

    def _count(self, frame: Frame, now_ns: int) -> bool:
        """Count on; returns whether that can be: no wheel turns faster."""
        last = self._frame or frame
        left = _wrapped(frame.left_counts - last.left_counts)
        right = _wrapped(frame.right_counts - last.right_counts)
        seconds = (now_ns - self._at_ns) * 1e-9 + _FRAME_DELAY_S
        if max(abs(left), abs(right)) * self._rad_per_count > _FASTEST_RAD_S * seconds:
            return False
        self._turned = (self._turned[0] + left, self._turned[1] + right)
        self._frame, self._at_ns = frame, now_ns
        self._obeyed = self._obeyed or self._proof == (frame.right_requested, frame.left_requested)
        if self._past and self._past[-1][0] == now_ns:
            self._past.pop()
        self._past.append((now_ns, self._turned))
        while len(self._past) > 2 and now_ns - self._past[1][0] >= _SPEED_WINDOW_NS:
            self._past.popleft()
        return True

    def _felt(self, frame: Frame, now_ns: int) -> RobotFault:
        """Return what is wrong with it; what flickers in health, only when it lasts."""
        if not frame.overcurrent & 0b11000:
            self._free_ns = now_ns
        cliffs = (frame.cliff_left, frame.cliff_front_left, frame.cliff_front_right, frame.cliff_right)
        present = {
            RobotFault.BUMPED: frame.touch & 0b0011,
            RobotFault.WHEEL_DROPPED: frame.touch & 0b1100,
            RobotFault.CLIFF: any(cliffs),
            RobotFault.CHARGING: frame.chargers,
            RobotFault.OVERCURRENT: now_ns - self._free_ns > _OVERCURRENT_NS,
        }
        faults = reduce(or_, (fault for fault, active in present.items() if active), RobotFault(0))
        if faults or frame.mode == self._mode:
            self._well_ns = now_ns
        return faults or (MODE_LOST if now_ns - self._well_ns > _MODE_LOST_NS else RobotFault(0))

    def _reading(self) -> DriverReading:
        assert self._frame is not None
        (then_ns, then), turned = self._past[0], self._turned
        scale, capacity = self._rad_per_count, self._frame.capacity
        rate = scale / (max(self._at_ns - then_ns, 1) * 1e-9)
        return DriverReading(
            scale * turned[0],
            scale * turned[1],
            rate * (turned[0] - then[0]),
            rate * (turned[1] - then[1]),
            min(1.0, self._frame.charge / capacity) if capacity else math.nan,
            int(self._faults),
        )

    def _mm_s(self, speed: float) -> int:
        return max(-self._limit_mm_s, min(self._limit_mm_s, round(speed * self._mm_per_rad)))


def _wrapped(counts: int) -> int:
    return (counts + 32768) % 65536 - 32768

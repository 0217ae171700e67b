"""Robots with an Arduino that runs ros_arduino_bridge: letters and numbers on a serial line, no checksum.

Source: github.com/hbrobotics/ros_arduino_bridge. ``m L R`` sets both wheels' targets in encoder counts per frame of the
speed loop, ``e`` asks for the counts, ``b`` for the baud rate, ``u`` sets the loop's gains; a CR ends a command, and
each has one answer. Without an ``m`` for 2 s the sketch stops its motors. Which wheel is the left one, and which way it
turns, is settled in the sketch and at the motors' wires.

Counts per frame are integers. What rounding leaves over is carried to the next command, so that the wheels turn as far
as they were told to; a wheel that is told 0 gets 0.

A line that lost its end stays in the sketch, and swallows the next one. Therefore, while anything that was said is
unanswered, the next line begins with a question of its own, ``?`` (which is no command) and ``b`` in turn: it ends the
broken rest, and its answer says to what the later ones belong. A broken ``m`` is carried out by that, until the line
behind it is complete 2 ms later: with each wheel as fast as told at most, in no other direction. If the speed loop
looks just then, it takes that for a frame, or stops.

The comma in ``m 12, 34`` ends the first number, and nothing else: no single wrong bit can then make one number out of
two, which would be full speed. Wrong digits nobody notices: they hold until the next command, with as many digits at
most.
"""

import itertools
import math
import re
from collections import deque
from contextlib import suppress
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from robofleet.drivers.arduino_counts import Encoders, Rounding
from robofleet.drivers.dead_man import DeadMan
from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import DriverContext, DriverError, DriverReading, WheelSpeeds

_BAUD = 57600
_BOOT_NS = 6_000_000_000  # of patience: opening the port resets the board, whose boot loader takes up to 2 s
_ASK_AGAIN_S = 0.3
_AGAIN_NS = 20_000_000  # the wheels are told the same, and the counts asked for, so often: half of the line is free
_UNANSWERED_NS = 100_000_000  # then no answer is expected any more
_SILENT_NS = 500_000_000
_STOP_TRIES, _STOP_PATIENCE_S = 3, 0.02
_LONGEST_ANSWER = 64  # [bytes]
_MOST_COUNTS = 32767  # per frame: the sketch's integers
_Gain = Annotated[int, Field(ge=0, le=999)]  # older sketches hold 15 characters of all four
_Divisor = Annotated[int, Field(ge=1, le=999)]

_RATE, _WHAT, _DONE, _COUNTS = "baud rate", "invalid", "OK", "counts"
_MARKS = (_WHAT, b"?\r"), (_RATE, b"b\r")
_ANSWERS = {
    _RATE: re.compile(rb" ?%d\r" % _BAUD),
    _WHAT: re.compile(rb"Invalid Command\r"),
    _DONE: re.compile(rb"OK\r"),
    _COUNTS: re.compile(rb"(-?\d{1,10}) (-?\d{1,10})\r"),
}
_STAND = b"?\rm 0 0\r"


class ArduinoBridge:
    """One robot with this sketch."""

    concurrent: ClassVar[bool] = True

    class Settings(BaseModel):
        """What the robot is connected to, and what was built into its sketch."""

        model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)

        port: Annotated[str, Field(min_length=1)]
        """The serial port of its Arduino."""
        counts_per_turn: Annotated[float, Field(gt=0, allow_inf_nan=False)]
        """Encoder counts in one turn of a wheel, gear included."""
        pid_rate_hz: Annotated[int, Field(ge=1, le=1000)] = 30
        """As compiled into its sketch (``PID_RATE``)."""
        gains: Annotated[tuple[_Gain, _Gain, _Gain, _Divisor] | None, Field(strict=False)] = None
        """Kp, Kd, Ki, Ko of its speed loop, told at opening; null: those of the sketch."""

        @property
        def frame_s(self) -> float:
            """The speed loop's period [s]: the sketch has whole milliseconds."""
            return 1000 // self.pid_rate_hz / 1000

    def __init__(self, context: DriverContext) -> None:
        settings: ArduinoBridge.Settings = context.settings
        self._now_ns, self._name = context.now_ns, settings.port
        self._frame_ns = settings.frame_s * 1e9
        self._counts_per_rad = settings.counts_per_turn / math.tau
        self._left, self._right = Rounding(), Rounding()
        self._target, self._sent_ns, self._aimed_ns = (0, 0), 0, 0
        self._encoders = Encoders(self._counts_per_rad, context.drive.max_wheel_speed)
        self._requested_ns = 0
        self._rest = b""
        self._talks = False  # it has said something, whatever that was
        self._unanswered: deque[tuple[str, int]] = deque()  # what, and when it was asked
        self._marks = itertools.cycle(_MARKS)
        self._closed = False
        self._line = SerialPort(settings.port, _BAUD)
        try:
            self._meet(settings)
            self._dead_man = DeadMan(self._line.descriptor, _STAND)
        except BaseException:
            self._line.close()
            raise

    @staticmethod
    def refusals(settings: Settings, drive: DifferentialDrive) -> list[tuple[str, str]]:
        """Return why these encoders and this frame cannot drive this robot."""
        fastest = drive.max_wheel_speed * settings.frame_s * settings.counts_per_turn / math.tau
        if 1.0 <= fastest <= _MOST_COUNTS:
            return []
        why = f"its fastest wheel makes {fastest:.3g} counts a frame; 1 to {_MOST_COUNTS} can be told: mend it"
        return [("settings.counts_per_turn", why)]

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s]; the same again is not told more than 50 times a second."""
        now_ns = self._listen()
        wheels = self._dead_man.allow(wheels, now_ns)
        frames = min(1.0, max(0.0, (now_ns - self._aimed_ns) / self._frame_ns))
        per_frame = self._counts_per_rad * self._frame_ns * 1e-9
        target = self._left(wheels.left * per_frame, frames), self._right(wheels.right * per_frame, frames)
        self._aimed_ns = now_ns
        if target != self._target or not 0 <= now_ns - self._sent_ns < _AGAIN_NS:
            self._say(_DONE, b"m %d, %d\r" % target)
            self._target, self._sent_ns = target, now_ns

    def read(self) -> DriverReading:
        """Return angles and speeds; the battery it cannot tell."""
        now_ns = self._listen()
        self._dead_man.sign()
        if self._requested_ns - self._encoders.at_ns > _SILENT_NS:
            raise DriverError(
                f"{self._name}: no possible encoder counts came for {_SILENT_NS * 1e-9:.1f} s: "
                "is the robot on, and its cable good?"
            )
        # a question behind a motion that was cut would end that one: the next motion, which is near, shall do it
        moving = any(answer == _DONE for answer, _ in self._unanswered)
        if not 0 <= now_ns - self._requested_ns < (_UNANSWERED_NS if moving else _AGAIN_NS):
            self._say(_COUNTS, b"e\r")
            self._requested_ns = now_ns
        return DriverReading(*self._encoders.angles, *self._encoders.speeds, math.nan, 0)

    def close(self) -> None:
        """Motors off: told until it answers."""
        if self._closed:
            return
        with suppress(DriverError):
            any(self._obeys(_DONE, b"m 0 0\r", _STOP_PATIENCE_S) for _ in range(_STOP_TRIES))
        self._closed = True
        self._dead_man.close()
        self._line.close()

    def _meet(self, settings: Settings) -> None:
        """Let the board start, let the robot stand, and find out what it has counted."""
        exchange = [(_RATE, b"b\r"), (_DONE, b"m 0 0\r"), (_COUNTS, b"e\r")]
        if settings.gains is not None:
            exchange.append((_DONE, b"u %d:%d:%d:%d\r" % settings.gains))
        until_ns = self._now_ns() + _BOOT_NS
        for answer, line in exchange:
            while not self._obeys(answer, line, _ASK_AGAIN_S):
                if self._now_ns() < until_ns:
                    continue
                if self._talks:
                    raise DriverError(f"{self._name}: the device that answers does not speak ros_arduino_bridge")
                raise DriverError(f"{self._name}: nothing answers there: switch the robot on, and look at its cable")

    def _obeys(self, answer: str, line: bytes, patience_s: float) -> bool:
        """Say a line and wait for its answer."""
        self._say(answer, line)
        request = self._unanswered[-1]
        until_ns = self._now_ns() + round(patience_s * 1e9)
        while request in self._unanswered:
            left_s = (until_ns - self._now_ns()) * 1e-9
            if left_s <= 0.0 or not self._line.wait(left_s):
                return False
            self._listen()
        return True

    def _say(self, answer: str, line: bytes) -> None:
        now_ns = self._now_ns()
        if self._unanswered:
            mark, question = next(self._marks)
            line = question + line
            while self._unanswered and now_ns - self._unanswered[0][1] > _UNANSWERED_NS:
                self._unanswered.popleft()
            self._unanswered.append((mark, now_ns))
        self._line.write(line)
        self._unanswered.append((answer, now_ns))

    def _listen(self) -> int:
        """Take what has come; returns the instant."""
        if self._closed:
            raise DriverError(f"{self._name}: it is closed")
        received = self._line.read()
        self._talks = self._talks or bool(received)
        *lines, rest = (self._rest + received).split(b"\n")
        self._rest = rest[-_LONGEST_ANSWER:]
        for line in lines:
            for kind, shape in _ANSWERS.items():
                if words := shape.fullmatch(line):
                    self._take(kind, words)
        return self._now_ns()

    def _take(self, kind: str, words: re.Match[bytes]) -> None:
        """Take an answer, to the oldest question that it can belong to; those before will get none any more."""
        while any(kind == waiting for waiting, _ in self._unanswered):
            waiting, requested_ns = self._unanswered.popleft()
            if waiting == kind:
                if kind == _COUNTS:
                    self._encoders.take(requested_ns, int(words[1]), int(words[2]))
                return

"""GTernal, the Robotarium's robot: JSON on the serial line between its computer and its motor controller.

Source: the public firmware (github.com/robotarium/GTernal, Teensy). A line asks several things at once,
``{"request": ["write", "read"], "iface": ["motor", "batt_volt"], "body": [{"v": .., "w": ..}, {}]}``, and gets one
answer, ``{"status": [1, 1], "body": [{}, {"batt_volt": ..}]}``, with nothing after it. What it does not understand it
answers with empty lists. It tells nothing of its encoders: angles and speeds are 0, which is how the rest of robofleet
knows a robot without encoders. Of its other sensors it tells ``distances``, a list in metres, and ``orientation``, the
heading in degrees, clockwise from a zero of its own, before two tilts; they are asked in the same line, where somebody
wants to know.

Its 500 ms stop starts anew with every ``write``, whatever is written, and with no ``read``. So the driver writes
nothing but what the gate tells it to: a lamp that blinks would keep a robot going that nobody drives any more.
"""

import json
import math
from contextlib import suppress
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.differential_drive import DifferentialDrive, body_from_wheels
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, WheelSpeeds
from robofleet.vehicles.readings import SensorReading
from robofleet.vehicles.sensors import MOST_DISTANCES

_BAUD = 500_000
_SILENT_NS = 500_000_000  # unanswered for so long, it is lost; what its sensors told is too old then
_ALONE_NS = 100_000_000  # when nothing was written for so long, it is asked whether it is still there
_BATTERY_NS = 1_000_000_000
_EMPTY_V, _FULL_V = 3.3, 4.2  # assumed: its one lithium cell, taken as linear between
_TRIES, _PATIENCE_S = 20, 0.1  # a firmware that waits for the rest of a broken line does so for a second
_STOP_TRIES, _STOP_PATIENCE_S = 3, 0.02
_MOTOR_COAST_S = 0.4  # without current
_START = b'{"status"'
_MOST_PIECES = 100  # in which an answer comes at most; who says more has another language
_LONGEST_ANSWER = 1024  # [bytes]; it gives less than a hundred, with all its sensors less than 300
_OTHER_ROBOT = 1.5  # times what is believed: it is another robot's, or in another unit

_Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]


_Number = Annotated[float, Field(allow_inf_nan=False)]


class _Item(BaseModel):
    batt_volt: _Number | None = None
    distances: Annotated[list[_Number], Field(max_length=MOST_DISTANCES)] | None = None
    orientation: Annotated[list[_Number], Field(min_length=3, max_length=3)] | None = None


class _Answer(BaseModel):
    """What the firmware says; what it did not understand has an item of the body and no status."""

    status: list[Literal[1]]
    body: list[_Item]


class GTernal:
    """One GTernal."""

    concurrent: ClassVar[bool] = True

    class Settings(BaseModel):
        """What the robot is connected to, and what was built into its firmware."""

        model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)

        port: Annotated[str, Field(min_length=1)]
        """The serial port of its motor controller; ``/dev/ttyAMA0`` on its own Raspberry Pi."""
        wheel_radius_m: _Length = 0.016
        """As compiled into its firmware (half of ``_wheelDiameter``), not as calibrated: it turns v and omega back."""
        wheel_base_m: _Length = 0.105
        """As compiled into its firmware (``_axelLength``)."""

    def __init__(self, context: DriverContext) -> None:
        settings: GTernal.Settings = context.settings
        self._port, self._now_ns = settings.port, context.now_ns
        self._radius, self._base = settings.wheel_radius_m, settings.wheel_base_m
        self._received = b""
        self._battery, self._battery_ns = math.nan, 0
        self._requested_ns: int | None = None  # the first line that it has not answered yet
        self._sent_ns = 0
        self._kind = context.sensors
        self._period_ns = 0 if self._kind is None else round(self._kind.period * 1e9)
        self._distances: tuple[float, ...] | None = None
        self._heading: float | None = None
        self._sensed_ns: int | None = None  # when it was asked for its sensors last
        self._sensors_ns: int | None = None  # when it told of them last
        self._closed = False
        self._line = SerialPort(settings.port, _BAUD)
        try:
            self._meet()
        except BaseException:
            self._line.close()
            raise

    @staticmethod
    def refusals(settings: Settings, drive: DifferentialDrive) -> list[tuple[str, str]]:
        """Return the figures of its firmware that cannot be this robot's."""
        pairs = ("wheel_radius_m", settings.wheel_radius_m, drive.wheel_radius), (
            "wheel_base_m", settings.wheel_base_m, drive.wheel_base,
        )  # fmt: skip
        return [
            (f"settings.{name}", f"{built_in:g} in the firmware, but this robot has {believed:g}: mend one of them")
            for name, built_in, believed in pairs
            if not 1.0 / _OTHER_ROBOT <= built_in / believed <= _OTHER_ROBOT
        ]

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s]."""
        self._listen()
        now_ns = self._now_ns()
        self._send(wheels, battery=not 0 <= now_ns - self._battery_ns < _BATTERY_NS, sensors=self._due(now_ns))

    def read(self) -> DriverReading:
        """Return its charge, and what it told last of its sensors; its angles and speeds it does not tell."""
        self._listen()
        now_ns = self._now_ns()
        if self._requested_ns is not None and now_ns - self._requested_ns >= _SILENT_NS:
            raise DriverError(f"{self._port}: the robot does not answer: is it on, or at its charger?")
        if not 0 <= now_ns - self._sent_ns < _ALONE_NS:
            self._send(None, battery=True, sensors=self._due(now_ns))
        answering = self._sensors_ns is not None and now_ns - self._sensors_ns < _SILENT_NS + self._period_ns
        sensors = SensorReading(heading=self._heading, distances=self._distances) if answering else None
        return DriverReading(0.0, 0.0, 0.0, 0.0, self._battery, 0, sensors)

    def close(self) -> None:
        """Motors off: told until it answers, for a line that comes while it answers another one is lost."""
        if self._closed:
            return
        with suppress(DriverError):
            any(self._obeys(STOP, _STOP_PATIENCE_S) for _ in range(_STOP_TRIES))
        self._closed = True
        self._line.close()

    def _meet(self) -> None:
        """Find out what is there before it is told anything; then let it stand."""
        if not any(self._obeys(None, _PATIENCE_S) for _ in range(_TRIES)):
            if self._received:
                raise DriverError(
                    f"{self._port}: the device that answers is not a GTernal: mend settings.port or driver"
                )
            raise DriverError(f"{self._port}: nothing answers: switch the robot on, and look at its cable")
        if not any(self._obeys(STOP, _PATIENCE_S) for _ in range(_TRIES)):
            raise DriverError(f"{self._port}: the robot answers, but does not stop: look at its firmware")
        self._line.wait(_MOTOR_COAST_S)
        if self._interfaces and not any(self._obeys(None, _PATIENCE_S, sensors=True) for _ in range(_TRIES)):
            raise DriverError(
                f"{self._port}: its firmware does not tell {' and '.join(self._interfaces)}: load the published "
                "firmware, or remove `sensors: true`"
            )
        places = 0 if self._kind is None else len(self._kind.places)
        if self._distances is not None and len(self._distances) != places:
            raise DriverError(
                f"{self._port}: it tells {len(self._distances)} distances, but vehicle.sensors.distances has {places} "
                "places: mend them"
            )

    @property
    def _interfaces(self) -> list[str]:
        """What it is asked for beside its battery."""
        kind = self._kind
        if kind is None:
            return []
        interfaces = (("distances", kind.distances), ("orientation", kind.heading))
        return [interface for interface, has in interfaces if has is not None]

    def _due(self, now_ns: int) -> bool:
        """Return whether it is time to ask for its sensors."""
        if self._kind is None:
            return False
        return self._sensed_ns is None or not 0 <= now_ns - self._sensed_ns < self._period_ns

    def _obeys(self, wheels: WheelSpeeds | None, patience_s: float, *, sensors: bool = False) -> bool:
        """Send one line and wait for its answer."""
        self._send(wheels, battery=True, sensors=sensors)
        request = (1 if wheels is None else 2) + (len(self._interfaces) if sensors else 0)
        for _ in range(_MOST_PIECES):
            if not self._line.wait(patience_s):
                return False
            if request in self._listen():
                return True
        return False

    def _send(self, wheels: WheelSpeeds | None, *, battery: bool, sensors: bool) -> None:
        if self._closed:
            raise DriverError(f"{self._port}: it is closed")
        requests: list[tuple[str, str, dict[str, float]]] = []
        if wheels is not None:
            v, omega = body_from_wheels(*wheels, self._radius, self._base)
            requests.append(("write", "motor", {"v": round(v, 5), "w": round(omega, 4)}))
        if battery:
            requests.append(("read", "batt_volt", {}))
        if sensors:
            requests += [("read", interface, {}) for interface in self._interfaces]
            self._sensed_ns = self._now_ns()
        lists = dict(zip(("request", "iface", "body"), zip(*requests, strict=True), strict=True))
        # The first byte may be lost: the firmware empties its input between its looks at it. After the last one must
        # come nothing: a blank would begin its next line, and it does not look at its stop before it has the rest.
        self._line.write(b"\n" + json.dumps(lists, separators=(",", ":")).encode())
        self._sent_ns = self._now_ns()
        if self._requested_ns is None:
            self._requested_ns = self._sent_ns

    def _listen(self) -> list[int]:
        """Take what it has answered; returns how many requests each answer was to."""
        if self._closed:
            raise DriverError(f"{self._port}: it is closed")
        lengths = []
        before, *texts = (self._received + self._line.read()).split(_START)
        rest = _START + texts[-1] if texts else before
        for text in texts:
            try:
                answer = _Answer.model_validate_json(_START + text)
            except ValidationError:
                continue  # broken, or not all of it is here
            if text is texts[-1]:
                rest = b""
            if len(answer.status) == len(answer.body) > 0:
                lengths.append(len(answer.body))
                self._take(answer)
        self._received = rest[-_LONGEST_ANSWER:]
        return lengths

    def _take(self, answer: _Answer) -> None:
        self._requested_ns = None
        for item in answer.body:
            if item.batt_volt is not None:
                charge = (item.batt_volt - _EMPTY_V) / (_FULL_V - _EMPTY_V)
                self._battery, self._battery_ns = min(1.0, max(0.0, charge)), self._now_ns()
            if item.orientation is not None or item.distances is not None:
                self._sensors_ns = self._now_ns()
            if item.orientation is not None:
                clockwise = math.radians(item.orientation[0])
                self._heading = math.pi - (clockwise + math.pi) % math.tau
            if item.distances is not None and self._kind is not None and self._kind.distances is not None:
                farthest = self._kind.distances.range
                self._distances = tuple(d if 0.0 < d <= farthest else math.nan for d in item.distances)

"""The messages of a unit of one robot, each as one flat row: what a test says that speaks for one robot.

They go through the layouts of the units: what is encoded here, a unit of one robot reads, and what it says is decoded.
"""

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from robofleet.bus import messages
from robofleet.bus.layouts import ListLayout

M = TypeVar("M", bound=NamedTuple)


class WheelCommand(NamedTuple):
    """A unit's command."""

    epoch: int
    seq: int
    session: int
    boot_id: int
    nonce: int
    exposure_ns: int
    left_rad_s: float
    right_rad_s: float


class RobotStatus(NamedTuple):
    """A unit's status."""

    epoch: int
    seq: int
    build: int
    session: int
    boot_id: int
    nonce: int
    stamp_ns: int
    applied_exposure_ns: int
    applied_ns: int
    rejected: int
    gate: int
    latch: int
    latch_id: int
    hurry: int
    faults: int
    target_after_ns: int
    output_after_ns: int
    left_angle_rad: float
    right_angle_rad: float
    left_rad_s: float
    right_rad_s: float
    left_output_rad_s: float
    right_output_rad_s: float
    left_told_rad: float
    right_told_rad: float
    battery: float


class Enable(NamedTuple):
    """A unit's permission."""

    epoch: int
    seq: int
    boot_id: int
    nonce: int
    phase: int
    latch: int
    clear: int
    limit_rad_s: float


class Truth(NamedTuple):
    """A unit's truth."""

    seq: int
    stamp_ns: int
    x_m: float
    y_m: float
    psi_rad: float
    v_m_s: float
    omega_rad_s: float


class Alone(Generic[M]):
    """A unit's layout, its message flattened for the one robot that it is about."""

    def __init__(self, make: type[M], layout: ListLayout[Any], unit: type[Any], item: type[Any]) -> None:
        self._make, self.layout, self._unit, self._item = make, layout, unit, item
        self._heads = unit._fields[:-1]

    @property
    def size(self) -> int:
        """Bytes of the message of a unit of one robot."""
        return self.layout.dtype(1).itemsize

    def part(self, message: M, row: int = 0) -> Any:
        """Return the robot's part of the unit's message; ``place``: in its unit."""
        own = {**dict.fromkeys(self._item._fields, row), **message._asdict()}
        return self._item(*(own[name] for name in self._item._fields))

    def whole(self, message: M, parts: Sequence[Any]) -> bytes:
        """Return the payload of a message of a unit of several robots, by the head of one robot's."""
        return self.layout.encode(self._unit(*(getattr(message, name) for name in self._heads), tuple(parts)))

    def encode(self, message: M) -> bytes:
        """Return the payload of the unit's message."""
        return self.whole(message, (self.part(message),))

    def of(self, payload: bytes, row: int) -> M | None:
        """Return what a unit's message says of one of its robots; None where it says nothing, or nobody can read it."""
        message: Any = self.layout.decode(payload)
        for k, part in enumerate(message.robots if message is not None else ()):
            if getattr(part, "place", k) == row:
                values = {**message._asdict(), **part._asdict()}
                return self._make(*(values[name] for name in self._make._fields))
        return None

    def decode(self, payload: bytes) -> M | None:
        """Return the message of a unit of one robot; None where there are more, or nobody can read it."""
        return self.of(payload, 0) if self.of(payload, 1) is None else None


WHEEL_COMMAND = Alone(WheelCommand, messages.UNIT_COMMAND, messages.UnitCommand, messages.WheelCommand)
ROBOT_STATUS = Alone(RobotStatus, messages.UNIT_STATUS, messages.UnitStatus, messages.RobotStatus)
ENABLE = Alone(Enable, messages.UNIT_ENABLE, messages.UnitEnable, messages.Enable)
TRUTH = Alone(Truth, messages.UNIT_TRUTH, messages.UnitTruth, messages.Truth)
LEASE_ANSWER = Alone(messages.LeaseAnswer, messages.UNIT_LEASES, messages.UnitLeases, messages.LeaseAnswer)

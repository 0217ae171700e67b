"""What crosses processes: fixed little-endian layouts, version byte first. Units are in the field names.

``decode`` checks length, version and finiteness and returns None for a message that fails; the caller counts it and
does nothing else with it.
"""

import math
from struct import Struct
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

VERSION = 1
_NUMPY = {"B": "u1", "H": "<u2", "I": "<u4", "i": "<i4", "Q": "<u8", "q": "<i8", "d": "<f8"}

M = TypeVar("M", bound=NamedTuple)


def _columns(make: type[Any], fields: str) -> list[tuple[str, str]]:
    """Pair a named tuple's fields with the types of a layout's letters."""
    return [(name, _NUMPY[letter]) for name, letter in zip(make._fields, fields, strict=False)]


class Layout(Generic[M]):
    """A fixed layout: version byte, then the fields of a named tuple; ``doubles`` of its last fields are floats."""

    def __init__(self, make: type[M], fields: str, doubles: int) -> None:
        self._make = make
        self._struct = Struct(f"<B{fields}{doubles}d")
        self._doubles = doubles
        self.size = self._struct.size
        self.dtype = np.dtype([("version", "u1"), *_columns(make, fields + "d" * doubles)])

    def encode(self, message: M) -> bytes:
        """Return the payload."""
        return self._struct.pack(VERSION, *message)

    def decode(self, payload: bytes) -> M | None:
        """Return the message, or None where length, version or finiteness is wrong."""
        if len(payload) != self.size or payload[0] != VERSION:
            return None
        values = self._struct.unpack(payload)
        if self._doubles and not math.isfinite(sum(values[-self._doubles :])):
            return None
        return self._make._make(values[1:])


class WheelCommand(NamedTuple):
    """Controller to driver."""

    epoch: int
    seq: int
    boot_id: int  # of the driver, echoed
    nonce: int  # of the driver, newest seen, echoed
    exposure_ns: int  # mid-exposure of the newest image behind this command [tracker's host's clock]; 0: none
    left_rad_s: float
    right_rad_s: float


class RobotStatus(NamedTuple):
    """Driver to all."""

    epoch: int
    seq: int
    boot_id: int  # drawn when the driver started
    nonce: int  # opaque to everybody else
    stamp_ns: int  # [driver's clock]
    applied_exposure_ns: int  # of the newest command that reached the wheels
    applied_ns: int  # when it did [driver's clock]
    rejected: int  # messages refused so far
    gate: int  # safety.gate.GateStatus
    faults: int  # the robot's own bits
    left_angle_rad: float
    right_angle_rad: float
    left_rad_s: float
    right_rad_s: float
    battery: float  # charge [0..1]; -1 where unknown


class Enable(NamedTuple):
    """Supervisor to driver: permission to move."""

    epoch: int
    seq: int
    boot_id: int  # of the driver, echoed
    nonce: int  # of the driver, newest seen, echoed
    phase: int  # safety.supervisor.Phase; wheels move in RUNNING alone


class RunState(NamedTuple):
    """Supervisor to all."""

    epoch: int
    seq: int
    phase: int  # safety.supervisor.Phase
    cause: int  # safety.supervisor.Event that led there
    robot: int  # index of the robot concerned in the group's order; safety.supervisor.NOBODY where it is not about one


class Truth(NamedTuple):
    """A simulated robot's true state, for the simulated camera and for the summary."""

    epoch: int
    seq: int
    stamp_ns: int  # [driver's clock]
    x_m: float  # [world]
    y_m: float
    psi_rad: float
    v_m_s: float  # [body]
    omega_rad_s: float


class TagPose(NamedTuple):
    """One robot in an image: planar pose of its centre in the world frame.

    A robot that was not seen is predicted from its motion for a while: ``coasted_ns`` is then the age of what was
    measured, and the pose is no measurement.
    """

    tag: int
    after_ns: int  # this robot's own mid-exposure, minus the image's (rolling shutter)
    coasted_ns: int  # 0: measured in this image
    x_m: float
    y_m: float
    psi_rad: float


class FleetPoses(NamedTuple):
    """Tracker to controller: everything seen in one image."""

    epoch: int
    seq: int
    exposure_ns: int  # mid-exposure [tracker's clock]
    sent_ns: int  # [tracker's clock]
    echo_tick: int  # newest tick of the controller's that the tracker knows; 0: none yet
    since_tick_ns: int  # mid-exposure minus that tick's instant, as the tracker sees it
    work_ns: int  # what the tracker did for this image took so long
    refused: int  # squares refused so far: a tag twice in an image, no square on the floor's plane
    poses: tuple[TagPose, ...]


class TrackerNews(NamedTuple):
    """Tracker to all: something happened to the camera or to a tag."""

    epoch: int
    seq: int
    stamp_ns: int  # [tracker's clock]
    event: int  # tracking.events.TrackerEvent
    tag: int  # tracking.events.NO_TAG where it is not about one
    value: float  # the event's own figure, as its description says


class TickRecord(NamedTuple):
    """Controller to all: what one tick consumed, decided and measured."""

    epoch: int
    tick: int  # of the grid, from 1
    run_tick: int  # since the run started; -1 before
    stamp_ns: int  # the tick's instant on the grid [controller's clock]
    poses_seq: int  # newest FleetPoses consumed
    exposure_ns: int  # its mid-exposure [tracker's clock]
    phase: int
    overruns: int  # so far
    lateness_ns: int  # of this tick
    compute_ns: int  # of the tick before
    robots: tuple["RobotTick", ...]


class RobotTick(NamedTuple):
    """One robot's part of a tick."""

    x_m: float  # filter's estimate of the centre at the tick [world]
    y_m: float
    psi_rad: float
    point_x_m: float  # point p when the command acts
    point_y_m: float
    reference_x_m: float  # rho at the horizon
    reference_y_m: float
    reference_parameter: float  # of the path
    u_x_m_s: float  # input after the update, as the wheels can do it
    u_y_m_s: float
    control_error_m: float
    left_rad_s: float
    right_rad_s: float
    saturated: float  # 1: the wheels could not do all of it
    measured: float  # 1: an image was used for this robot in this tick
    lost: float  # 1: no image for too long; it stands still


WHEEL_COMMAND = Layout(WheelCommand, "IIQQq", 2)
ROBOT_STATUS = Layout(RobotStatus, "IIQQqqqIBI", 5)
ENABLE = Layout(Enable, "IIQQB", 0)
RUN_STATE = Layout(RunState, "IIBHH", 0)
TRUTH = Layout(Truth, "IIq", 5)
TRACKER_NEWS = Layout(TrackerNews, "IIqBH", 1)


class ListLayout(Generic[M]):
    """A layout with a list at its end: version byte, the head's fields, the items' count, then equal items."""

    def __init__(self, make: type[M], head: str, make_item: type[NamedTuple], item: str) -> None:
        self._make, self._make_item = make, make_item
        self._head, self._item = Struct(f"<B{head}H"), Struct(f"<{item}")
        self.head_dtype = np.dtype([("version", "u1"), *_columns(make, head), ("count", "<u2")])
        self.item_dtype = np.dtype(_columns(make_item, item))

    def dtype(self, count: int) -> np.dtype[Any]:
        """Return the layout of a message of ``count`` items, for reading many at once."""
        return np.dtype(
            [
                *((n, self.head_dtype[n]) for n in self.head_dtype.names or ()),
                ("items", self.item_dtype, (count,)),
            ]
        )

    def decode_head(self, payload: bytes) -> tuple[Any, ...] | None:
        """Return the head's fields alone, or None where length or version is wrong."""
        if len(payload) < self._head.size or payload[0] != VERSION:
            return None
        _, *head, count = self._head.unpack_from(payload)
        return tuple(head) if len(payload) == self._head.size + count * self._item.size else None

    def encode(self, message: M) -> bytes:
        """Return the payload."""
        *head, items = message
        return self.encode_parts(tuple(head), len(items), b"".join(self._item.pack(*item) for item in items))

    def encode_parts(self, head: tuple[Any, ...], count: int, items: bytes) -> bytes:
        """Return the payload from items that are packed already."""
        return self._head.pack(VERSION, *head, count) + items

    def decode(self, payload: bytes) -> M | None:
        """Return the message, or None where length, version or finiteness is wrong."""
        if len(payload) < self._head.size or payload[0] != VERSION:
            return None
        _, *head, count = self._head.unpack_from(payload)
        if len(payload) != self._head.size + count * self._item.size:
            return None
        rows = list(self._item.iter_unpack(payload[self._head.size :]))
        if not math.isfinite(sum(map(sum, rows))):
            return None
        return self._make._make([*head, tuple(map(self._make_item._make, rows))])


FLEET_POSES = ListLayout(FleetPoses, "IIqqIqqI", TagPose, "Hiiddd")
TICK_RECORD = ListLayout(TickRecord, "IIiqIqBIqq", RobotTick, "d" * 16)

"""What the supervisor sees of the fleet: the newest of every message, in the words of the pure rooms."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from robofleet.safety.supervisor import Happening

NEVER = 0
AT_REST_RAD_S = 0.05


class RobotView(NamedTuple):
    """One robot. Instants on the supervisor's clock [ns], NEVER before the first; wheels [rad, rad/s]."""

    heard_ns: int = NEVER  # newest status
    build: int = 0
    session: int = 0  # of the controller that holds its lease
    boot_id: int = 0
    latch: int = 0  # safety.latches.Latch
    latch_id: int = 0
    faults: int = 0  # vehicles.interface.RobotFault
    battery: float = -1.0  # charge [0..1]; -1 where unknown
    left_angle: float = 0.0
    right_angle: float = 0.0
    left_speed: float = 0.0  # as measured
    right_speed: float = 0.0
    left_output: float = 0.0  # what the gate lets through
    right_output: float = 0.0
    left_told: float = 0.0  # and that added up over time
    right_told: float = 0.0
    seen_ns: int = NEVER  # newest image in which its tag was measured
    unseen_ns: int = 0  # from that image to the newest one, by the images' own stamps; 0: not three images yet
    image: int = 0  # number of that image
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in that image: x, y [m], psi [rad]; world
    lost: bool = False  # the controller has had no image of it for too long, and lets it stand
    filtered: int = 0  # the barrier at that tick: 0 left alone, 1 changed, 2 no answer
    blocked: bool = False  # held by the barrier for long
    failed: int = 0  # Event by which its group's behaviour failed at that tick; 0: it did not
    driven: bool = True  # by this run; else a bystander
    camera_out: int = 0  # 1 + the number of a camera that is out, without which nobody would see it; 0: none

    @property
    def at_rest(self) -> bool:
        """Whether no wheel turns, as asked and as measured."""
        return rests(self)


def rests(robot: RobotView) -> bool:
    """Whether no wheel of a robot, or of a row, turns."""
    measured = max(abs(robot.left_speed), abs(robot.right_speed))
    return max(measured, abs(robot.left_output), abs(robot.right_output)) < AT_REST_RAD_S


# The fields are those of RobotView; a pose has three.
ROBOT = np.dtype(
    (np.record, [
        *((name, "<i8") for name in ("heard_ns", "build")),
        *((name, "<u8") for name in ("session", "boot_id")),
        ("latch", "<i8"), ("latch_id", "<u8"), ("faults", "<i8"),
        *((name, "<f8") for name in (
            "battery", "left_angle", "right_angle", "left_speed", "right_speed", "left_output", "right_output",
            "left_told", "right_told",
        )),
        ("seen_ns", "<i8"), ("unseen_ns", "<i8"), ("image", "<u8"),
        *((name, "<f8") for name in ("x", "y", "psi")),
        *((name, "<i8") for name in ("lost", "filtered", "blocked", "failed", "driven", "camera_out")),
    ])
)  # fmt: skip
_PLACES = {name: index for index, name in enumerate(ROBOT.names or ())}
_POSE, _LOST = _PLACES["x"], _PLACES["lost"]


class Rows(Sequence[RobotView]):
    """The robots (N,) of a view: ``array`` has all of them, an index gives one."""

    __slots__ = ("array",)

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array

    def __len__(self) -> int:
        return len(self.array)

    @overload
    def __getitem__(self, row: int) -> RobotView: ...

    @overload
    def __getitem__(self, row: slice) -> "Rows": ...

    def __getitem__(self, row: int | slice) -> "RobotView | Rows":
        if isinstance(row, slice):
            return Rows(self.array[row])
        return _robot(self.array[row].item())

    def __iter__(self) -> Iterator[RobotView]:
        return map(_robot, self.array.tolist())

    def copied(self) -> "Rows":
        """Return the robots as they are now; through bytes, since numpy copies records field by field."""
        return Rows(np.ndarray(len(self.array), ROBOT, bytearray(self.array.tobytes())))

    @classmethod
    def of(cls, robots: Sequence[RobotView]) -> "Rows":
        """Return robots as rows; rows are returned as they are."""
        return robots if isinstance(robots, cls) else cls(np.array([_values(robot) for robot in robots], ROBOT))


def _robot(v: tuple[Any, ...]) -> RobotView:
    lost, filtered, blocked, failed, driven, camera_out = v[_LOST:]
    flags = bool(lost), filtered, bool(blocked), failed, bool(driven), camera_out
    return RobotView._make([*v[:_POSE], v[_POSE:_LOST], *flags])


def _values(robot: RobotView) -> tuple[Any, ...]:
    index = RobotView._fields.index("pose")
    return (*robot[:index], *robot.pose, *robot[index + 1 :])


class Turns(NamedTuple):
    """How a process comes to run, as its operating system counts it; so far."""

    waited_ns: int  # it was ready to run, and no core was free
    taken: int  # how often it ran


class Machine(NamedTuple):
    """How busy the supervisor's computer is, as its operating system measures it."""

    contended_ns: int  # so far, since some instant: time in which a process was ready to run and no core was free
    load: float  # processes that ran or were ready to, mean of a minute
    cores: int  # that this run may use
    turns: tuple[Turns | None, ...] = ()  # of the processes, as safety.busy numbers them; None: nobody counts them


class FleetView(NamedTuple):
    """Everything that is known now."""

    now_ns: int
    robots: Sequence[RobotView]  # the group's, in its order; then the bystanders
    controller_ns: int = NEVER  # newest tick's arrival
    controller_epoch: int = 0
    controller_build: int = 0
    tick: int = 0  # its number
    overruns: int = 0  # so far
    arrived: int = 0  # Phase whose behaviours had done all at that tick; IDLE: none
    tracker_ns: int = NEVER  # newest image's arrival
    tracker_epoch: int = 0
    tracker_build: int = 0
    image: int = 0  # its number
    image_tick: int = 0  # the newest tick that the tracker knew at its exposure
    cameras_out: tuple[Happening, ...] = ()  # of several: why some give no poses, detail their numbers; not all
    news: tuple[Happening, ...] = ()  # of the tracker, since the last view
    operator_ns: int = NEVER  # newest sign of the operator's life
    free_bytes: int = 1 << 40  # where the run is recorded
    machine: Machine | None = None  # None: not measured, or no real time

    @property
    def driven(self) -> int:
        """The number of robots that this run drives: the first ones."""
        return sum(robot.driven for robot in self.robots)

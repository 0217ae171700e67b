"""The robots of a fleet's view in one array: what hundreds of them cost no more than a few."""

from collections.abc import Iterator, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from robofleet.safety.view import RobotView

# The fields are those of view.RobotView; poses have three.
ROBOT = np.dtype(
    [
        *((name, "<i8") for name in ("heard_ns", "build")),
        *((name, "<u8") for name in ("session", "boot_id")),
        ("latch", "<i8"), ("latch_id", "<u8"), ("faults", "<i8"),
        *((name, "<f8") for name in (
            "battery", "left_angle", "right_angle", "left_speed", "right_speed", "left_output", "right_output",
            "left_told", "right_told",
        )),
        ("seen_ns", "<i8"), ("unseen_ns", "<i8"), ("image", "<u8"),
        *((name, "<f8") for name in ("x", "y", "psi", "estimate_x", "estimate_y", "estimate_psi")),
        *((name, "<i8") for name in ("lost", "filtered", "blocked", "failed", "driven", "camera_out")),
    ]
)  # fmt: skip
_PLACES = {name: index for index, name in enumerate(ROBOT.names or ())}
_POSE, _LOST = _PLACES["x"], _PLACES["lost"]


class Rows(Sequence[RobotView]):
    """The robots (N,) of a view: ``array`` has all of them, an index gives one."""

    __slots__ = ("array",)

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array

    def __len__(self) -> int:
        """Return how many robots these are."""
        return len(self.array)

    @overload
    def __getitem__(self, row: int) -> RobotView: ...

    @overload
    def __getitem__(self, row: slice) -> "Rows": ...

    def __getitem__(self, row: int | slice) -> "RobotView | Rows":
        """Return one robot, or some."""
        if isinstance(row, slice):
            return Rows(self.array[row])
        return _robot(self.array[row].item())

    def __iter__(self) -> Iterator[RobotView]:
        """Yield them in their order."""
        return map(_robot, self.array.tolist())

    @classmethod
    def of(cls, robots: Sequence[RobotView]) -> "Rows":
        """Return robots as rows; rows are returned as they are."""
        return robots if isinstance(robots, cls) else cls(np.array([_values(robot) for robot in robots], ROBOT))


def _robot(v: tuple[Any, ...]) -> RobotView:
    lost, filtered, blocked, failed, driven, camera_out = v[_LOST:]
    poses = v[_POSE : _POSE + 3], v[_POSE + 3 : _LOST]
    flags = bool(lost), filtered, bool(blocked), failed, bool(driven), camera_out
    return RobotView._make([*v[:_POSE], *poses, *flags])


def _values(robot: RobotView) -> tuple[Any, ...]:
    index = RobotView._fields.index("pose")
    return (*robot[:index], *robot.pose, *robot.estimate, *robot[index + 2 :])

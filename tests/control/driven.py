"""The platoon's law, and behind it what the wheels can do of its inputs: as the controller has them."""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robofleet.control import wheels
from robofleet.control.platoon import Column as Decided
from robofleet.control.platoon import PlatoonLaw

Array = NDArray[np.float64]


class Column(IntEnum):
    """Columns of what a tick commands, one row a robot: the law's, with u as the wheels can do it, and the wheels'."""

    U_X = Decided.U_X
    U_Y = Decided.U_Y
    REFERENCE_X = Decided.REFERENCE_X
    REFERENCE_Y = Decided.REFERENCE_Y
    REFERENCE_PARAMETER = Decided.REFERENCE_PARAMETER
    CONTROL_ERROR = Decided.CONTROL_ERROR
    POINT_X = 6
    POINT_Y = 7
    LEFT = 8  # [rad/s]
    RIGHT = 9
    SATURATED = 10  # 1 where the wheels could not do all of it


WHEELS = slice(Column.LEFT, Column.RIGHT + 1)


class Platoon(PlatoonLaw):
    """A platoon whose decisions are commands."""

    def tick(
        self, t: float, poses: Array, driving: NDArray[np.bool_], disturbance: Array | None = None
    ) -> Array:  # (N, 11), columns as in Column
        """Return what all robots do in the next tick."""
        decided = super().tick(t, poses, driving, disturbance)
        request = wheels.limited(
            decided[:, :2].copy(), np.zeros(len(poses), dtype=np.bool_), poses, self.settings.point_ahead,
            wheels.limits(self.vehicles), driving,
        )  # fmt: skip
        return np.column_stack([request.u, decided[:, 2:6], request.points, request.wheels, request.saturated])

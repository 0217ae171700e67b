"""From an image's poses, one a tag in any order, to those of the robots, in their order."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import kernel

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

_TAGS = 1 << 16  # that a message can tell apart
_NOBODY = -1


def rows_of(tags: dict[int, int]) -> Instants:
    """Return the row of each tag, for ``placed``; ``tags``: the robots' rows by their tags."""
    rows = np.full(_TAGS, _NOBODY)
    rows[list(tags)] = list(tags.values())
    return rows


@kernel
def placed(
    said: NDArray[Any], rows: Instants, exposure_ns: int, latest_ns: int, poses: Array, instants_ns: Instants
) -> None:
    """Write what an image measured, ``said``: TagPose (K,), into poses (M, 3), NaN where nothing was, and the robots'
    own mid-exposures (M,). What is predicted, or later than ``latest_ns``, is no measurement.
    """
    for row in range(len(poses)):
        poses[row, 0], poses[row, 1], poses[row, 2] = np.nan, np.nan, np.nan
        instants_ns[row] = exposure_ns
    for one in said:
        row, instant_ns = rows[one["tag"]], exposure_ns + one["after_ns"]
        if row != _NOBODY and one["coasted_ns"] == 0 and instant_ns <= latest_ns:
            poses[row, 0], poses[row, 1], poses[row, 2] = one["x_m"], one["y_m"], one["psi_rad"]
            instants_ns[row] = instant_ns


KERNELS = (placed,)  # that are called from Python

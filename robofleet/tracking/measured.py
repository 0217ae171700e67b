"""From an image's poses, one a tag in any order, to those of the robots, in their order."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

_TAGS = 1 << 16  # that a message can tell apart
_NOBODY = -1
COLUMNS = 9  # of a measurement: x, y [m], psi [rad] and their covariance


def rows_of(tags: dict[int, int]) -> Instants:
    """Return the row of each tag, for ``placed``; ``tags``: the robots' rows by their tags."""
    rows = np.full(_TAGS, _NOBODY)
    rows[list(tags)] = list(tags.values())
    return rows


@kernel
def placed(
    tag_poses: NDArray[Any], rows: Instants, exposure_ns: int, latest_ns: int, poses: Array, instants_ns: Instants
) -> None:
    """Write what an image measured, ``tag_poses`` (K,), into poses (M, 9), NaN where nothing was, and the robots'
    own mid-exposures (M,). What is predicted, or later than ``latest_ns``, is no measurement.

    Columns: x, y [m], psi [rad], and their covariance in the message's order; zeros where nobody knows it.
    """
    for row in range(len(poses)):
        for k in range(COLUMNS):
            poses[row, k] = np.nan
        instants_ns[row] = exposure_ns
    for tag_pose in tag_poses:
        row, instant_ns = rows[tag_pose["tag"]], exposure_ns + tag_pose["after_ns"]
        if row != _NOBODY and tag_pose["coasted_ns"] == 0 and instant_ns <= latest_ns:
            poses[row, 0], poses[row, 1], poses[row, 2] = tag_pose["x_m"], tag_pose["y_m"], tag_pose["psi_rad"]
            poses[row, 3], poses[row, 4], poses[row, 5] = tag_pose["xx_m2"], tag_pose["xy_m2"], tag_pose["yy_m2"]
            poses[row, 6], poses[row, 7], poses[row, 8] = (
                tag_pose["xpsi_m_rad"],
                tag_pose["ypsi_m_rad"],
                tag_pose["psipsi_rad2"],
            )
            instants_ns[row] = instant_ns


KERNELS = (placed,)  # that are called from Python

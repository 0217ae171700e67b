"""The quadratic program of a robot: the point nearest to what it is asked for that keeps all rows.

A row (a, b, c) is a x + b y <= c, with a normal (a, b) of size 1. Two unknowns make it small enough to solve exactly.
"""

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

TOLERANCE = 1e-9  # of a row [m/s]
_CHECKED = 1e-6  # of the answer [m/s]


@kernel
def nearest(x: float, y: float, rows: Array) -> tuple[float, float]:
    """Return the point nearest to (x, y) that keeps all rows, and has been checked to; NaN if there is none."""
    if _excess(x, y, rows) <= TOLERANCE:
        return x, y
    for _ in range(2):
        along, across = _project(x, y, rows)
        if _excess(along, across, rows) <= _CHECKED:
            return along, across
        for k in range(len(rows)):  # it cannot withdraw from all: not nearer to any
            rows[k, 2] = max(rows[k, 2], 0.0)
    return np.nan, np.nan


@kernel
def _excess(x: float, y: float, rows: Array) -> float:
    """Return by how much the worst row is broken; NaN where anything is not finite."""
    worst, finite = 0.0, 0.0
    for k in range(len(rows)):
        over = rows[k, 0] * x + rows[k, 1] * y - rows[k, 2]
        worst, finite = max(worst, over), finite + 0.0 * over
    return worst + finite


@kernel
def _project(x0: float, y0: float, rows: Array) -> tuple[float, float]:
    """Return the point nearest to (x0, y0) that keeps all rows, NaN if there is none.

    Row by row: if the newest one is broken, the answer lies on its line, between what the rows before it cut off.
    """
    x, y = x0, y0
    for k in range(len(rows)):
        a, b, limit = rows[k, 0], rows[k, 1], rows[k, 2]
        if a * x + b * y <= limit + TOLERANCE:
            continue
        over = a * x0 + b * y0 - limit
        x, y = x0 - over * a, y0 - over * b
        low, high = -np.inf, np.inf
        for j in range(k):
            left, along = rows[j, 2] - rows[j, 0] * x - rows[j, 1] * y, rows[j, 1] * a - rows[j, 0] * b
            if abs(along) < TOLERANCE:
                if left < -_CHECKED:
                    return np.nan, np.nan
            elif along > 0.0:
                high = min(high, left / along)
            else:
                low = max(low, left / along)
        if low > high + _CHECKED:
            return np.nan, np.nan
        shift = min(max(0.0, low), high)
        x, y = x - shift * b, y + shift * a
    return x, y

"""Pairs of near points, found with a square grid instead of comparing all pairs.

A point's neighbours lie in its own cell and the eight around it, as a cell is at least as wide as the distance asked
for. Where that is not finite, or a point is not, everybody is everybody's neighbour.
"""

from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.kernels import kernel

_MARGIN = 1.0 + 1e-9  # of the distance: beyond any rounding
_NOBODY = -1


class Grid(NamedTuple):
    """Points in cells: ``first`` of each cell's (rows * columns,), and the one that follows each point (N,)."""

    x: float  # of the corner of the first cell
    y: float
    cell: float  # its side
    columns: int
    rows: int
    reach: float
    first: Indices
    following: Indices


@kernel
def sorted_into_cells(points: Array, present: Flags, reach: float) -> Grid:
    """Return the grid of those points (N, >= 2) that are ``present`` (N,); columns beyond x and y are not looked at."""
    low_x, high_x, low_y, high_y, total, count = np.inf, -np.inf, np.inf, -np.inf, 0.0, 0
    for i in range(len(points)):
        if present[i]:
            x, y = points[i, 0], points[i, 1]
            low_x, high_x, low_y, high_y = min(low_x, x), max(high_x, x), min(low_y, y), max(high_y, y)
            total += 0.0 * (x + y)
            count += 1
    cell, columns, rows = reach * _MARGIN, 1, 1
    if count > 0 and total + 0.0 * cell == 0.0:
        wide, high, most = high_x - low_x, high_y - low_y, np.sqrt(count) + 1.0  # cells along a side
        cell = max(cell, max(wide, high) / most)
        if cell > 0.0:
            columns, rows = int(wide / cell) + 1, int(high / cell) + 1
    else:
        reach = np.inf
    first, following = np.full(columns * rows, _NOBODY), np.full(len(points), _NOBODY)
    for i in range(len(points) - 1, -1, -1):
        if present[i]:
            k = _column(points[i, 0] - low_x, cell, columns) + columns * _column(points[i, 1] - low_y, cell, rows)
            following[i], first[k] = first[k], i
    return Grid(low_x, low_y, cell, columns, rows, reach, first, following)


@kernel
def around(grid: Grid, points: Array, i: int, found: Indices) -> int:
    """Write who is within the grid's reach of point i, but for itself, into ``found`` (N,), ascending; return how
    many."""
    x, y, furthest, count = points[i, 0], points[i, 1], grid.reach * _MARGIN, 0
    column, row = _column(x - grid.x, grid.cell, grid.columns), _column(y - grid.y, grid.cell, grid.rows)
    for r in range(max(row - 1, 0), min(row + 2, grid.rows)):
        for c in range(max(column - 1, 0), min(column + 2, grid.columns)):
            j = grid.first[r * grid.columns + c]
            while j != _NOBODY:
                across, along = points[j, 0] - x, points[j, 1] - y
                if j != i and not across * across + along * along > furthest * furthest:
                    k = count
                    while k > 0 and found[k - 1] > j:
                        found[k] = found[k - 1]
                        k -= 1
                    found[k] = j
                    count += 1
                j = grid.following[j]
    return count


@kernel
def _column(offset: float, cell: float, columns: int) -> int:
    """Return the column, or the row, of a point; one outside the grid is counted to its edge."""
    if columns == 1:
        return 0
    return int(min(max(offset / cell, 0.0), columns - 1.0))

"""The barrier's rows of solids: obstacles, and what lies outside a floor that is a polygon.

Every edge and corner whose nearest point is a local minimum of the distance has its row, so an outline need not be
convex: the solid's nearest point is among them, and what lies behind a corner does not slow a robot in front of it.
"""

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel
from robofleet.vehicles import solids

_LEAST = 1e-9  # of a row [m/s]

_share, _is_solid_side = solids.share, solids.is_solid_side
_FIRST, _LAST, _X, _Y, _REACH, _RADIUS = solids.FIRST, solids.LAST, solids.X, solids.Y, solids.REACH, solids.RADIUS


@kernel
def add_row(rows: Array, count: int, along: float, across: float, limit: float) -> int:
    """Write along v + across (l omega) <= limit, scaled to a normal of size 1."""
    size = np.hypot(along, across)
    if size < _LEAST:
        return count  # nothing that the robot does changes it
    rows[count, 0], rows[count, 1], rows[count, 2] = along / size, across / size, limit / size
    return count + 1


@kernel
def solid_rows(
    rows: Array, count: int, stop: Array, edges: Array, rings: Array, margin: float, rate: float, fastest: float,
    back: float,
) -> int:  # fmt: skip
    """Write the rows of solids, from which ``margin`` [m] is kept."""
    x, y, beyond = stop[0], stop[1], fastest / rate  # nothing that the robot can do breaks a row further away
    for ring in rings:
        begin, end = int(ring[_FIRST]), int(ring[_LAST])
        kept = margin + ring[_RADIUS]
        near = kept + beyond
        reach = ring[_REACH] + near
        if (x - ring[_X]) ** 2 + (y - ring[_Y]) ** 2 > reach * reach:
            continue
        least, nearest, at = np.inf, begin, 0.0
        before = _share(edges, end - 1, x, y)
        for k in range(begin, end):
            t = _share(edges, k, x, y)
            part = min(max(t, 0.0), 1.0)
            off_x = edges[k, 0] + part * (edges[k, 2] - edges[k, 0]) - x
            off_y = edges[k, 1] + part * (edges[k, 3] - edges[k, 1]) - y
            squared = off_x * off_x + off_y * off_y
            if squared < least:
                least, nearest, at = squared, k, t
            local = 0.0 < t < 1.0 or (t <= 0.0 and (before >= 1.0 or end - begin == 1))
            before = t
            if local and squared < near * near and not _is_solid_side(edges, ring, k, t, x, y):
                count = _away(rows, count, stop, off_x, off_y, np.sqrt(squared) - kept, rate, back)
        if least < np.inf and _is_solid_side(edges, ring, nearest, at, x, y):  # it is inside: out by the nearest way
            part = min(max(at, 0.0), 1.0)
            off_x = edges[nearest, 0] + part * (edges[nearest, 2] - edges[nearest, 0]) - x
            off_y = edges[nearest, 1] + part * (edges[nearest, 3] - edges[nearest, 1]) - y
            count = _away(rows, count, stop, -off_x, -off_y, -np.sqrt(least) - kept, rate, back)
    return count


@kernel
def _away(
    rows: Array, count: int, stop: Array, off_x: float, off_y: float, h: float, rate: float, back: float
) -> int:  # fmt: skip
    """Write that h [m] may be used up at a rate by going in a direction (off_x, off_y)."""
    distance = np.hypot(off_x, off_y)
    if distance == 0.0:
        return count  # no direction is away from it
    towards_x, towards_y = off_x / distance, off_y / distance
    along, across = towards_x * stop[2] + towards_y * stop[3], towards_x * stop[4] + towards_y * stop[5]
    return add_row(rows, count, along, across, max(rate * h, back))

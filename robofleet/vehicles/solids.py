"""What stands on the floor and what the floor ends at: solids, as discs and as polygons, and how far away they are.

A polygon may have any simple outline. Its corners are kept in the order in which its solid side lies to the left: an
obstacle's counter-clockwise, the floor's clockwise, as everything outside the floor is solid.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

Point = tuple[float, float]

CIRCLE_SIDES = 24  # of a disc that is drawn, or seen by rays


@dataclass(frozen=True)
class Solid:
    """A disc about its only point, or a polygon; ``floor``: what lies outside is solid, not what lies inside."""

    name: str
    points: tuple[Point, ...]  # [m; world]
    radius: float = 0.0  # of a disc [m]
    floor: bool = False

    @property
    def outline(self) -> Array:
        """Its corners (M, 2), counter-clockwise [m]; of a disc those of a polygon around it."""
        at = np.array(self.points)
        if len(at) == 1:
            angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE_SIDES, endpoint=False)
            reach = self.radius / np.cos(np.pi / CIRCLE_SIDES)
            return np.asarray(at + reach * np.column_stack([np.cos(angle), np.sin(angle)]))
        return at if area(self.points) > 0.0 else at[::-1].copy()


class Outlines(NamedTuple):
    """Solids as the kernels read them: every ring of edges is a solid."""

    edges: Array  # (E, 4): from x, y, to x, y [m]; of a disc one edge without length
    rings: Array  # (R, 6), columns as below


FIRST, LAST, X, Y, REACH, RADIUS = range(6)  # of a ring: its edges, a disc around it [m], its own radius as a disc [m]


def area(points: Sequence[Point]) -> float:
    """Return a polygon's area [m^2], below 0 where its corners are clockwise."""
    x, y = np.array(points).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2.0)


def outlines(solids: Sequence[Solid]) -> Outlines:
    edges, rings, count = [np.empty((0, 4))], [], 0
    for solid in solids:
        at = np.array(solid.points)
        if len(at) > 2:
            at = solid.outline[::-1] if solid.floor else solid.outline
        edges.append(np.hstack([at, np.roll(at, -1, axis=0)]))
        middle = (at.min(axis=0) + at.max(axis=0)) / 2.0
        reach = float(np.hypot(*(at - middle).T).max()) + solid.radius
        rings.append((count, count + len(at), *middle, reach, solid.radius))
        count += len(at)
    return Outlines(np.concatenate(edges), np.array(rings, np.float64).reshape(-1, 6))


def distances(solids: Sequence[Solid], points: Array) -> Array:
    """Return how far points (M, 2) are from each solid (R, M) [m]; below 0 inside it."""
    found = np.empty((len(solids), len(points)))
    if not solids:  # numba takes a second to load
        return found
    _distances(*outlines(solids), np.ascontiguousarray(points, np.float64), found)
    return found


@kernel
def _distances(edges: Array, rings: Array, points: Array, out: Array) -> None:
    for r in range(len(rings)):
        for k in range(len(points)):
            out[r, k] = away(edges, rings[r], points[k, 0], points[k, 1])


@kernel
def share(edges: Array, k: int, x: float, y: float) -> float:
    """Return where on edge k's line is the point nearest to (x, y): 0 at the edge's beginning, 1 at its end."""
    along_x, along_y = edges[k, 2] - edges[k, 0], edges[k, 3] - edges[k, 1]
    squared = along_x * along_x + along_y * along_y
    if squared == 0.0:
        return 0.0
    return float(((x - edges[k, 0]) * along_x + (y - edges[k, 1]) * along_y) / squared)


@kernel
def left_of(edges: Array, k: int, x: float, y: float) -> float:
    """Return a number above 0 where (x, y) lies to the left of edge k: on its solid side."""
    along_x, along_y = edges[k, 2] - edges[k, 0], edges[k, 3] - edges[k, 1]
    return float(along_x * (y - edges[k, 1]) - along_y * (x - edges[k, 0]))


@kernel
def away(edges: Array, ring: Array, x: float, y: float) -> float:
    """Return how far (x, y) is from a ring's solid [m]; below 0 inside it."""
    least, inside = np.inf, False
    for k in range(int(ring[FIRST]), int(ring[LAST])):
        t = share(edges, k, x, y)
        part = min(max(t, 0.0), 1.0)
        off_x = edges[k, 0] + part * (edges[k, 2] - edges[k, 0]) - x
        off_y = edges[k, 1] + part * (edges[k, 3] - edges[k, 1]) - y
        off = np.hypot(off_x, off_y)
        if off < least:
            least, inside = off, is_solid_side(edges, ring, k, t, x, y)
    return float((-least if inside else least) - ring[RADIUS])


@kernel
def is_solid_side(edges: Array, ring: Array, k: int, t: float, x: float, y: float) -> bool:
    """Whether (x, y), whose nearest point of the ring is on edge k at share t, lies inside the solid."""
    first, last = int(ring[FIRST]), int(ring[LAST])
    if last - first == 1:
        return False
    if 0.0 < t < 1.0:
        return bool(left_of(edges, k, x, y) > 0.0)
    corner = k  # the edge that begins at the nearest point
    if t >= 1.0:
        corner = k + 1 if k + 1 < last else first
    before = corner - 1 if corner > first else last - 1
    return bool(left_of(edges, before, edges[corner, 2], edges[corner, 3]) < 0.0)  # the solid has a notch there


def rehearse() -> None:
    """Call every kernel once: numba compiles it then, or loads it from disk."""
    _distances(*outlines(()), np.zeros((1, 2)), np.empty((0, 1)))


KERNELS = (_distances,)  # that are called from Python

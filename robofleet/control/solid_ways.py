"""Clearance of ways from solids: obstacles, and what lies outside a floor that is a polygon."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array, Indices
from robofleet.core.kernels import kernel
from robofleet.vehicles import solids
from robofleet.vehicles.solids import Outlines, Solid

SLOPE = 0.5  # by which what is kept grows with the distance from a start or goal
_EPSILON = 1e-9
_WAY_STEP_M = 0.002  # between two points of a straight way that are looked at

_away = solids.away


class SolidWays(NamedTuple):
    """What is kept from solids: ``beside``, and less near those ends of ways that are nearer to them."""

    outlines: Outlines
    beside: float  # [m]
    ring: Indices  # (T,): to which solid an end is nearer
    ends: Array  # (T, 3): x, y, and what is kept there [m]


def kept(standing: Sequence[Solid], beside: float, ends: Array) -> SolidWays:
    """Return what ways between ends (M, 2) keep from solids."""
    away = solids.distances(standing, ends) - _EPSILON
    ring, end = np.nonzero(away < beside)
    tight = np.column_stack([ends[end], away[ring, end]])
    return SolidWays(solids.outlines(standing), beside, ring, tight)


@kernel
def left(at: Array, standing: SolidWays, out: Array) -> None:
    """Write how much places (M, 2) have left of what is kept from solids (M,) [m]."""
    for v in range(len(at)):
        out[v] = _left_at(at[v, 0], at[v, 1], standing)


@kernel
def _left_at(x: float, y: float, standing: SolidWays) -> float:
    outlines, least = standing.outlines, np.inf
    for r in range(len(outlines.rings)):
        away = _away(outlines.edges, outlines.rings[r], x, y)
        if away - standing.beside >= least:
            continue
        least_kept = standing.beside
        for k in range(len(standing.ring)):
            if standing.ring[k] == r:
                end = standing.ends[k]
                least_kept = min(least_kept, end[2] + SLOPE * np.hypot(x - end[0], y - end[1]))
        least = min(least, away - least_kept)
    return least


@kernel
def clear_way(from_x: float, from_y: float, to_x: float, to_y: float, standing: SolidWays) -> bool:
    """Whether a straight way keeps what is kept from solids: it is walked in steps that cannot come too near."""
    length, gone = np.hypot(to_x - from_x, to_y - from_y), 0.0
    if len(standing.outlines.rings) == 0:
        return True
    while gone < length:
        share = gone / length
        free = _left_at(from_x + share * (to_x - from_x), from_y + share * (to_y - from_y), standing)
        if free < -_WAY_STEP_M:
            return False
        gone += max(free / (1.0 + SLOPE), _WAY_STEP_M)
    return True


KERNELS = (left,)  # that are called from Python

"""The part of the floor that matters, and how exactly a placed camera sees it."""

import numpy as np

from robofleet.calibration.extrinsics.placing import Placement
from robofleet.calibration.extrinsics.survey import Survey
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

COLUMNS, ROWS = 33, 21  # of the points at which the error is predicted


def floor_points(survey: Survey, arena_m: tuple[float, float] | None, height: float) -> Array:
    """Return points (ROWS * COLUMNS, 3) all over the arena at a height, row by row [m; world].

    The arena is a rectangle around the world's origin; if it is not known, the marks' rectangle.
    """
    if arena_m is not None:
        high = np.array(arena_m) / 2
        low = -high
    else:
        places = [(mark.x_m, mark.y_m) for mark in survey.marks]
        low, high = np.min(places, axis=0), np.max(places, axis=0)
        if (low == high).any():
            raise CalibrationError("the marks' places span no rectangle of the floor: state the arena with --arena-m")
    return lattice(low, high, height)


def lattice(low: Array, high: Array, height: float) -> Array:
    """Return points (ROWS * COLUMNS, 3) from one corner (2,) of a rectangle to the other, row by row."""
    X, Y = np.meshgrid(np.linspace(low[0], high[0], COLUMNS), np.linspace(low[1], high[1], ROWS))
    return np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, height)])


def predicted(placement: Placement, points: Array) -> Array:
    """Return the standard deviation of both coordinates together [mm] at points (G, 3); NaN where none is seen."""
    pixels = placement.geometry.project(points)
    seen = (np.abs(pixels / (np.array(placement.lens.size) - 1.0) - 0.5) <= 0.5).all(axis=1)
    sigma = np.full(len(points), np.nan)
    if seen.any():
        sigma[seen] = 1e3 * np.sqrt(np.trace(placement.spread(points[seen]), axis1=1, axis2=2))
    return sigma

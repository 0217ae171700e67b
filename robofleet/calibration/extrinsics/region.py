"""The part of the floor that matters, and how exactly a placed camera sees it."""

from typing import NamedTuple

import numpy as np

from robofleet.calibration.extrinsics.placing import Placement
from robofleet.calibration.extrinsics.survey import Survey
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

COLUMNS, ROWS = 33, 21  # of the points at which the error is predicted


class Region(NamedTuple):
    """A rectangle of a plane, on which the camera is to be exact."""

    low: tuple[float, float]  # x, y [m; world]
    high: tuple[float, float]
    height: float  # of the robots' tags [m]

    @property
    def points(self) -> Array:
        """Return points (ROWS * COLUMNS, 3) all over it, row by row [m; world]."""
        x, y = np.linspace(self.low[0], self.high[0], COLUMNS), np.linspace(self.low[1], self.high[1], ROWS)
        X, Y = np.meshgrid(x, y)
        return np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, self.height)])


def region_of(survey: Survey, arena_m: tuple[float, float] | None, height: float) -> Region:
    """Return the arena, a rectangle around the world's origin; if it is not known, the marks' rectangle."""
    if arena_m is not None:
        x, y = arena_m[0] / 2, arena_m[1] / 2
        return Region((-x, -y), (x, y), height)
    places = [(mark.x_m, mark.y_m) for mark in survey.marks]
    (x_low, y_low), (x_high, y_high) = np.min(places, axis=0).tolist(), np.max(places, axis=0).tolist()
    if x_low == x_high or y_low == y_high:
        raise CalibrationError("the marks' places span no rectangle of the floor: state the arena with --arena-m")
    return Region((x_low, y_low), (x_high, y_high), height)


def predicted(placement: Placement, region: Region) -> Array:
    """Return the standard deviation of both coordinates together [mm] at the region's points (G,).

    NaN where the camera does not see them.
    """
    points = region.points
    pixels = placement.geometry.project(points)
    seen = (np.abs(pixels / (np.array(placement.lens.size) - 1.0) - 0.5) <= 0.5).all(axis=1)
    sigma = np.full(len(points), np.nan)
    if seen.any():
        sigma[seen] = 1e3 * np.sqrt(np.trace(placement.spread(points[seen]), axis1=1, axis2=2))
    return sigma

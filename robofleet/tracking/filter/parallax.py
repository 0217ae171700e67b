"""How high robots' tags lie, from two cameras that see them.

A tag that is higher than configured appears further from each camera's foot, by its excess height times the slope of
the line of sight. Two cameras see it under two slopes: how far apart they place it, along the difference of these,
tells the height. The side of the tag is not needed.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple, Self

import numpy as np

from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.arrays import Array

_CALIBRATED_M = 0.0003  # to which two calibrated cameras agree
_FORGET = 0.999  # of what was known, from image to image: half a minute
_LEAST_SLOPE = 0.1  # difference of two, below which they tell nothing
_CERTAIN = 3.0  # standard deviations that name a height
_CHANGED = 0.2  # of a height that was named, after which it is named again


class Heights(NamedTuple):
    """How much higher than configured the tags of N robots lie."""

    higher: Array  # (N,) [m]; 0 where nothing is known
    noise: Array  # (N,) its standard deviation by the noise [m]; infinite where nothing is known
    calibrated: Array  # (N,) likewise, by the cameras' calibrations


class Parallax:
    """Learns heights from pairs of places, by least squares."""

    def __init__(self, cameras: Array, heights: Array) -> None:
        """Take the cameras' positions (C, 3) [m; world], and the configured heights of the robots' tags (N,) [m]."""
        self._cameras, self._heights = cameras, heights
        self._information, self._products, self._weights, self._named = np.zeros((4, len(heights)))

    @classmethod
    def of(cls, config: Config) -> Self:
        """Return that of a configuration's cameras, and of the robots of its groups."""
        poses = [view.camera.model.T_world_camera for view in config.views]
        cameras = [(math.nan,) * 3 if pose is None else pose.position_m for pose in poses]
        return cls(np.array(cameras), np.array([slices.tag_height_m(config, robot) for robot in config.members]))

    def add(self, camera: int, other: int, places: Array, apart: Array, variances: Array) -> None:
        """Take where a camera sees robots (N, 2), how far from where the other one does that is (N, 2), and the
        variance of this along an axis (N,) [m^2]; NaN where not both see a robot."""
        slope = self._slopes(camera, places) - self._slopes(other, places - apart)
        square = (slope**2).sum(axis=1)
        seen = np.isfinite(apart[:, 0]) & (square > _LEAST_SLOPE**2)
        for sums, new in (
            (self._information, square / variances),
            (self._products, (slope * apart).sum(axis=1) / variances),
            (self._weights, 1.0 / variances),
        ):
            sums[seen] = _FORGET * sums[seen] + new[seen]

    def heights(self) -> Heights:
        known = np.maximum(self._information, 1e-12)
        calibrated = _CALIBRATED_M * np.sqrt(self._weights / known)
        return Heights(self._products / known, 1.0 / np.sqrt(known), calibrated)

    def news(self) -> Iterator[tuple[int, float]]:
        """Yield robots whose tags lie higher than configured for certain, and by how much [m]; each once."""
        higher, noise, calibrated = self.heights()
        sigma = _CERTAIN * np.hypot(noise, calibrated)
        changed = np.abs(higher - self._named) > np.maximum(sigma, _CHANGED * np.abs(self._named))
        for row in np.flatnonzero((np.abs(higher) > sigma) & changed).tolist():
            self._named[row] = higher[row]
            yield row, float(higher[row])

    def _slopes(self, camera: int, places: Array) -> Array:
        """Return how far from a camera's foot robots (N, 2) appear, in the height of the camera above their tags."""
        slopes: Array = (places - self._cameras[camera, :2]) / (self._cameras[camera, 2] - self._heights)[:, None]
        return slopes

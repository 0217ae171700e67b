"""The effect of lens errors on the floor, below a camera that looks straight down.

A tag's pixel stays, the lens changes: its place on the tags' plane moves. Most of that is taken back when the
camera's pose is fitted to floor tags through the same wrong lens: the part that a pose can absorb is absorbed here by
a least-squares pose over eight tags on the floor near the image's rim. The rest stays as error, the most telling
one being the focal length: the floor's scale is right again, that of a plane above it is not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.lens.projection import Lens
from robofleet.core.arrays import Array

COLUMNS, ROWS = 24, 14  # of the pixels whose places are asked for
_TAGS_SHARE = 0.8  # half the side of the floor tags' rectangle, of the image's
_STEEPEST = 1.0  # slope of the rays that are asked for when no arena is given: 45 degrees


@dataclass(frozen=True)
class Ceiling:
    """Where the camera will hang, the plane on which robots wear their tags, and the floor that matters."""

    height_m: float
    tag_height_m: float
    arena_m: tuple[float, float] | None = None  # long side along the image's; None: all that is seen within 45 degrees

    def limit(self, slopes: Array) -> Array:
        """Return slopes (N, 2), shortened where they lead out of the floor that matters."""
        if self.arena_m is None:
            beyond = np.linalg.norm(slopes, axis=1) / _STEEPEST
        else:
            beyond = (2 * self.height_m * np.abs(slopes) / self.arena_m).max(axis=1)
        return np.asarray(slopes / np.maximum(beyond, 1.0)[:, None])

    def sees(self, slopes: Array) -> NDArray[np.bool_]:
        """Return whether rays (N, 2) lead to the floor that matters; NaN does not."""
        return np.asarray((self.limit(slopes) == slopes).all(axis=1))


class FloorErrors:
    """First-order errors at those of G pixels, all over the image, that see the floor that matters."""

    def __init__(self, lens: Lens, ceiling: Ceiling) -> None:
        """Find how places depend on the lens's values (P); ``folds``: the lens is impossible inside the image."""
        width, height = lens.size
        u, v = np.meshgrid(np.linspace(0, width - 1, COLUMNS), np.linspace(0, height - 1, ROWS))
        slopes = lens.slopes(np.column_stack([u.ravel(), v.ravel()]))
        self.folds = lens.kind == "pinhole" and not bool(np.isfinite(slopes).all())
        self._matters = ceiling.sees(slopes)
        around = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
        middle = np.array([width - 1, height - 1]) / 2
        tags = lens.slopes(middle + _TAGS_SHARE * middle * np.array(around))
        tags = ceiling.limit(tags[np.isfinite(tags).all(axis=1)])
        self._fixed, by_pose = _shifts(lens, slopes[self._matters], ceiling.height_m - ceiling.tag_height_m)
        of_tags, tags_by_pose = _shifts(lens, tags, ceiling.height_m)
        absorbed = np.linalg.lstsq(tags_by_pose.reshape(-1, 6), of_tags.reshape(-1, len(lens.values)), rcond=None)[0]
        self._refitted = self._fixed - by_pose @ absorbed

    def sigma_mm(self, covariance: Array, *, refitted: bool = True) -> Array:
        """Return the standard deviation of each pixel's place (G,), both coordinates together [mm]; NaN: outside."""
        shifts = self._refitted if refitted else self._fixed
        variance = np.einsum("gip,pq,giq->g", shifts, covariance, shifts)
        sigma = np.full(len(self._matters), np.nan)
        sigma[self._matters] = 1e3 * np.sqrt(np.maximum(variance, 0.0))
        return sigma

    def max_mm(self, covariance: Array) -> float:
        """Return the largest of ``sigma_mm`` [mm]; infinite for a lens that sees no arena."""
        return float(np.nanmax(self.sigma_mm(covariance))) if self._matters.any() else float("inf")

    def rms_mm(self, covariance: Array, *, refitted: bool = True) -> float:
        """Return the root mean square of ``sigma_mm`` [mm]; infinite for a lens that folds or sees no arena."""
        sigma = self.sigma_mm(covariance, refitted=refitted)
        if self.folds or not self._matters.any():
            return float("inf")
        return float(np.sqrt(np.nanmean(sigma**2)))

    def shift_mm(self, change: Array) -> float:
        """Return by how much a change of the lens (P,) moves places, rms, pose refitted [mm]."""
        moved = self._refitted @ change
        return float(1e3 * np.sqrt((moved * moved).sum(axis=1).mean()))


def _shifts(lens: Lens, slopes: Array, below_m: float) -> tuple[Array, Array]:
    """Return how places on the plane (N,) move when pixels stay: (N, 2, P) by the lens, (N, 2, 6) by the pose."""
    if not len(slopes):
        return np.zeros((0, 2, len(lens.values))), np.zeros((0, 2, 6))
    places = np.column_stack([slopes * below_m, np.full(len(slopes), below_m)])
    _, J_lens, J_pose = lens.project(places, np.zeros(6))
    by_place = J_pose[:, :, 3:5]  # a place moves a pixel as the pose's translation does
    return np.asarray(np.linalg.solve(by_place, -J_lens)), np.asarray(np.linalg.solve(by_place, -J_pose))

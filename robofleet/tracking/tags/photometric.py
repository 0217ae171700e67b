"""Places tags to a hundredth of a pixel by the greys of their whole pattern, and says how surely.

A tag's neighbourhood on its plane maps to pixels by a quadratic, fitted in nine nodes that go through the whole camera
model: lens, tilt, height, and under a rolling shutter the way that the tag covers from row to row. ``fit.py``
compares each pixel with the pattern. The correlation with the pattern says whether it is this tag: another id of the
family reaches 0.65.

Points of the plane are complex numbers, x + iy; in the tag's own frame, forward + i left, and a side is that of
the whole print.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Complex, Indices
from robofleet.core.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.offset import Covariance
from robofleet.tracking.tags.families import pattern
from robofleet.tracking.tags.fit import fit_tags, study_tag
from robofleet.tracking.tags.imaging import Imaging
from robofleet.tracking.tags.mapping import quadratic
from robofleet.tracking.tags.pixels import PARAMETERS, SHAPED, neighbourhoods
from robofleet.tracking.tags.shape import STUDIED, STUDIED_FROM, Shapes, cut, explained
from robofleet.tracking.tags.targets import Target

_WIDE_PX = 2.2  # blur of a tag that is out of focus, or moves
ALIKE = 0.9  # least correlation of a print with its pattern: a tag has 0.99, one with 4 cells wrong 0.88
_NONE = np.zeros((0, 0), np.bool_)
NOBODY = -1  # as a target


class Found(NamedTuple):
    """A tag in an image: planar pose of its centre in the world frame."""

    target: int  # its index
    centre: complex  # [m]
    psi: float  # [rad; CCW +]
    covariance: Covariance


class Fit(NamedTuple):
    """M tags as an image shows them."""

    centre: Complex  # (M,) [m; world]
    psi: Array  # (M,) [rad; CCW +]
    alike: Array  # (M,) correlation with the pattern; 0 where the fit left the neighbourhood of the guess
    row: Array  # (M,) of the image in which the centre lies [px]
    covariance: Array  # (M, 6), each a ``Covariance``

    def of(self, which: Indices) -> "Fit":
        return Fit(self.centre[which], self.psi[which], self.alike[which], self.row[which], self.covariance[which])

    def found(self, row: int, target: int) -> Found:
        return Found(target, complex(self.centre[row]), float(self.psi[row]), tuple(self.covariance[row].tolist()))


class PhotometricFit:
    """Fits tags of known pattern, size and height near where they are expected.

    It learns each target's blur and noise from fit to fit.
    """

    def __init__(self, geometry: CameraGeometry, targets: Sequence[Target], line_time: float = 0.0) -> None:
        """Take a rolling shutter's time from row to row [s]."""
        self.geometry = geometry
        self._line_time = line_time
        self.family = targets[0].family
        self._wholes = np.array([target.whole for target in targets])
        self.heights = np.array([target.height for target in targets])
        self._prints = np.stack([neighbourhoods(pattern(target.tag, self.family)) for target in targets])
        self.imaging, self._noise = Imaging.unknown(), np.zeros(len(targets))
        self.shapes = Shapes.unknown(len(targets))
        self._to_quadratic = quadratic()
        self.fit(
            np.zeros((4, 4), np.uint8), np.arange(1), np.zeros(1, np.complex128), np.zeros(1)
        )  # compiles, or loads

    def fit(
        self,
        image: NDArray[np.uint8],
        index: Indices,
        centre: Complex,
        psi: Array,
        velocity: Complex | None = None,
        omega: Array | None = None,
        hidden: NDArray[np.bool_] = _NONE,
        studied: int = NOBODY,
        wide_px: float = 0.0,
    ) -> Fit:
        """Return the poses near the guesses ``centre``, ``psi`` (M,) of the targets ``index`` (M,).

        velocity (M,) [m/s; world] and omega (M,) [rad/s] are used under a rolling shutter alone. The cells ``hidden``
        (C, C), row 0 at the print's top, do not count. The shape of the target ``studied`` is learnt from this image.
        """
        m = len(index)
        if velocity is None or omega is None:
            velocity, omega = np.zeros(m, np.complex128), np.zeros(m)
        fit = Fit(np.empty(m, np.complex128), np.empty(m), np.empty(m), np.empty(m), np.empty((m, 6)))
        levels = np.empty((m, 5))
        fit_tags(
            image, self.geometry.flat, self._line_time, self._wholes, self.heights, self._prints,
            FAMILIES[self.family].cells, hidden.ravel(), self._to_quadratic, index, centre, psi, velocity, omega,
            wide_px, *self.imaging, self._noise, self.shapes.values, self.shapes.spreads, levels, *fit,
        )  # fmt: skip
        for row in np.flatnonzero(index == studied).tolist():
            self._study(image, fit, row, studied, complex(velocity[row]), float(omega[row]), levels[row])
        return fit

    def _study(self, image, fit, row, i, velocity, omega, level):
        if fit.alike[row] < STUDIED_FROM:
            return
        contrast = level[3]
        products = np.empty((PARAMETERS + 1 + SHAPED,) * 2)
        counts, slope = study_tag(
            image, self.geometry.flat, self._line_time, self._wholes[i], self.heights[i], self._prints[i],
            FAMILIES[self.family].cells, self._to_quadratic, fit.centre[row], fit.psi[row], velocity, omega,
            self.shapes.values[i], level[4], self.imaging.tone[0], level[:4], cut(self.shapes.counts[i]) * contrast,
            products,
        )  # fmt: skip
        if counts < STUDIED:
            return
        n = PARAMETERS
        products[n] /= contrast
        products[:, n] /= contrast
        left = explained(products)
        variance = max(left[0, 0] / (products[0, 0] - n), (self._noise[i] / contrast) ** 2)
        self.shapes.learn(i, left, np.array(slope), variance)

    def blurred(self, image: NDArray[np.uint8], target: int, centre: complex, psi: float) -> Fit:
        """Return the pose of a target that is out of focus, or moves, in this image: nothing is learnt from it."""
        known = self._noise[target]
        self._noise[target] = 0.0
        fit = self.fit(image, np.array([target]), np.array([centre]), np.array([psi]), wide_px=_WIDE_PX)
        self._noise[target] = known
        return fit

    def report(self):
        i=self.imaging; return f'blur {i.blur[0]:.3f}+{i.blur[1]:.3f} tone {i.tone[0]:.3f} noise {np.median(self._noise):.1f}'

    def pixels(self, index: Indices, centre: Complex) -> Array:
        """Return where points (M,) on the targets' planes appear (M, 2) [px]."""
        world = np.column_stack([centre.real, centre.imag, self.heights[index]])
        return self.geometry.project(world)


def side_px(geometry: CameraGeometry, target: Target) -> float:
    """Return a tag's side straight below the camera [px]."""
    return float(geometry.K[0, 0]) * target.side / (float(geometry.position[2]) - target.height)

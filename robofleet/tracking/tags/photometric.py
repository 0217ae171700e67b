"""Places tags to a hundredth of a pixel by the greys of their whole pattern, and says how surely.

A tag's neighbourhood on its plane maps to pixels by a quadratic, fitted in nine nodes that go through the whole camera
model: lens, tilt, height, and under a rolling shutter the way that the tag covers from row to row. ``fit.py``
compares each pixel with the pattern. The correlation with the pattern says whether it is this tag: another id of the
family reaches 0.65.

Points of the plane are complex numbers, x + iy; in the tag's own frame, forward + i left, and a side is that of
the whole print.
"""

import math
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
from robofleet.tracking.tags.mapping import on_level, quadratic
from robofleet.tracking.tags.pixels import BLOCKED, BLOCKS, PARAMETERS, SHAPED, neighbourhoods
from robofleet.tracking.tags.shape import TILT, STUDIED, STUDIED_FROM, Shapes, cut, explained
from robofleet.tracking.tags.structure import solve
from robofleet.tracking.tags.targets import Target

_WIDE_PX = 2.2  # blur of a tag that is out of focus, or moves
ALIKE = 0.9  # least correlation of a print with its pattern: a tag has 0.99, one with 4 cells wrong 0.88
MODE = 0
_CUT_OFF = 0.993
_NOISY = 1.6
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
        levels = np.empty((m, 7))
        fit_tags(
            image, self.geometry.flat, self._line_time, self._wholes, self.heights, self._prints,
            FAMILIES[self.family].cells, hidden.ravel(), self._to_quadratic, index, centre, psi, velocity, omega,
            wide_px, self.imaging.blur, self.imaging.known, self.imaging.tone, self.imaging.doubt, self.imaging.quietest, self._noise, self.shapes.values, self.shapes.spreads, levels, *fit,
        )  # fmt: skip
        self.levels = levels
        structured = (levels[:, 5] < _CUT_OFF) | (levels[:, 6] > _NOISY)
        for row in np.flatnonzero((fit.alike > 0.6) & structured).tolist():
            self._again(image, fit, row, int(index[row]), complex(velocity[row]), float(omega[row]), levels[row], hidden)
        for row in np.flatnonzero(index == studied).tolist():
            self._study(image, fit, row, studied, complex(velocity[row]), float(omega[row]), levels[row])
        return fit

    def _again(self, image, fit, row, i, velocity, omega, level, hidden):
        """Fit a tag once more whose light has a structure."""
        level, centre, psi, side = level.copy(), complex(fit.centre[row]), float(fit.psi[row]), self._wholes[i]
        n = PARAMETERS
        products = np.empty((n + 1 + SHAPED,) * 2)
        blocks = np.empty((BLOCKS * BLOCKS, BLOCKED, BLOCKED))
        for _ in range(2):
            _, slope, side_px = study_tag(
                image, self.geometry.flat, self._line_time, self._wholes[i], self.heights[i], self._prints[i],
                FAMILIES[self.family].cells, self._to_quadratic, centre, psi, velocity, omega, self.shapes.values[i],
                level[4], self.imaging.tone[0], level[:4], 0.5 * level[3], products, blocks,
            )  # fmt: skip
            lower = blocks[:, : n + 1, : n + 1]
            whole = lower + np.tril(lower, -1).transpose(0, 2, 1)
            solution = solve(whole)
            level[:4] += solution.values[:4]
            forward, left, turn = -solution.values[4:7] / level[3]
            if not (np.hypot(forward, left) < 0.1 and abs(turn) < 0.2):
                return
            ahead = side * complex(math.cos(psi), math.sin(psi))
            centre += ahead * on_level(forward, left, self.shapes.values[i, TILT:], slope)
            psi += turn
        fit.centre[row], fit.psi[row] = centre, psi
        C = np.maximum(1.0, 0) * solution.robust[4:7, 4:7] / level[3] ** 2
        if MODE == 1: C = solution.covariance[4:7, 4:7] / level[3] ** 2
        c, s = math.cos(psi), math.sin(psi)
        R = np.array([[side * c, -side * s, 0.0], [side * s, side * c, 0.0], [0.0, 0.0, 1.0]])
        C = R @ C @ R.T
        fit.covariance[row] = C[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]

    def _study(self, image, fit, row, i, velocity, omega, level):
        if self.imaging.known[0, 0] < 1e4 or fit.alike[row] < STUDIED_FROM or level[5] < _CUT_OFF or level[6] > _NOISY:
            return
        contrast = level[3]
        products = np.empty((PARAMETERS + 1 + SHAPED,) * 2)
        blocks = np.empty((BLOCKS * BLOCKS, BLOCKED, BLOCKED))
        counts, slope, _ = study_tag(
            image, self.geometry.flat, self._line_time, self._wholes[i], self.heights[i], self._prints[i],
            FAMILIES[self.family].cells, self._to_quadratic, fit.centre[row], fit.psi[row], velocity, omega,
            self.shapes.values[i], level[4], self.imaging.tone[0], level[:4], cut(self.shapes.counts[i]) * contrast,
            products, blocks,
        )  # fmt: skip
        if counts < STUDIED:
            return
        n = PARAMETERS
        products[n] /= contrast
        products[:, n] /= contrast
        left = explained(products)
        variance = max(left[0, 0] / (products[0, 0] - n), (self._noise[i] / contrast) ** 2)
        self.imaging.learn(blocks + np.tril(blocks, -1).transpose(0, 2, 1), contrast)
        self.shapes.learn(i, left, np.array(slope), variance)

    def blurred(self, image: NDArray[np.uint8], target: int, centre: complex, psi: float) -> Fit:
        """Return the pose of a target that is out of focus, or moves, in this image: nothing is learnt from it."""
        known = self._noise[target]
        self._noise[target] = 0.0
        fit = self.fit(image, np.array([target]), np.array([centre]), np.array([psi]), wide_px=_WIDE_PX)
        self._noise[target] = known
        return fit

    def report(self):
        i=self.imaging; return f'blur {i.blur[0]:.3f}+{i.blur[1]:.3f} tone {i.tone[0]:.3f} noise {np.median(self._noise):.1f} doubt {i.doubt[0]:.2f} {i.doubt[1]:.2f}'

    def pixels(self, index: Indices, centre: Complex) -> Array:
        """Return where points (M,) on the targets' planes appear (M, 2) [px]."""
        world = np.column_stack([centre.real, centre.imag, self.heights[index]])
        return self.geometry.project(world)


def side_px(geometry: CameraGeometry, target: Target) -> float:
    """Return a tag's side straight below the camera [px]."""
    return float(geometry.K[0, 0]) * target.side / (float(geometry.position[2]) - target.height)

"""Places tags to a hundredth of a pixel by the greys of their whole pattern, and says how surely.

A tag's neighbourhood on its plane maps to pixels by a quadratic, fitted in nine nodes that go through the whole camera
model: lens, tilt, height, and under a rolling shutter the way that the tag covers from row to row. ``fit.py``
compares each pixel with the pattern. The correlation with the pattern says whether it is this tag: another id of the
family reaches 0.65. Where a shadow or a cover changes it by parts, ``structure.py`` solves it once more.

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
from robofleet.tracking.tags.fit import BLUR, CONTRAST, LOOK, STRUCTURED, add_up_tag, fit_tags
from robofleet.tracking.tags.imaging import Imaging
from robofleet.tracking.tags.mapping import on_level, quadratic
from robofleet.tracking.tags.pixels import BLOCKED, BLOCKS, PARAMETERS, POSE, SHAPED, neighbourhoods
from robofleet.tracking.tags.shape import (
    ROUNDED,
    SIZE,
    STUDIED,
    STUDIED_FROM,
    TILT,
    Shapes,
    explained,
    shape_cut,
    turn_variance,
    unexplained,
)
from robofleet.tracking.tags.structure import solve
from robofleet.tracking.tags.targets import Target

_WIDE_PX = 2.2  # blur of a tag that is out of focus, or moves
_WIDEST_EXACT = 0.9  # blur, in cells: beyond, a pixel sees more than the nine cells that the fit knows
ALIKE = 0.9  # least correlation of a print with its pattern: a tag has 0.99, one with 4 cells wrong 0.88
_STRUCTURED_PASSES, _STRUCTURED_CUT = 2, 0.5  # [contrasts] beyond which a pixel shows something else there
_FAR = 0.1  # further the second fit may not be [sides, rad]
_EVEN = 1.6  # variance over that of tags in even light, of a tag that shows its own shape only
_SHADED = 0.6  # share of the residuals that no shape explains, from which they are a shadow's
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


class _Fitted(NamedTuple):
    """One tag as it was fitted."""

    target: int
    centre: complex  # [m; world]
    psi: float  # [rad; CCW +]
    velocity: complex  # [m/s; world]
    omega: float  # [rad/s]
    look: Array  # (LOOK,)


class _Closeup(NamedTuple):
    """One tag's pixels, added up once more where it was fitted."""

    products: Array  # (P + 1 + S, P + 1 + S) of the fit's coefficients, what is left of the grey, and those of a shape
    blocks: Array  # (B, P + 2, P + 2) by blocks: of the fit's, what is left of the grey, and that of the response
    slope: Array  # (2,) under which the tag is seen
    counted: float  # share of the pixels


class _Refit(NamedTuple):
    """A pose by ``structure.solve``."""

    centre: complex
    psi: float
    covariance: Array  # (6,)
    uncertainty: float  # the position's variance [m^2]; infinite: it failed


class PhotometricFit:
    """Fits tags of known pattern, size and height near where they are expected.

    It learns from fit to fit how the camera images (``imaging.py``), and each target's noise and shape.
    """

    def __init__(
        self, geometry: CameraGeometry, targets: Sequence[Target], line_time: float = 0.0,
        imaging: Imaging | None = None,
    ) -> None:  # fmt: skip
        """Take a rolling shutter's time from row to row [s], and what is known of the camera's imaging."""
        self.geometry = geometry
        self._line_time = line_time
        self.family = targets[0].family
        self._wholes = np.array([target.whole for target in targets])
        self.heights = np.array([target.height for target in targets])
        self._prints = np.stack([neighbourhoods(pattern(target.tag, self.family)) for target in targets])
        self.imaging = imaging or Imaging.of(None)
        self._noise = np.zeros(len(targets))
        self.shapes = Shapes.unknown(len(targets))
        self._to_quadratic = quadratic()
        self._compile()

    def _compile(self) -> None:
        """Compile, or load, all kernels that are called from Python."""
        nothing, shapes = np.zeros((4, 4), np.uint8), Shapes.unknown(1)
        self.fit(nothing, np.arange(1), np.zeros(1, np.complex128), np.zeros(1))
        closeup = self._closeup(nothing, _Fitted(0, 0j, 0.0, 0j, 0.0, np.ones(LOOK)), 1.0, _NONE)
        on_level(0.0, 0.0, shapes.applied[0, TILT:], closeup.slope)
        turn_variance(closeup.slope, shapes.spreads[0])
        equations = explained(closeup.products, 1.0)
        unexplained(equations)
        shapes.learn(0, equations, closeup.slope, 1.0)
        self.imaging.variance(0.0)

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
        blur_px: float = 0.0,
    ) -> Fit:
        """Return the poses near the guesses ``centre``, ``psi`` (M,) of the targets ``index`` (M,).

        velocity (M,) [m/s; world] and omega (M,) [rad/s] are used under a rolling shutter alone. The cells ``hidden``
        (C, C), row 0 at the print's top, do not count. From the target ``studied``, its shape and the camera's imaging
        are learnt. blur_px: of these tags, as they are out of focus, or move; 0: the camera's, which learns from them.
        """
        m, camera = len(index), self.imaging
        if velocity is None or omega is None:
            velocity, omega = np.zeros(m, np.complex128), np.zeros(m)
        fit = Fit(np.empty(m, np.complex128), np.empty(m), np.empty(m), np.empty(m), np.empty((m, 6)))
        looks, covers = np.empty((m, LOOK)), np.empty((m, FAMILIES[self.family].cells ** 2), np.bool_)
        shaded = fit_tags(
            image, self.geometry.flat, self._line_time, self._wholes, self.heights, self._prints,
            FAMILIES[self.family].cells, hidden.ravel(), self._to_quadratic, index, centre, psi, velocity, omega,
            blur_px, camera.blur, camera.known, camera.tone, camera.doubt, camera.quiet, self._noise,
            self.shapes.applied, self.shapes.spreads, looks, covers, *fit,
        )  # fmt: skip
        if studied == NOBODY and not shaded:
            return fit
        structured = looks[:, STRUCTURED] > 0.0
        if hidden.size:
            covers |= hidden.ravel()
        for row in np.flatnonzero(structured | (index == studied)).tolist():
            tag = _Fitted(
                int(index[row]), complex(fit.centre[row]), float(fit.psi[row]), complex(velocity[row]),
                float(omega[row]), looks[row],
            )  # fmt: skip
            if structured[row]:
                ways = [self._fit_structured(image, tag, cover) for cover in (hidden, covers[row])]
                way = min(ways, key=lambda way: way.uncertainty)
                if way.uncertainty < math.inf:
                    fit.centre[row], fit.psi[row], fit.covariance[row] = way[:3]
            if tag.target == studied and fit.alike[row] > STUDIED_FROM and self._exact(tag):
                self._study(image, tag)
        return fit

    def blurred(self, image: NDArray[np.uint8], target: int, centre: complex, psi: float) -> Fit:
        """Return the pose of a target that is out of focus, or moves, in this image: nothing is learnt from it."""
        noise, self._noise[target] = self._noise[target], 0.0
        fit = self.fit(image, np.array([target]), np.array([centre]), np.array([psi]), blur_px=_WIDE_PX)
        self._noise[target] = noise
        return fit

    def _fit_structured(self, image: NDArray[np.uint8], tag: _Fitted, hidden: NDArray[np.bool_]) -> _Refit:
        """Fit a tag once more that shadows, or covers, change by parts: see ``structure.py``."""
        i, side, tilt = tag.target, self._wholes[tag.target], self.shapes.applied[tag.target, TILT:]
        for _ in range(_STRUCTURED_PASSES):
            closeup = self._closeup(image, tag, _STRUCTURED_CUT * tag.look[CONTRAST], hidden)
            values, covariance = solve(closeup.blocks[:, : PARAMETERS + 1, : PARAMETERS + 1])
            look = tag.look.copy()
            look[: CONTRAST + 1] += values[: CONTRAST + 1]
            forward, left, turn = (-values[POSE] / max(look[CONTRAST], 1.0)).tolist()
            if not (math.hypot(forward, left) < _FAR and abs(turn) < _FAR and np.isfinite(covariance).all()):
                return _Refit(tag.centre, tag.psi, np.zeros(6), math.inf)
            ahead = side * complex(math.cos(tag.psi), math.sin(tag.psi))
            centre = tag.centre + ahead * on_level(forward, left, tilt, closeup.slope)
            tag = tag._replace(centre=centre, psi=tag.psi + turn, look=look)
        c, s = math.cos(tag.psi), math.sin(tag.psi)
        to_world = np.array([[side * c, -side * s, 0.0], [side * s, side * c, 0.0], [0.0, 0.0, 1.0]])
        spread = to_world @ covariance[POSE, POSE] @ to_world.T / tag.look[CONTRAST] ** 2
        spread[2, 2] += turn_variance(closeup.slope, self.shapes.spreads[i])
        return _Refit(tag.centre, tag.psi, spread[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]], spread[0, 0] + spread[1, 1])

    def _exact(self, tag: _Fitted) -> bool:
        """Return whether the blur is known of a tag that was fitted, and narrow enough for the fit to be exact."""
        camera, blur = self.imaging, float(tag.look[BLUR])
        exact = blur * FAMILIES[self.family].cells < _WIDEST_EXACT * self._side_px(tag.target)
        return camera.settled and camera.shown(blur) and exact

    def _side_px(self, i: int) -> float:
        """Return the side of a target's print straight below the camera [px]."""
        return float(self.geometry.K[0, 0] * self._wholes[i] / (self.geometry.position[2] - self.heights[i]))

    def _study(self, image: NDArray[np.uint8], tag: _Fitted) -> None:
        """Learn a target's shape and the camera's imaging from a tag that was just fitted, if no shadow is on it."""
        contrast, shapes = tag.look[CONTRAST], self.shapes
        closeup = self._closeup(image, tag, shape_cut(shapes.counts[tag.target]) * contrast, _NONE)
        if closeup.counted < STUDIED:
            return
        pixels, equations = closeup.products[0, 0] - PARAMETERS, explained(closeup.products, contrast)
        even = _EVEN * pixels * self.imaging.variance(float(tag.look[0])) / contrast**2
        if unexplained(equations) > max(even, _SHADED * equations[0, 0]):
            return
        self.imaging.learn(closeup.blocks, contrast)
        variance = max(equations[0, 0] / pixels, (self._noise[tag.target] / contrast) ** 2)
        rounding = ROUNDED * (tag.look[BLUR] / self._side_px(tag.target)) ** 2
        equations[0, 1:] -= rounding * equations[1 + SIZE, 1:]
        shapes.learn(tag.target, equations, closeup.slope, variance)

    def _closeup(self, image: NDArray[np.uint8], tag: _Fitted, cut: float, hidden: NDArray[np.bool_]) -> _Closeup:
        """Add up a tag's pixels where it was fitted; one that is off by more than ``cut`` [grey levels] does not
        count."""
        i, size, look = tag.target, PARAMETERS + 1 + SHAPED, tag.look
        products, blocks, slope = np.zeros((size, size)), np.zeros((BLOCKS * BLOCKS, BLOCKED, BLOCKED)), np.zeros(2)
        counted = add_up_tag(
            image, self.geometry.flat, self._line_time, self._wholes[i], self.heights[i], self._prints[i],
            FAMILIES[self.family].cells, hidden.ravel(), self._to_quadratic, tag.centre, tag.psi, tag.velocity,
            tag.omega, self.shapes.applied[i], look[BLUR], self.imaging.tone[0], look[: CONTRAST + 1], cut, products,
            blocks, slope,
        )  # fmt: skip
        return _Closeup(products, blocks, slope, counted)

    def pixels(self, index: Indices, centre: Complex) -> Array:
        """Return where points (M,) on the targets' planes appear (M, 2) [px]."""
        world = np.column_stack([centre.real, centre.imag, self.heights[index]])
        return self.geometry.project(world)


def side_px(geometry: CameraGeometry, target: Target) -> float:
    """Return a tag's side straight below the camera [px]."""
    return float(geometry.K[0, 0]) * target.side / (float(geometry.position[2]) - target.height)

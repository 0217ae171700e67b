"""What a tag is beyond a flat, level square of its side: learnt by recursive least squares, an image at a time.

A print is of another size, stretched or sheared in its plane; it is tilted; it is bowed. What an image shows of the
first five is an affine map, of which the pose takes the turn: three numbers, size, stretch and shear. A stretch is the
same in every image. A tilt's share depends on the slope under which the tag is seen, and that turns with the robot: so
driving tells the two apart. Before, what was expected (``_SIGMA``) shares what is seen, and the spread says how well.

The size is also that of a tag that is nearer to the camera: see ``prints.py``.
"""

import math
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.kernels import image_kernel
from robofleet.tracking.tags.equations import sweep
from robofleet.tracking.tags.pixels import PARAMETERS, SHAPED

# A shape's numbers, as ``mapping.map_pixels`` has them; two of the tilt, then the bows and the twist.
SIZE, STRETCH, SHEAR, TILT, BOW = 0, 1, 2, 3, 5
_NUMBERS = 8
_SIGMA = np.array([0.01, 0.002, 0.001, math.radians(1.5), math.radians(1.5), 0.03, 0.03, 0.02])  # expected
_MOST = np.array([0.05, 0.03, 0.03, math.radians(10.0), math.radians(10.0), 0.3, 0.3, 0.3])
_EXPECTED = 1.0 / _SIGMA**2
STUDIED_FROM, STUDIED = 0.8, 0.985  # least likeness, and share of pixels that count, to learn a shape
# By how much a tag looks smaller, by its blur over its side, squared: the point spread of a lens is more of a Gaussian
# than the B-spline, and rounds corners otherwise. Measured on lenses of 0.7 and 0.9 px, tags of 24 and 36 px (36h11).
ROUNDED = 0.056
_CUT, _KNOWN_CUT = 0.5, 0.3  # [contrasts] beyond which a pixel shows something else, before and after it is known
_KNOWN_FROM = 10  # images
_DOUBT = 2.0  # variance of what is learnt over that of white noise: lens and pattern are not exact
_FORGET = 0.99  # of what was known, from image to image
_LITTLE = 1e-3  # of what is expected, which any image says
_FLAT = 5.0**2  # squared distance of bows from none, below which a tag is taken for flat
_DENIED = 6.0**2  # squared distance of what an image says from what is known


class Shapes(NamedTuple):
    """What is known of the shapes of N tags."""

    values: Array  # (N, 8)
    applied: Array  # (N, 8) the same, of a tag that may be flat without bows: they would only add noise to its position
    known: Array  # (N, 8, 8) information from images, the inverse of a covariance
    spreads: Array  # (N, 8, 8) covariances
    counts: NDArray[np.int64]  # (N,) images from which they were learnt

    @classmethod
    def unknown(cls, tags: int) -> Self:
        n = _NUMBERS
        spreads = np.tile(np.diag(_SIGMA**2), (tags, 1, 1))
        return cls(np.zeros((tags, n)), np.zeros((tags, n)), np.zeros((tags, n, n)), spreads, np.zeros(tags, np.int64))

    def forget(self, tag: int) -> None:
        """Learn a tag's shape anew."""
        for mine, new in zip(self, self.unknown(1), strict=True):
            mine[tag] = new[0]

    def learn(self, tag: int, equations: Array, slope: Array, variance: float) -> None:
        """Learn a tag's shape from what one image says: ``equations`` as ``explained`` returns them [contrasts], seen
        under ``slope``, where the greys have a variance [contrasts^2].

        If the image denies what is known, the tag was moved on its robot, or is another: it is learnt anew.
        """
        scale = 1.0 / (_DOUBT * variance)
        values, spread = self.values[tag], self.spreads[tag]
        denied = _learn(equations, slope[0], slope[1], scale, values, self.applied[tag], self.known[tag], spread)
        self.counts[tag] = 1 if denied else self.counts[tag] + 1


def shape_cut(count: int) -> float:
    """Return beyond which misfit [contrasts] a pixel shows something else, of a shape learnt from ``count`` images."""
    return _CUT if count < _KNOWN_FROM else _KNOWN_CUT


def explained(products: Array, contrast: float) -> Array:
    """Return of the products (P + 1 + S, P + 1 + S) of P coefficients, what is left of the grey, and S coefficients
    more, what the first P do not explain of the others, (1 + S, 1 + S), in contrasts."""
    left = products.copy()
    sweep(left, PARAMETERS)
    equations = left[PARAMETERS:, PARAMETERS:]
    equations[0] /= contrast
    equations[:, 0] /= contrast
    return equations


def unexplained(equations: Array) -> float:
    """Return the squares that no shape explains either [contrasts^2]."""
    left = equations[::-1, ::-1].copy()
    sweep(left, SHAPED)
    return float(left[SHAPED, SHAPED])


@image_kernel
def _learn(equations, ahead, aside, scale, values, applied, known, spread):  # type: ignore[no-untyped-def]
    """Learn from the ``equations`` of an image, in which a tag has the shape ``applied``, times ``scale``; and apply
    what is known now. Return whether the image denies what was known before."""
    n = _NUMBERS
    turn = np.zeros((SHAPED, n))  # the six coefficients, by the eight numbers: a tilt stretches and shears
    for i in range(SHAPED):
        turn[i, i if i < TILT else i + BOW - TILT] = 1.0
    turn[SIZE, TILT], turn[STRETCH, TILT], turn[SHEAR, TILT] = 0.5 * ahead, 0.5 * ahead, 0.5 * aside
    turn[SIZE, TILT + 1], turn[STRETCH, TILT + 1], turn[SHEAR, TILT + 1] = 0.5 * aside, -0.5 * aside, 0.5 * ahead
    image, alone, pull = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    for a in range(n):
        for i in range(SHAPED):
            part = scale * turn[i, a]
            pull[a] += part * equations[0, 1 + i]
            for j in range(SHAPED if part != 0.0 else 0):
                for b in range(n):
                    image[a, b] += part * equations[1 + i, 1 + j] * turn[j, b]
    for a in range(n):
        for b in range(n):
            pull[a] += image[a, b] * (values[b] - applied[b])
            known[a, b] = _FORGET * known[a, b] + image[a, b]
    denied = _squared(pull, image, _LITTLE, alone) - _squared(pull, known, 1.0, spread) > _DENIED
    if denied:
        _copy(image, known)
        _squared(pull, known, 1.0, spread)
    for a in range(n):
        pull[a] += (1.0 - _FORGET) * _EXPECTED[a] * values[a]
    for a in range(n):
        step = 0.0
        for b in range(n):
            step += spread[a, b] * pull[b]
        values[a] = min(max(values[a] - step, -_MOST[a]), _MOST[a])
    _apply(values, spread, applied)
    return denied


@image_kernel
def _apply(values, spread, applied):  # type: ignore[no-untyped-def]
    """Apply what is known; the bows only of a tag that is certainly not flat."""
    n = _NUMBERS - BOW
    bows = np.zeros((n + 1, n + 1))
    for a in range(n):
        for b in range(n):
            bows[a, b] = spread[BOW + a, BOW + b]
        bows[a, n] = bows[n, a] = values[BOW + a]
    sweep(bows, n)
    flat = -bows[n, n] < _FLAT
    for a in range(_NUMBERS):
        applied[a] = 0.0 if flat and a >= BOW else values[a]


@image_kernel
def _squared(vector, known, share, spread):  # type: ignore[no-untyped-def]
    """Return a vector's square by the covariance of what is known, and of a share of what is expected; ``spread``
    (8, 8) becomes that covariance."""
    _copy(known, spread)
    for a in range(_NUMBERS):
        spread[a, a] += share * _EXPECTED[a]
    sweep(spread, _NUMBERS)
    square = 0.0
    for a in range(_NUMBERS):
        for b in range(_NUMBERS):
            spread[a, b] = -spread[a, b]
            square += spread[a, b] * vector[a] * vector[b]
    return square


@image_kernel
def _copy(matrix, other):  # type: ignore[no-untyped-def]
    """Make the other matrix equal: an assignment of all elements takes ten seconds to compile."""
    for a in range(len(matrix)):
        for b in range(len(matrix)):
            other[a, b] = matrix[a, b]


@image_kernel
def turn_variance(slope, spread):  # type: ignore[no-untyped-def]
    """Return what a tilt that is not known exactly adds to a heading's variance [rad^2]: it turns the tag by half of
    itself times the slope under which it is seen."""
    ahead, aside = -0.5 * slope[0], 0.5 * slope[1]
    aa, ab, bb = spread[TILT, TILT], spread[TILT, TILT + 1], spread[TILT + 1, TILT + 1]
    return aa * aside * aside + 2.0 * ab * aside * ahead + bb * ahead * ahead


KERNELS: tuple[Any, ...] = (_learn, sweep, turn_variance)  # that are called from Python

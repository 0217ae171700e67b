"""What a tag is beyond a flat, level square of its side: learnt by recursive least squares, an image at a time.

A print is of another size, stretched or sheared in its plane; it is tilted; it is bowed. What an image shows of the
first five is an affine map, of which the pose takes the turn: three numbers, size, stretch and shear. A stretch is the
same in every image. A tilt's share depends on the slope under which the tag is seen, and that turns with the robot: so
driving tells the two apart. Before, what was expected (``_SIGMA``) shares what is seen, and the spread says how well.

The size is also that of a tag that is nearer to the camera: see ``higher``.
"""

import math
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.kernels import image_kernel
from robofleet.tracking.tags.pixels import PARAMETERS, SHAPED

# A shape's numbers, as ``mapping.map_pixels`` has them; two of the tilt, then the bows and the twist.
SIZE, STRETCH, SHEAR, TILT, BOW = 0, 1, 2, 3, 5
_NUMBERS = 8
_SIGMA = np.array([0.01, 0.002, 0.001, math.radians(1.0), math.radians(1.0), 0.03, 0.03, 0.02])  # expected
_MOST = np.array([0.05, 0.03, 0.03, math.radians(10.0), math.radians(10.0), 0.3, 0.3, 0.3])
_EXPECTED = 1.0 / _SIGMA**2
STUDIED_FROM, STUDIED = 0.8, 0.95  # least likeness, and share of pixels that count, to learn a shape
_CUT, _KNOWN_CUT = 0.8, 0.3  # [contrasts] beyond which a pixel shows something else, before and after it is known
_KNOWN_FROM = 10  # images
_DOUBT = 2.0  # variance of what is learnt over that of white noise: lens and pattern are not exact
_FORGET = 0.99  # of what was known, from image to image
_LITTLE = 1e-3  # of what is expected, which any image says
_DENIED = 6.0**2  # squared distance of what an image says from what is known


class Shapes(NamedTuple):
    """What is known of the shapes of N tags."""

    values: Array  # (N, 8)
    known: Array  # (N, 8, 8) information from images, the inverse of a covariance
    spreads: Array  # (N, 8, 8) covariances
    counts: NDArray[np.int64]  # (N,) images from which they were learnt

    @classmethod
    def unknown(cls, tags: int) -> Self:
        n = _NUMBERS
        spreads = np.tile(np.diag(_SIGMA**2), (tags, 1, 1))
        return cls(np.zeros((tags, n)), np.zeros((tags, n, n)), spreads, np.zeros(tags, np.int64))

    def forget(self, tag: int) -> None:
        """Learn a tag's shape anew."""
        for mine, new in zip(self, self.unknown(1), strict=True):
            mine[tag] = new[0]


    def learn(self, tag: int, equations: Array, slope: Array, variance: float) -> None:
        """Learn a tag's shape from what one image says: ``equations`` as ``explained`` returns them [contrasts], seen
        under ``slope``, where the greys have a variance [contrasts^2].

        If the image denies what is known, the tag was moved on its robot, or is another: it is learnt anew.
        """
        values, known = self.values[tag], self.known[tag]
        turn = _turn(slope) / math.sqrt(_DOUBT * variance)
        pull = turn.T @ equations[-1, :-1] / math.sqrt(_DOUBT * variance)
        image = turn.T @ equations[:-1, :-1] @ turn
        before = _FORGET * known + image
        alone = np.linalg.inv(image + np.diag(_LITTLE * _EXPECTED))
        spread = np.linalg.inv(before + np.diag(_EXPECTED))
        if pull @ (alone - spread) @ pull > _DENIED:
            before, self.counts[tag] = image, 0
            spread = np.linalg.inv(before + np.diag(_EXPECTED))
        known[:], self.spreads[tag] = before, spread
        self.counts[tag] += 1
        pull += (1.0 - _FORGET) * _EXPECTED * values
        values[:] = np.clip(values - spread @ pull, -_MOST, _MOST)


def cut(count: int) -> float:
    """Return beyond which misfit [contrasts] a pixel shows something else, of a shape learnt from ``count`` images."""
    return _CUT if count < _KNOWN_FROM else _KNOWN_CUT


def explained(products: Array) -> Array:
    """Return of the products (P + 1 + S, P + 1 + S) of P coefficients, what is left of the grey, and S coefficients
    more, what the first P do not explain of the S, and of what is left: (S + 1, S + 1)."""
    n = PARAMETERS
    others = np.r_[n + 1 : len(products), n]
    both = products[np.ix_(others, others)]
    to_first = products[np.ix_(others, range(n))]
    scale = np.sqrt(np.diag(products)[:n]) + 1e-9
    inverse = np.linalg.pinv(products[:n, :n] / np.outer(scale, scale)) / np.outer(scale, scale)
    left: Array = both - to_first @ inverse @ to_first.T
    return left


def _turn(slope: Array) -> Array:
    """Return what the numbers of a shape (8,) are in the coefficients of an image (6, 8): a tilt stretches and shears
    along the slope."""
    turn = np.zeros((SHAPED, _NUMBERS))
    turn[[0, 1, 2, 3, 4, 5], [SIZE, STRETCH, SHEAR, BOW, BOW + 1, BOW + 2]] = 1.0
    ahead, aside = 0.5 * slope[0], 0.5 * slope[1]
    turn[: SHEAR + 1, TILT] = ahead, ahead, aside
    turn[: SHEAR + 1, TILT + 1] = aside, -aside, ahead
    return turn


@image_kernel
def turn_variance(slope, spread):  # type: ignore[no-untyped-def]
    """Return what a tilt that is not known exactly adds to a heading's variance [rad^2]: it turns the tag by half of
    itself times the slope under which it is seen."""
    ahead, aside = -0.5 * slope[0], 0.5 * slope[1]
    aa, ab, bb = spread[TILT, TILT], spread[TILT, TILT + 1], spread[TILT + 1, TILT + 1]
    return aa * aside * aside + 2.0 * ab * aside * ahead + bb * ahead * ahead

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
from robofleet.tracking.tags.mapping import map_pixels, sight_slope
from robofleet.tracking.tags.pixels import MOST_ROWS, PARAMETERS, SHAPED, accumulate

# A shape's numbers, as ``mapping.map_pixels`` has them; two of the tilt, then the bows and the twist.
SIZE, STRETCH, SHEAR, TILT, BOW = 0, 1, 2, 3, 5
_NUMBERS = 8
_SIGMA = np.array([0.01, 0.002, 0.001, math.radians(1.0), math.radians(1.0), 0.03, 0.03, 0.02])  # expected
_MOST = np.array([0.05, 0.03, 0.03, math.radians(10.0), math.radians(10.0), 0.3, 0.3, 0.3])
_EXPECTED = 1.0 / _SIGMA**2
STUDIED_FROM, _STUDIED = 0.8, 0.95  # least likeness, and share of pixels that count, to learn a shape
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


@image_kernel
def study(  # type: ignore[no-untyped-def]
    image, camera, line_time, side, height, corners, cells, to_quadratic, centre, psi, velocity, omega, blur, noise,
    tag_shape, known, spread, count, room,
):  # fmt: skip
    """Learn a tag's shape (8,) from an image in which it was just fitted; see ``Shapes``, count (1,). If the image
    denies what is known, the tag was moved on its robot, or is another: it is learnt anew.

    All pixels count that do not show something quite different: a wrong shape shows where the fit is worst.
    """
    _, side_px = map_pixels(
        camera, line_time, side, height, tag_shape, to_quadratic, centre, psi, velocity, omega, room.nodes, room.bend,
        room.shape, room.window,
    )  # fmt: skip
    slope = sight_slope(camera, side, height, centre, room.shape, room.window)
    contrast = room.level[3]
    cut = contrast * (_CUT if count[0] < _KNOWN_FROM else _KNOWN_CUT)
    inside = accumulate(
        image, room.shape, room.window, corners, cells, np.zeros(0, np.bool_), np.zeros((0, 2), np.int64), side_px,
        blur, room.level, cut, 1 + int(side_px / MOST_ROWS), room.rows, room.pixels, room.products, room.sums, slope,
        room.shaped,
    )  # fmt: skip
    if not inside or room.products[0, 0] < _STUDIED * room.sums[0]:
        return
    # What the pose and the light do not explain of the shape's six coefficients, and of what is left of the grey.
    n, m = PARAMETERS, PARAMETERS + SHAPED
    left = np.empty((m + 1, m + 1))
    left[:n, :n], left[m, :n], left[m, m] = room.products[:n, :n], room.products[n, :n], room.products[n, n]
    left[n:m, :n], left[n:m, n:m], left[m, n:m] = room.shaped[:, :n], room.shaped[:, n + 1 :], room.shaped[:, n]
    _sweep(left, n)
    variance = max(left[m, m] / (room.products[0, 0] - n), noise * noise)
    by = contrast / (_DOUBT * variance)
    # The six by the eight numbers: a tilt stretches and shears along the slope.
    turn = np.zeros((SHAPED, _NUMBERS))
    for i in range(SHAPED):
        turn[i, i if i < TILT else i + BOW - TILT] = 1.0
    ahead, aside = 0.5 * slope[0], 0.5 * slope[1]
    turn[SIZE, TILT], turn[STRETCH, TILT], turn[SHEAR, TILT] = ahead, ahead, aside
    turn[SIZE, TILT + 1], turn[STRETCH, TILT + 1], turn[SHEAR, TILT + 1] = aside, -aside, ahead
    told, off = np.zeros((_NUMBERS, _NUMBERS)), np.zeros(_NUMBERS)
    for a in range(_NUMBERS):
        for i in range(SHAPED):
            off[a] += by * turn[i, a] * left[m, n + i]
            for j in range(SHAPED):
                part = by * contrast * turn[i, a] * left[n + max(i, j), n + min(i, j)]
                for b in range(_NUMBERS):
                    told[a, b] += part * turn[j, b]
    known *= _FORGET
    known += told
    if _squared(off, told, _LITTLE, spread) - _squared(off, known, 1.0, spread) > _DENIED:
        known[:], count[0] = told, 0
        _squared(off, known, 1.0, spread)
    count[0] += 1
    for a in range(_NUMBERS):
        off[a] += (1.0 - _FORGET) * _EXPECTED[a] * tag_shape[a]
    for a in range(_NUMBERS):
        step = 0.0
        for b in range(_NUMBERS):
            step += spread[a, b] * off[b]
        tag_shape[a] = min(max(tag_shape[a] - step, -_MOST[a]), _MOST[a])


@image_kernel
def _sweep(matrix, many):  # type: ignore[no-untyped-def]
    """Solve for the first variables of a symmetric matrix, by its lower triangle: the upper left block becomes minus
    its inverse, and the lower right one what these variables do not explain of the others."""
    for k in range(many):
        pivot = 1.0 / (matrix[k, k] + 1e-9)
        for i in range(len(matrix)):
            if i != k:
                share = pivot * (matrix[i, k] if i > k else matrix[k, i])
                for j in range(i + 1):
                    if j != k:
                        matrix[i, j] -= share * (matrix[j, k] if j > k else matrix[k, j])
        for i in range(k):
            matrix[k, i] *= pivot
        for i in range(k + 1, len(matrix)):
            matrix[i, k] *= pivot
        matrix[k, k] = -pivot


@image_kernel
def _squared(vector, known, share, spread):  # type: ignore[no-untyped-def]
    """Return a vector's square by the covariance of what is known, and of a share of what is expected; ``spread`` (8,
    8) becomes that covariance."""
    spread[:] = known
    for a in range(_NUMBERS):
        spread[a, a] += share * _EXPECTED[a]
    _sweep(spread, _NUMBERS)
    square = 0.0
    for a in range(_NUMBERS):
        for b in range(a + 1):
            spread[a, b] = -spread[a, b]
            spread[b, a] = spread[a, b]
            square += (2.0 if b < a else 1.0) * spread[a, b] * vector[a] * vector[b]
    return square


@image_kernel
def turn_variance(slope, spread):  # type: ignore[no-untyped-def]
    """Return what a tilt that is not known exactly adds to a heading's variance [rad^2]: it turns the tag by half of
    itself times the slope under which it is seen."""
    ahead, aside = -0.5 * slope[0], 0.5 * slope[1]
    aa, ab, bb = spread[TILT, TILT], spread[TILT, TILT + 1], spread[TILT + 1, TILT + 1]
    return aa * aside * aside + 2.0 * ab * aside * ahead + bb * ahead * ahead

"""What is known of a tag's own shape: its tilt, learnt from image to image by recursive least squares."""

import math

import numpy as np

from robofleet.core.kernels import image_kernel
from robofleet.tracking.tags.mapping import map_pixels, sight_slope
from robofleet.tracking.tags.pixels import MOST_ROWS, PARAMETERS, accumulate

STUDIED_FROM, _STUDIED = 0.8, 0.95  # least likeness, and share of pixels that count, to learn a tilt
_CUT = 0.8  # [contrasts] beyond which a pixel shows something else there
_DOUBT = 2.0  # variance of what is learnt of a tilt over that of white noise: lens and pattern are not exact
_FORGET = 0.99  # of what was known, from image to image
_PRIOR = 1.0 / math.radians(1.0) ** 2  # what is known of a tilt before it was learnt [1/rad^2]
_LITTLE = 1e-3  # of that, which any image says
_DENIED = 4.0**2  # squared distance of what an image says from what is known
_MOST_TILT = math.radians(10.0)


@image_kernel
def study(  # type: ignore[no-untyped-def]
    image, camera, line_time, side, height, corners, cells, to_quadratic, centre, psi, velocity, omega, blur, noise,
    tilt, known, count, room,
):  # fmt: skip
    """Learn a tag's tilt (2,) [rad] by recursive least squares, from an image in which it was just fitted; known (2, 2)
    is the information on it [1/rad^2], from ``count`` (1,) images. If an image denies what is known, the tag was moved
    on its robot: it is learnt anew.

    A tilt shears a tag that is seen aslant, and turns it. The size is left free: an error of the height changes it.
    All pixels count that do not show something quite different: a tilt shows where the fit is worst.
    """
    _, side_px = map_pixels(
        camera, line_time, side, height, tilt, to_quadratic, centre, psi, velocity, omega, room.nodes, room.bend,
        room.shape, room.window,
    )  # fmt: skip
    slope = sight_slope(camera, side, height, centre, room.shape, room.window)
    contrast = room.level[3]
    inside = accumulate(
        image, room.shape, room.window, corners, cells, np.zeros(0, np.bool_), np.zeros((0, 2), np.int64), side_px,
        blur, room.level, _CUT * contrast, 1 + int(side_px / MOST_ROWS), room.rows, room.pixels, room.products,
        room.sums, slope, room.tilted,
    )  # fmt: skip
    if not inside or room.products[0, 0] < _STUDIED * room.sums[0]:
        return
    # What the eight, and then the size, do not explain of the tilts and of what is left of the grey.
    n = PARAMETERS
    left = np.empty((n + 4, n + 4))
    left[:n, :n], left[n : n + 3, :n], left[n + 3, :n] = room.products[:n, :n], room.tilted[:, :n], room.products[n, :n]
    left[n : n + 3, n : n + 3], left[n + 3, n : n + 3] = room.tilted[:, n + 1 :], room.tilted[:, n]
    left[n + 3, n + 3] = room.products[n, n]
    _eliminate(left, n + 1)
    left = left[n + 1 :, n + 1 :]
    variance = left[2, 2] / (room.products[0, 0] - PARAMETERS)
    by = contrast / (_DOUBT * max(variance, noise * noise))
    a, b = by * left[2, 0], by * left[2, 1]
    new_aa, new_ab, new_bb = by * contrast * left[0, 0], by * contrast * left[1, 0], by * contrast * left[1, 1]
    known *= _FORGET
    aa, ab, bb = known[0, 0] + new_aa, known[0, 1] + new_ab, known[1, 1] + new_bb
    by_all = _squared(a, b, aa + _PRIOR, ab, bb + _PRIOR)
    if _squared(a, b, new_aa + _LITTLE * _PRIOR, new_ab, new_bb + _LITTLE * _PRIOR) - by_all > _DENIED:
        aa, ab, bb, count[0] = new_aa, new_ab, new_bb, 0
    known[0, 0], known[0, 1], known[1, 1] = aa, ab, bb
    count[0] += 1
    aa, bb = aa + _PRIOR, bb + _PRIOR
    area = aa * bb - ab * ab
    tilt[0] = min(max(tilt[0] - (bb * a - ab * b) / area, -_MOST_TILT), _MOST_TILT)
    tilt[1] = min(max(tilt[1] - (aa * b - ab * a) / area, -_MOST_TILT), _MOST_TILT)


@image_kernel
def _eliminate(products, many):  # type: ignore[no-untyped-def]
    """Make the lower triangle of a symmetric matrix that of what its first rows do not explain of the others."""
    for k in range(many):
        pivot = products[k, k] + 1e-7 * products[k, k] + 1e-9
        for i in range(k + 1, len(products)):
            share = products[i, k] / pivot
            for j in range(k + 1, i + 1):
                products[i, j] -= share * products[j, k]


@image_kernel
def _squared(a, b, aa, ab, bb):  # type: ignore[no-untyped-def]
    """Return a vector's square by the inverse of a symmetric matrix."""
    return (bb * a * a - 2.0 * ab * a * b + aa * b * b) / (aa * bb - ab * ab)


@image_kernel
def tilt_variance(slope, known):  # type: ignore[no-untyped-def]
    """Return what a tilt that is not known exactly adds to a heading's variance [rad^2]: it turns the tag by half of
    itself times the slope under which it is seen."""
    aa, ab, bb = known[0, 0] + _PRIOR, known[0, 1], known[1, 1] + _PRIOR
    ahead, aside = 0.5 * slope[0], 0.5 * slope[1]
    return (bb * aside * aside + 2.0 * ab * aside * ahead + aa * ahead * ahead) / (aa * bb - ab * ab)

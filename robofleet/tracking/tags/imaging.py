"""How a camera shows an edge: its blur over the image, its response and what is left of the greys; one for all tags.

An edge's blur is a quadratic B-spline of a width, whose variance is a quarter of the width squared: the pixel's square
and the lens, near enough a Gaussian. It grows with the squared distance from the image's centre. All tags, also those
that lie still, teach it by recursive least squares.
"""

from typing import NamedTuple, Self

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import image_kernel

NARROWEST, WIDEST = 0.6, 5.0  # blur [px]
_EXPECTED_PX = 1.6  # of a camera of which nothing is known: a Gaussian of 0.75 px, and a pixel
_SIGMA = np.array([1.0, 0.3])  # of the blur in the middle, and of its growth to the corner [px]
_FORGET = 0.998  # of what was known, from tag to tag
_LEAST_PX = 0.03  # standard deviation of what one tag says: print and lens are not exact
KNOWN = 1.0 / 0.04**2  # information from which a blur is known [1/px^2]
_STEP_PX = 1.0  # at most, by one tag


class Imaging(NamedTuple):
    """What is known of a camera; a kernel writes it."""

    blur: Array  # (2,) in the middle, and how much more in the corners [px]
    known: Array  # (2, 2) information on these [1/px^2]
    tone: Array  # (1,) how far the middle between black and white lies above linear light [contrasts]

    @classmethod
    def unknown(cls) -> Self:
        return cls(np.array([_EXPECTED_PX, 0.0]), np.diag(1.0 / _SIGMA**2), np.zeros(1))


@image_kernel
def corner_share(image, u, v):  # type: ignore[no-untyped-def]
    """Return a pixel's squared distance from the image's middle over that of a corner, 1 at most."""
    height, width = image.shape
    x, y = 2.0 * u / width - 1.0, 2.0 * v / height - 1.0
    area = float(width * width + height * height)
    return min((x * x * width * width + y * y * height * height) / area, 1.0)


@image_kernel
def learn_blur(blur, known, share, wider, variance):  # type: ignore[no-untyped-def]
    """Take from one tag, at a share of the way to the corners, that the blur is wider by so much [px]."""
    weight = 1.0 / (variance + _LEAST_PX * _LEAST_PX)
    wider = min(max(wider, -_STEP_PX), _STEP_PX)
    for i in range(2):
        for j in range(2):
            known[i, j] *= _FORGET
        known[i, i] += (1.0 - _FORGET) / (_SIGMA[i] * _SIGMA[i])
    known[0, 0] += weight
    known[0, 1] += weight * share
    known[1, 1] += weight * share * share
    known[1, 0] = known[0, 1]
    off = weight * wider
    area = known[0, 0] * known[1, 1] - known[0, 1] * known[1, 0]
    blur[0] += off * (known[1, 1] - known[0, 1] * share) / area
    blur[1] += off * (known[0, 0] * share - known[0, 1]) / area
    blur[0] = min(max(blur[0], NARROWEST), WIDEST)

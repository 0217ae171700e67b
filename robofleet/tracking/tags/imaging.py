"""How a camera shows an edge: its blur over the image, its response and what is left of the greys; one for all tags.

An edge's blur is a quadratic B-spline of a width, whose variance is a quarter of the width squared: the pixel's square
and the lens, near enough a Gaussian. It grows with the squared distance from the image's centre. All tags, also those
that lie still, teach it by recursive least squares.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from robofleet.config.calibrated import ImagingSettings
from robofleet.core.arrays import Array
from robofleet.core.kernels import image_kernel
from robofleet.tracking.tags.pixels import BLOCKS

NARROWEST, WIDEST = 0.6, 5.0  # blur [px]
_EXPECTED_PX = 1.6  # of a camera of which nothing is known: a Gaussian of 0.75 px, and a pixel
_SIGMA = np.array([1.0, 0.3])  # of the blur in the middle, and of its growth to the corner [px]
_FORGET = 0.998  # of what was known, from tag to tag
_FORGET_OFF, _OFF_PX = 0.7, 0.25  # the same of a tag that is blurred quite otherwise: the lens may have been touched
_LEAST_PX = 0.03  # standard deviation of what one tag says: print and lens are not exact
KNOWN, _SETTLED = 1.0 / 0.04**2, 1.0 / 0.01**2  # information from which a blur is known, and very well [1/px^2]
_SHOWN_PX = 0.15  # of a tag's blur beyond the camera's, from which it is another
_TONE_SIGMA = 0.1  # of the response of a camera of which nothing is known [contrasts]
_CALIBRATED_SIGMA, _CALIBRATED_TONE_SIGMA = np.array([0.1, 0.1]), 0.02  # of what a calibration says
_PIXEL = 1.0 / 12.0  # variance of its square [px^2]
_TONE_DOUBT = 4.0  # variance of what is learnt over that of white noise
_MOST_TONE = 0.24
_DOUBT_GAIN = 0.02
# Noise is correlated across the edges of blocks too. Bartlett's weights of two blocks (25, 25): a half for a neighbour
# in a row or a column, a quarter for one across.
_BESIDE = np.kron(*[np.maximum(1.0 - 0.5 * np.abs(np.subtract.outer(np.arange(BLOCKS), np.arange(BLOCKS))), 0.0)] * 2)
_UNEXPLAINED = 0.77  # share of white noise's variance that the fit leaves in these products, for any tag
_CHANGED, _CHANGED_PX, _CHANGED_IMAGES = 0.25, 0.15, 30  # of a blur that is told, for so many images
_LEAST_VARIANCE = 0.1  # [grey levels^2]
_FALL, _RISE = 0.2, 0.01  # gains of the least variance
_STEP_PX = 1.0  # at most, by one tag


class Imaging(NamedTuple):
    """What is known of a camera; a kernel writes it."""

    blur: Array  # (2,) in the middle, and how much more in the corners [px]
    known: Array  # (2, 2) information on these [1/px^2]
    tone: Array  # (1,) how far the middle between black and white lies above linear light [contrasts]
    tone_known: Array  # (1,) information on it
    doubt: Array  # (2,) variances of position and of heading over those of white noise
    quiet: Array  # (1,) variance that a fit leaves of a tag in even light, as ``quiet_variance`` has it [grey levels^2]

    @classmethod
    def of(cls, settings: ImagingSettings | None) -> Self:
        """Return what a calibration says of a camera; what it does not say is learnt."""
        blur, sigma, tone, tone_sigma = np.array([_EXPECTED_PX, 0.0]), _SIGMA, 0.0, _TONE_SIGMA
        if settings is not None and settings.blur_px is not None:
            middle = _width(settings.blur_px)
            corner = middle if settings.blur_edge_px is None else _width(settings.blur_edge_px)
            blur, sigma = np.array([middle, corner - middle]), _CALIBRATED_SIGMA
        if settings is not None and settings.tone is not None:
            tone, tone_sigma = settings.tone, _CALIBRATED_TONE_SIGMA
        tone = min(max(tone, -_MOST_TONE), _MOST_TONE)
        known = np.full(1, tone_sigma**-2)
        return cls(blur, np.diag(sigma**-2), np.full(1, tone), known, np.ones(2), np.zeros(1))

    @property
    def sigma_px(self) -> float:
        """Standard deviation of the lens's point spread in the image's middle [px]."""
        return math.sqrt(max(self.blur[0] ** 2 / 4.0 - _PIXEL, 0.0))

    @property
    def settled(self) -> bool:
        """Whether the blur is known well enough for what else a tag shows."""
        return bool(self.known[0, 0] > _SETTLED)

    def shown(self, blur_px: float) -> bool:
        """Return whether a tag of this blur is as the camera images tags somewhere: not out of focus, nor moving."""
        middle, growth = self.blur.tolist()
        return bool(min(0.0, growth) - _SHOWN_PX < blur_px - middle < max(0.0, growth) + _SHOWN_PX)

    def variance(self, brightness: float) -> float:
        """Return the variance that a fit leaves of a tag of this brightness in even light [grey levels^2]."""
        return float(quiet_variance(self.quiet, brightness))

    def learn(self, blocks: Array, contrast: float) -> None:
        """Learn response and noise from the products (B, P + 2, P + 2) of a tag's blocks: of P coefficients, what is
        left of the grey, and the response's coefficient."""
        n = blocks.shape[1] - 2
        total = blocks.sum(0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total)[:n], 1e-9))
        inverse = np.linalg.inv(total[:n, :n] * np.outer(scale, scale) + 1e-9 * np.eye(n)) * np.outer(scale, scale)
        values = inverse @ total[:n, n]
        step = np.append(-values, 1.0)
        variance = step @ total[: n + 1, : n + 1] @ step / (total[0, 0] - n)
        score = blocks[:, :n, : n + 1] @ step
        robust = inverse @ (score.T @ _BESIDE @ score) @ inverse / _UNEXPLAINED
        white = variance * np.diag(inverse)
        ratio = np.array([(robust[4, 4] + robust[5, 5]) / (white[4] + white[5]), robust[6, 6] / white[6]])
        self.doubt[:] += _DOUBT_GAIN * (np.clip(ratio, 0.2, 5.0) - self.doubt)
        curve = total[n + 1, : n + 1] - total[n + 1, :n] @ inverse @ total[:n, : n + 1]
        size = total[n + 1, n + 1] - total[n + 1, :n] @ inverse @ total[:n, n + 1]
        known = contrast**2 * size / (_TONE_DOUBT * variance)
        self.tone_known[0] = _FORGET * self.tone_known[0] + (1.0 - _FORGET) / _TONE_SIGMA**2 + known
        self.tone[0] += known / self.tone_known[0] * curve[n] / (size * contrast)
        self.tone[0] = min(max(self.tone[0], -_MOST_TONE), _MOST_TONE)


class BlurMonitor:
    """Says when a camera's blur is another than before: its lens was touched, or something lies on it."""

    def __init__(self, imaging: Imaging, calibrated_px: float | None) -> None:
        self._imaging, self._known_px, self._images = imaging, calibrated_px, 0

    def changed(self) -> float | None:
        """Return the blur [px], a standard deviation, if it changed for some images; called once an image."""
        if not self._imaging.settled:
            return None
        now_px = self._imaging.sigma_px
        if self._known_px is None:
            self._known_px = now_px
        self._images = (
            self._images + 1 if abs(now_px - self._known_px) > max(_CHANGED * self._known_px, _CHANGED_PX) else 0
        )
        if self._images < _CHANGED_IMAGES:
            return None
        self._known_px, self._images = now_px, 0
        return now_px


def _width(sigma_px: float) -> float:
    """Return the B-spline's width of a lens's standard deviation and a pixel [px]."""
    return min(max(2.0 * math.sqrt(sigma_px**2 + _PIXEL), NARROWEST), WIDEST)


@image_kernel
def blur_at(blur, share):  # type: ignore[no-untyped-def]
    """Return the blur at a share of the way to the corners [px]."""
    return min(max(blur[0] + share * blur[1], NARROWEST), WIDEST)


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
    forget = _FORGET if abs(wider) < _OFF_PX else _FORGET_OFF
    for i in range(2):
        for j in range(2):
            known[i, j] *= forget
        known[i, i] += (1.0 - forget) / (_SIGMA[i] * _SIGMA[i])
    known[0, 0] += weight
    known[0, 1] += weight * share
    known[1, 1] += weight * share * share
    known[1, 0] = known[0, 1]
    off = weight * wider
    area = known[0, 0] * known[1, 1] - known[0, 1] * known[1, 0]
    blur[0] += off * (known[1, 1] - known[0, 1] * share) / area
    blur[1] += off * (known[0, 0] * share - known[0, 1]) / area
    blur[0] = min(max(blur[0], NARROWEST), WIDEST)


@image_kernel
def quiet_variance(quiet, brightness):  # type: ignore[no-untyped-def]
    """Return the variance of a tag's greys in even light by that of black, of which a grey of 128 has twice as much:
    brightness counts from there."""
    return max(quiet[0], _LEAST_VARIANCE) * (1.0 + max(brightness + 128.0, 0.0) / 128.0)


@image_kernel
def learn_quiet(quiet, brightness, variance):  # type: ignore[no-untyped-def]
    """Follow the least variance that fits leave: that of tags in even light."""
    now = variance / quiet_variance(quiet, brightness) * max(quiet[0], _LEAST_VARIANCE)
    gain = _FALL if now < quiet[0] else _RISE
    quiet[0] = now if quiet[0] == 0.0 else quiet[0] + gain * (now - quiet[0])

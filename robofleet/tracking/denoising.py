"""Notices that a camera mixes each image with the one before (temporal noise reduction), and undoes it.

Of such a camera image k is y_k = (1 - a) x_k + a y_(k-1): what moves lags. The noise of one still pixel is correlated
from image to image then: successive differences of white noise have the correlation -1/2, these have -(1 - a) / 2. That
is measured at pixels that are no edge, as the difference of two neighbours, in which lamps that flicker cancel. Where
a camera filters still parts only, nothing that moves lags, though the noise looks alike: so the share is believed only
if moving tags look more like themselves without it. Then x_k = (y_k - a y_(k-1)) / (1 - a) is the image as it was
exposed, with its whole noise.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image

_ROWS, _COLUMNS = 40, 8  # one of so many has a pixel that is compared
_IN_A_ROW = 4  # images of a look
_EVERY = 30  # images, after the first looks
_LOOKS, _REMEMBERED = 6, 30  # before a share is known; and so many are remembered
_FLAT = 12  # grey levels between two neighbours that are no edge
_OUTLIER = 4.0  # standard deviations: something moved there
_LEAST_NOISE = 0.7  # [grey levels], below which rounding hides how noise is correlated
_LEAST_SHARE = 0.1  # of the image before
_MOST_SHARE = 0.8
_GAP = 1.5  # usual times between images, from which one is missing
_TRIALS, _WON = 10, 8  # moving tags that are compared, and those that must look better


class TemporalDenoising:
    """Follows the images of one camera. ``share``: a, of the image before; 0 as long as none is believed."""

    def __init__(self) -> None:
        self.share = 0.0
        self._suspected = 0.0
        self._samples: list[NDArray[np.int16]] = []
        self._squares = self._products = 0.0
        self._looks = self._images = 0
        self._before: Image | None = None
        self._exposed_ns, self._period_ns = 0, 0
        self._trials = self._won = 0

    def undone(self, image: Image, exposure_ns: int) -> Image | None:
        """Return an image (H, W) without the one before; None if it has none of it, or if that is not known.

        As long as ``share`` is 0, the result is on trial: see ``judge``.
        """
        step_ns, self._exposed_ns = exposure_ns - self._exposed_ns, exposure_ns
        self._period_ns = min(self._period_ns or step_ns, step_ns)
        follows = step_ns < _GAP * self._period_ns
        self._look(image, follows=follows)
        if not self._suspected:
            self._before = None
            return None
        before, self._before = self._before, image.copy()
        if before is None or not follows or before.shape != image.shape:
            return None
        a = self._suspected
        return np.asarray(cv2.addWeighted(image, 1.0 / (1.0 - a), before, -a / (1.0 - a), 0.0), np.uint8)

    def judge(self, alike: Array, alike_undone: Array) -> bool:
        """Take how much moving tags (M,) look like themselves in an image, and in that without the one before; returns
        whether the share is believed from now on."""
        self._trials += len(alike)
        self._won += int(np.count_nonzero(alike_undone > alike))
        if self._trials < _TRIALS:
            return False
        won, self._trials, self._won = self._won >= _WON / _TRIALS * self._trials, 0, 0
        self.share = self._suspected if won else 0.0
        return won

    def _look(self, image: Image, *, follows: bool) -> None:
        """Learn the share from three images in a row; the one before them says where no edge is."""
        self._images += 1
        if not follows:
            self._samples.clear()
        if self._looks >= _REMEMBERED and self._images % _EVERY >= _IN_A_ROW:
            self._samples.clear()
            return
        rows = image[_ROWS // 2 :: _ROWS]
        self._samples.append(rows[:, ::_COLUMNS].astype(np.int16) - rows[:, 1::_COLUMNS])
        if len(self._samples) < _IN_A_ROW:
            return
        calm, first, second, third = self._samples
        self._samples.pop(0)
        earlier, later = (second - first).astype(np.float32), (third - second).astype(np.float32)
        flat = np.abs(calm) < _FLAT
        noise = 1.4826 * float(np.median(np.abs(earlier[flat]))) if flat.any() else 0.0
        if noise < _LEAST_NOISE:
            return
        still = flat & (np.maximum(np.abs(earlier), np.abs(later)) < _OUTLIER * noise)
        earlier, later = earlier[still], later[still]
        keep = 1.0 - 1.0 / min(self._looks + 1, _REMEMBERED)
        # Without what rounding adds: a variance of 1/12 in each of the four pixels of a difference.
        self._squares = keep * self._squares + 0.5 * float(earlier @ earlier + later @ later) - len(earlier) / 3.0
        self._products = keep * self._products + float(earlier @ later) + len(earlier) / 6.0
        self._looks += 1
        share = 1.0 + 2.0 * self._products / self._squares
        known = self._looks >= _LOOKS and share > _LEAST_SHARE
        self._suspected = min(share, _MOST_SHARE) if known else 0.0
        self.share = self._suspected if self.share else 0.0

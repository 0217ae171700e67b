"""Which cameras are believed: where two see the same robots, they must see them at the same places.

A camera that was knocked shows every robot elsewhere, by millimetres to centimetres. Two cameras are compared by the
robots that both see at nearly one instant, each against what the filter predicted for its own mid-exposure: what the
prediction gets wrong is common to both. Where their median distance is too large in some images in a row, one of them
is not believed any more, until they agree again for a while. Of the two it is

1. the one that disagrees with further cameras, too;
2. the one that jumped: in the first of those images it was the further one from the prediction;
3. the one without a floor tag in its view, by which the other one's tracker corrects what moved;
4. of two that moved apart slowly, the one that was a little further away.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.tracking.joined import TOGETHER_NS, Seen
from robofleet.tracking.measured import COLUMNS

Array = NDArray[np.float64]

_VARIANCES = [3, 5]  # columns of x and y
APART_M = 0.001  # two calibrated cameras agree to some tenths of a millimetre
_NOISES = 4.0  # standard deviations of a measurement, where these are more
_IMAGES = 3  # in a row: a tag that something covers for a moment is off in fewer
_AGAIN = 30  # images in a row before a camera is believed again: a second
_JUMPED = 2.0  # times as far from the prediction as the other


class Verdict(NamedTuple):
    """A camera that is not believed any more, or again."""

    camera: int
    believed: bool
    apart: float  # from the other [m]


class Agreement:
    """Told of every image, it says whom to believe. ``compared`` (N,): robots by which cameras are judged.

    ``noise``: standard deviation of a position at least, whatever its covariance says [m]. ``fixed`` (C,): cameras that
    see a floor tag.
    """

    def __init__(self, compared: NDArray[np.bool_], noise: float, fixed: NDArray[np.bool_]) -> None:
        cameras, robots = len(fixed), len(compared)
        self.believed = np.ones(cameras, np.bool_)
        self._compared, self._fixed = compared, fixed
        self._noise = noise
        self._off = np.full((cameras, robots, 2), np.nan)  # newest measurement minus prediction
        self._variances = np.zeros((cameras, robots))  # of these [m^2]: the mean of x and y
        self._at_ns = np.zeros((cameras, robots), np.int64)
        self._streaks = np.zeros((cameras, cameras), np.int64)  # images in a row in which two were apart
        self._onsets = np.zeros((cameras, cameras))  # how far the first was from the prediction when that began
        self._again = np.zeros(cameras, np.int64)  # images in a row in which one that is not believed agreed

    def look(self, seen: Seen, predicted: Array) -> Verdict | None:
        """Take an image, and the poses (N, 3) that were predicted for it, NaN where none was; returns what changes."""
        own = seen.camera
        good = seen.measured & self._compared & np.isfinite(predicted[:, 0])
        self._off[own] = np.where(good[:, None], seen.poses[:, :2] - predicted[:, :2], np.nan)
        self._at_ns[own] = np.where(good, seen.instants_ns, 0)
        if seen.poses.shape[1] == COLUMNS:
            self._variances[own] = seen.poses[:, _VARIANCES].mean(axis=1)
        for other in range(len(self.believed)):
            far, limit = self._apart(own, other)
            if other == own or np.isnan(far):
                continue
            if self.believed[own] and self.believed[other]:
                verdict = self._judge(own, other, far, limit)
            elif self.believed[own] or self.believed[other]:
                verdict = self._forgive(other if self.believed[own] else own, far, limit)
            else:
                continue
            if verdict is not None:
                return verdict
        return None

    def _apart(self, own: int, other: int) -> tuple[float, float]:
        """Return how far apart two cameras see the robots that both show now, and how far they may [m]; NaN: none."""
        far = np.linalg.norm(self._off[own] - self._off[other], axis=1)
        both = (np.abs(self._at_ns[own] - self._at_ns[other]) < TOGETHER_NS) & np.isfinite(far)
        if not both.any():
            return np.nan, np.nan
        said = np.maximum(self._variances[own], self._variances[other])[both]
        sigma = max(self._noise, math.sqrt(float(np.median(said))))
        return float(np.median(far[both])), max(APART_M, _NOISES * sigma)

    def _judge(self, own: int, other: int, far: float, limit: float) -> Verdict | None:
        streak = self._streaks[own, other] + 1 if far > limit else 0
        self._streaks[own, other] = self._streaks[other, own] = streak
        if streak == 1:
            for one, its in ((own, other), (other, own)):
                self._onsets[one, its] = np.nanmedian(np.linalg.norm(self._off[one], axis=1))
        if streak < _IMAGES:
            return None
        worse = self._worse(own, other)
        self.believed[worse] = False
        self._streaks[worse], self._streaks[:, worse], self._again[worse] = 0, 0, 0
        return Verdict(worse, False, far)

    def _worse(self, one: int, other: int) -> int:
        votes = (self._streaks[[one, other]] >= _IMAGES - 1).sum(axis=1)  # a third one may be a little behind
        if votes[0] != votes[1]:
            return one if votes[0] > votes[1] else other
        first, second = self._onsets[one, other], self._onsets[other, one]
        clear = max(first, second) > _JUMPED * min(first, second)
        if not clear and self._fixed[one] != self._fixed[other]:
            return other if self._fixed[one] else one
        return one if first > second else other

    def _forgive(self, doubted: int, far: float, limit: float) -> Verdict | None:
        self._again[doubted] = self._again[doubted] + 1 if far < limit / 2 else 0
        if self._again[doubted] < _AGAIN:
            return None
        self.believed[doubted] = True
        return Verdict(doubted, True, far)

"""Which cameras are used: two cameras that see the same robots must agree on their places.

A camera that was knocked shows every robot elsewhere, by millimetres to centimetres. Two cameras are compared by the
robots that both see. They need not expose together: a robot's place in an image of one is compared with the arc between
its places in the two images of the other around it. Of two cameras that disagree one is not believed any more, until
they agree again for a while:

1. the one that disagrees with further cameras, too;
2. the one that jumped: in the first of those images it was the further one from where robots were expected;
3. the one without a floor tag in its view, by which the other one's tracker corrects what moved;
4. of two that moved apart slowly, the one that was a little further away.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.tracking.filter.estimator import COLUMNS
from robofleet.tracking.filter.joined import Seen
from robofleet.tracking.filter.parallax import Parallax

_VARIANCE_COLUMNS = [3, 5]  # of x and y
_KEPT_IMAGES = 8  # images of each camera: so much later than another's may one come
_NEAR_NS = 60_000_000  # from one image to the nearer of the two around it: beyond, a robot may have done anything
_STRAIGHT_RAD = 1e-6  # turned by less, an arc is straight
APART_M = 0.001  # two calibrated cameras agree to some tenths of a millimetre
_NOISES = 4.0  # standard deviations of a measurement, where these are more
_APART_IMAGES = 3  # in a row: a tag that something covers for a moment is off in fewer
_FORGIVEN_IMAGES = 30  # in a row, before a camera is used again: a second
_JUMP_RATIO = 2.0  # of the distances from the expectation


class Verdict(NamedTuple):
    """A camera that is not believed any more, or again."""

    camera: int
    believed: bool
    apart: float  # from the other [m]


class Agreement:
    """Told of every image, it says whom to believe. ``compared`` (N,): robots by which cameras are judged.

    ``noise``: standard deviation of a position at least, whatever its covariance says [m]. ``fixed`` (C,): cameras that
    see a floor tag. ``parallax`` takes what is compared: robots that two cameras see elsewhere may be higher than
    configured.
    """

    def __init__(
        self, compared: NDArray[np.bool_], noise: float, fixed: NDArray[np.bool_], parallax: Parallax | None = None
    ) -> None:
        cameras = len(fixed)
        self.believed = np.ones(cameras, np.bool_)
        self._compared, self._fixed = compared, fixed
        self._noise, self._parallax = noise, parallax
        self._images: list[deque[Seen]] = [deque(maxlen=_KEPT_IMAGES) for _ in range(cameras)]
        self._off = np.zeros(cameras)  # of the newest image: median distance from the expectation [m]
        self._until_ns = np.zeros((cameras, cameras), np.int64)  # the newest image by which two were compared
        self._streaks = np.zeros((cameras, cameras), np.int64)  # images in a row in which two were apart
        self._onsets = np.zeros((cameras, cameras))  # how far the first was from the expectation when that began
        self._again = np.zeros(cameras, np.int64)  # images in a row in which one that is not believed agreed

    def look(self, seen: Seen, expected: Array) -> Verdict | None:
        """Take an image, and the poses (N, 3) that were expected in it, NaN where none was; returns what changes."""
        own = seen.camera
        self._images[own].append(seen)
        off = np.linalg.norm(seen.poses[:, :2] - expected[:, :2], axis=1)[self._compared]
        self._off[own] = np.median(off[np.isfinite(off)]) if np.isfinite(off).any() else 0.0
        for other in range(len(self.believed)):
            if other == own or not (self.believed[own] or self.believed[other]):
                continue
            far, limit = self._apart(own, other)
            if np.isnan(far):
                continue
            if self.believed[own] and self.believed[other]:
                verdict = self._judge(own, other, far, limit)
            else:
                verdict = self._forgive(other if self.believed[own] else own, far, limit)
            if verdict is not None:
                return verdict
        return None

    def _apart(self, own: int, other: int) -> tuple[float, float]:
        """Return how far apart two cameras see robots, now that ``own`` has a new image, and how far they may [m].

        NaN: this image tells nothing new of the two.
        """
        mine, others = self._images[own], self._images[other]
        found = _around(mine[-1], list(others)) or (_around(others[-1], list(mine)[-2:]) if others else None)
        if found is None or found[0].exposed_ns <= self._until_ns[own, other]:
            return np.nan, np.nan
        image, before, after = found
        apart = image.poses[:, :2] - _on_the_way(before, after, image.instants_ns)
        far = np.linalg.norm(apart, axis=1)
        both = np.isfinite(far) & self._compared
        if not both.any():
            return np.nan, np.nan
        self._until_ns[own, other] = self._until_ns[other, own] = after.exposed_ns
        variances = np.max([_variance(sighted) for sighted in found], axis=0)
        if self._parallax is not None:
            doubled = 2.0 * np.where(variances > 0.0, variances, self._noise**2)
            self._parallax.add(image.camera, before.camera, image.poses[:, :2], apart, doubled)
        sigma = max(self._noise, math.sqrt(float(np.median(variances[both]))))
        return float(np.median(far[both])), max(APART_M, _NOISES * sigma)

    def _judge(self, own: int, other: int, far: float, limit: float) -> Verdict | None:
        streak = self._streaks[own, other] + 1 if far > limit else 0
        self._streaks[own, other] = self._streaks[other, own] = streak
        if streak == 1:
            self._onsets[own, other], self._onsets[other, own] = self._off[own], self._off[other]
        if streak < _APART_IMAGES:
            return None
        worse = self._worse(own, other)
        self.believed[worse] = False
        self._streaks[worse], self._streaks[:, worse], self._again[worse] = 0, 0, 0
        return Verdict(worse, False, far)

    def _worse(self, camera: int, other: int) -> int:
        votes = (self._streaks[[camera, other]] >= _APART_IMAGES - 1).sum(axis=1)  # a third one may be a little behind
        if votes[0] != votes[1]:
            return camera if votes[0] > votes[1] else other
        first, second = self._onsets[camera, other], self._onsets[other, camera]
        clear = max(first, second) > _JUMP_RATIO * min(first, second)
        if not clear and self._fixed[camera] != self._fixed[other]:
            return other if self._fixed[camera] else camera
        return camera if first > second else other

    def _forgive(self, doubted: int, far: float, limit: float) -> Verdict | None:
        self._again[doubted] = self._again[doubted] + 1 if far < limit / 2 else 0
        if self._again[doubted] < _FORGIVEN_IMAGES:
            return None
        self.believed[doubted] = True
        return Verdict(doubted, True, far)


def _around(image: Seen, others: list[Seen]) -> tuple[Seen, Seen, Seen] | None:
    """Return an image with those two of another camera that were exposed around it; None if there are none."""
    for before, after in zip(others[-2::-1], others[:0:-1], strict=True):
        since_ns, until_ns = image.exposed_ns - before.exposed_ns, after.exposed_ns - image.exposed_ns
        if since_ns > 0 and until_ns >= 0 and min(since_ns, until_ns) <= _NEAR_NS:
            return image, before, after
    return None


def _on_the_way(before: Seen, after: Seen, instants_ns: NDArray[np.int64]) -> Array:
    """Return where robots (N, 2) were at instants (N,), on the arcs from their places in one image to the next."""
    share = (instants_ns - before.instants_ns) / np.maximum(after.instants_ns - before.instants_ns, 1)
    (x, y, _), (dx, dy, turned) = before.poses[:, :3].T, (after.poses - before.poses)[:, :3].T
    turned = np.remainder(turned + math.pi, math.tau) - math.pi
    turned = 1j * np.where(np.abs(turned) > _STRAIGHT_RAD, turned, _STRAIGHT_RAD)  # also of those that were not seen
    at = x + 1j * y + (dx + 1j * dy) * (np.expm1(share * turned) / np.expm1(turned))
    return np.stack([at.real, at.imag], axis=1)


def _variance(seen: Seen) -> Array:
    """Return the variance of each position (N,), the mean of x and y [m^2]; 0: nobody knows it."""
    if seen.poses.shape[1] < COLUMNS:
        return np.zeros(len(seen.poses))
    variances: Array = seen.poses[:, _VARIANCE_COLUMNS].mean(axis=1)
    return variances

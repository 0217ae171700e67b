"""The images of several cameras, brought to the fleet filter in the order of their exposures.

Two cameras that are triggered together expose at one instant, and each has its own delay: of two images of one tick one
may come a tick later than the other. The filter takes nothing that is older than what it has taken. So it is brought
back to where it was before its newest images, and takes those again, the late one among them.

Each image is judged once, before the filter takes it: by where the robots were expected before its camera's image
before. So neither that camera nor one that exposes in between has moved the expectation.
"""

from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Instants
from robofleet.tracking.filter.estimator import UNUSED, FilterState, FleetFilter

_ONE_INSTANT_NS = 20_000_000  # between images of one instant: less than a tick
_LATEST_NS = 200_000_000  # that one camera may be behind another
_LEAST_BATCHES = 5  # or so many images, where these took longer
_UNSEEN = np.iinfo(np.int64).max


class Seen(NamedTuple):
    """What one image says of all robots."""

    camera: int
    poses: Array  # (N, 3), or (N, 9) with covariances, NaN where a robot was not measured
    instants_ns: Instants  # (N,) each robot's own mid-exposure; the image's where it was not measured

    @property
    def exposed_ns(self) -> int:
        """The first instant of the image."""
        return int(self.instants_ns.min())

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which robots (N,) it shows."""
        return np.isfinite(self.poses[:, 0])


# Of an image, and where it was expected to see the robots (N, 3): is it believed?
Judge = Callable[[Seen, Array], bool]


class Joined:
    """Hands images to a filter; ``observe`` takes those that came since its last call, and that ``judge`` believes."""

    def __init__(self, fleet_filter: FleetFilter, judge: Judge) -> None:
        self._filter, self._judge = fleet_filter, judge
        # The images that were taken last, those of one instant together, and the filter as it was before each.
        self._batches: deque[tuple[FilterState, list[Seen]]] = deque()

    def observe(self, images: list[Seen]) -> NDArray[np.int64]:
        """Use images; returns what ``FleetFilter.observe`` does, of all of them that are believed."""
        anew = list(images)
        while self._batches and any(map(self._late, images)):
            before, batch = self._batches.pop()
            self._filter.go_back(before)
            anew += batch
        used = np.full(len(self._filter.instants_ns), UNUSED)
        for batch in _together(anew):
            before = self._filter.memory()
            believed = [seen for seen in batch if self._judged(seen, images, before)]
            if believed:
                self._batches.append((before, believed))
                used = np.maximum(used, self._take(believed))
        while len(self._batches) > _LEAST_BATCHES and self._age_ns() > _LATEST_NS:
            self._batches.popleft()
        return used

    def _judged(self, seen: Seen, images: list[Seen], before: FilterState) -> bool:
        """Return whether an image is believed; one that is not among the new ``images`` was believed already."""
        if not any(seen is new for new in images):
            return True
        of_camera = (memory for memory, batch in reversed(self._batches) if any(s.camera == seen.camera for s in batch))
        since = next(of_camera, self._batches[0][0] if self._batches else before)
        return self._judge(seen, self._filter.expected(since, seen.instants_ns))

    def _age_ns(self) -> int:
        """Return for how long images are kept now."""
        (_, oldest), (_, newest) = self._batches[0], self._batches[-1]
        return newest[0].exposed_ns - oldest[0].exposed_ns

    def _late(self, seen: Seen) -> bool:
        """Return whether an image is older than the filter for some robot."""
        return bool((seen.measured & (seen.instants_ns <= self._filter.instants_ns)).any())

    def _take(self, images: list[Seen]) -> NDArray[np.int64]:
        """Let the filter take each robot's measurements one after the other, the oldest first."""
        poses = np.stack([seen.poses for seen in images])
        instants_ns = np.stack([seen.instants_ns for seen in images])
        measured = np.isfinite(poses[:, :, 0])
        order = np.argsort(np.where(measured, instants_ns, _UNSEEN), axis=0, kind="stable")
        newest_ns = instants_ns.max(axis=0)
        poses, measured = np.take_along_axis(poses, order[..., None], 0), np.take_along_axis(measured, order, 0)
        instants_ns = np.take_along_axis(instants_ns, order, 0)
        used, before_ns = np.full(len(newest_ns), UNUSED), np.zeros_like(newest_ns)
        for k in range(max(1, int(measured.sum(axis=0).max()))):
            # At one instant the second comes a nanosecond later; who is not seen at all is moved on.
            at_ns = np.where(measured[k], np.maximum(instants_ns[k], before_ns + 1), 0 if k else newest_ns)
            used = np.maximum(used, self._filter.observe(at_ns, poses[k]))
            before_ns = at_ns
        return used


def _together(images: list[Seen]) -> Iterator[list[Seen]]:
    """Yield images that were exposed at about one instant, the oldest first."""
    batch: list[Seen] = []
    for seen in sorted(images, key=lambda seen: seen.exposed_ns):
        if batch and seen.exposed_ns - batch[0].exposed_ns > _ONE_INSTANT_NS:
            yield batch
            batch = []
        batch.append(seen)
    if batch:
        yield batch

"""The true world, as the simulated drivers publish it."""

import math
from bisect import bisect_right
from collections import deque

from robofleet.vehicles.differential_drive import arc

_BEYOND_NS = 100_000_000  # after the newest sample a robot is taken to have gone on; then its driver is gone

Pose = tuple[float, float, float]


class TruthHistory:
    """The newest true samples of one robot: where it was at any instant among them, and a little beyond.

    Between two samples the robot moved along the arc of the earlier one's body velocity, corrected so that it
    ends where the later one is.
    """

    def __init__(self, capacity: int) -> None:
        self._stamps: deque[int] = deque(maxlen=capacity)
        self._samples: deque[tuple[float, float, float, float, float]] = deque(maxlen=capacity)

    def add(self, stamp_ns: int, x: float, y: float, psi: float, v: float, omega: float) -> None:
        """Add a sample [ns; m, rad in the world; m/s, rad/s of the body]; ignored if not the newest."""
        if not self._stamps or stamp_ns > self._stamps[-1]:
            self._stamps.append(stamp_ns)
            self._samples.append((x, y, psi, v, omega))

    def told_at(self, stamp_ns: int) -> bool:
        """Return whether the robot's place at an instant is known from its own word, not from what it said long ago."""
        return bool(self._stamps) and stamp_ns - self._stamps[-1] <= _BEYOND_NS

    def pose_at(self, stamp_ns: int) -> Pose | None:
        """Return x, y [m], psi [rad] at an instant; the first sample's before it; None without any sample."""
        if not self._stamps:
            return None
        k = bisect_right(self._stamps, stamp_ns) - 1
        if k < 0:
            return self._samples[0][:3]
        elapsed_s = min(stamp_ns - self._stamps[k], _BEYOND_NS) * 1e-9
        pose = arc(*self._samples[k], elapsed_s)
        if k + 1 == len(self._stamps):
            return pose
        step_s = (self._stamps[k + 1] - self._stamps[k]) * 1e-9
        end, target = arc(*self._samples[k], step_s), self._samples[k + 1]
        share = (elapsed_s / step_s) ** 2  # the velocity changed evenly over the step
        turned = math.remainder(target[2] - end[2], math.tau)
        return (
            pose[0] + share * (target[0] - end[0]),
            pose[1] + share * (target[1] - end[1]),
            math.remainder(pose[2] + share * turned, math.tau),
        )

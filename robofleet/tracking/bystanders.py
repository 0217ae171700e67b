"""Where the robots stand that nobody drives: as they were seen last, moved on for a moment where a hand pushes them.

The fleet's filter believes that a robot moves by its commands; of these there are none, so nothing is assumed of them.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

_SMOOTHED_S = 0.1  # time constant of the velocity: noise of 0.4 mm then makes 4 mm/s


class Bystanders:
    """Poses (N, 3): x, y [m], psi [rad], and velocities (N, 2) [m/s] in the world frame.

    ``jump`` (N,): one that is seen so far from where it was [m] was carried there, and stands.
    ``longest`` [s]: one that is not seen is moved on for no longer.
    """

    def __init__(self, jump: Array, longest: float) -> None:
        n = len(jump)
        self._jump, self._longest = jump, longest
        self._poses = np.zeros((n, 3))
        self.velocities = np.zeros((n, 2))
        self.measured_ns = np.zeros(n, dtype=np.int64)  # newest pose; 0: never seen

    def observe(self, instants_ns: Instants, poses: Array) -> None:
        """Use an image: ``poses`` (N, 3), NaN where one was not seen, each at its own mid-exposure (N,)."""
        for row in np.flatnonzero(np.isfinite(poses).all(axis=1) & (instants_ns > self.measured_ns)).tolist():
            duration = (instants_ns[row] - self.measured_ns[row]) * 1e-9
            moved = poses[row, :2] - self._poses[row, :2]
            if self.measured_ns[row] and math.hypot(*moved) <= self._jump[row]:
                share = 1.0 - math.exp(-duration / _SMOOTHED_S)
                self.velocities[row] += share * (moved / duration - self.velocities[row])
            else:
                self.velocities[row] = 0.0
            self._poses[row] = poses[row]
            self.measured_ns[row] = instants_ns[row]

    def predict(self, instant_ns: int) -> Array:
        """Return the poses (N, 3) at an instant."""
        predicted = self._poses.copy()
        after = np.clip((instant_ns - self.measured_ns) * 1e-9, 0.0, self._longest)
        predicted[:, :2] += self.velocities * after[:, None]
        return predicted

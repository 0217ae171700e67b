"""Eq. 31 for many points at once: u' = (alpha / T) (r(t + T) - p - T (u + w)), a point that moves with u + w.

w is what the point does beyond what was asked, as estimated: with it in the prediction no offset is left where w is
constant (``platoon.py`` says why); with w = 0 it is the paper's law.
"""

import numpy as np

from robofleet.control.flow import Integrator, integrator_gain
from robofleet.core.arrays import Array, Flags


class PointFlow:
    """The Newton-Raphson flow of N points. Its state is u (N, 2), their velocities [m/s; world]."""

    def __init__(self, n: int, alpha: float, horizon: float, step: float, integrator: Integrator) -> None:
        """Start at rest. alpha [1/s], horizon T [s], control step [s]."""
        self.u = np.zeros((n, 2))
        self._horizon, self._gain = horizon, integrator_gain(alpha, step, integrator)

    def update(self, points: Array, references: Array, driving: Flags, w: Array) -> tuple[Array, Array]:
        """Return u (N, 2) after one control step, and |r - g| (N,) before it [m].

        points p (N, 2) now, references r(t + T) (N, 2) [m]; w (N, 2) [m/s]. Who may not drive has u = 0.
        """
        missing = references - points - self._horizon * (self.u + w)
        self.u = np.where(driving[:, None], self.u + self._gain / self._horizon * missing, 0.0)
        return self.u.copy(), np.hypot(missing[:, 0], missing[:, 1])

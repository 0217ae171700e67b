"""Where robots are by their wheels alone, and how that lies in the world: REP 105's odom and map.

A pose is (x, y, psi): [m, m, rad]. ``odom`` begins where the robot stood when it was first heard. It has no jumps, and
drifts. ``map`` -> ``odom`` is what the tracker knows better.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]
_REMEMBERED_STATUSES = 64  # a pose is measured less than a second before it comes


def wrapped(angles: Array) -> Array:
    """Return angles in (-pi, pi]."""
    turned: Array = np.pi - (np.pi - angles) % (2.0 * np.pi)
    return turned


class Odometry:
    """The odometry of some robots (N,) that tell together."""

    def __init__(self, drives: Sequence[DifferentialDrive]) -> None:
        n = len(drives)
        self._radius = np.array([drive.wheel_radius for drive in drives])
        self._base = np.array([drive.wheel_base for drive in drives])
        self.poses = np.zeros((n, 3))  # in the odom frames
        self.twists = np.zeros((n, 2))  # v [m/s], omega [rad/s], as measured
        self.corrections = np.zeros((n, 3))  # map -> odom
        self.corrected = np.zeros(n, np.bool_)  # whose place in the map is known
        self._angles: Array | None = None
        self._boot = 0
        self._at_ns = np.zeros(_REMEMBERED_STATUSES, np.int64)
        self._past = np.zeros((_REMEMBERED_STATUSES, n, 3))
        self._count = 0

    def turned(self, at_ns: int, boot_id: int, angles: Array, speeds: Array) -> None:
        """Take the wheels' angles [rad] and speeds [rad/s] (N, 2), left and right, of an instant.

        Angles of another boot begin anew: what the wheels turned in between is not known.
        """
        if self._angles is not None and boot_id == self._boot:
            left, right = ((angles - self._angles) * self._radius[:, None]).T
            way, turn = (left + right) / 2.0, (right - left) / self._base
            chord = way * np.sinc(turn / (2.0 * np.pi))  # of an arc
            heading = self.poses[:, 2] + turn / 2.0
            self.poses[:, 0] += chord * np.cos(heading)
            self.poses[:, 1] += chord * np.sin(heading)
            self.poses[:, 2] = wrapped(self.poses[:, 2] + turn)
        self._angles, self._boot = angles.copy(), boot_id
        left, right = (speeds * self._radius[:, None]).T
        self.twists[:, 0], self.twists[:, 1] = (left + right) / 2.0, (right - left) / self._base
        row = self._count % _REMEMBERED_STATUSES
        self._at_ns[row], self._past[row] = at_ns, self.poses
        self._count += 1

    def seen(self, robot: int, at_ns: int, pose: Array) -> None:
        """Take the pose (3,) of a robot in the map at an instant that is not long ago."""
        if self._count:
            x, y, psi = self._then(robot, at_ns)
            turn = pose[2] - psi
            cos, sin = math.cos(turn), math.sin(turn)
            position = pose[0] - cos * x + sin * y, pose[1] - sin * x - cos * y
            self.corrections[robot] = *position, math.remainder(turn, math.tau)
            self.corrected[robot] = True

    def _then(self, robot: int, at_ns: int) -> list[float]:
        """Return where a robot was in its odom frame: between two instants on a line."""
        known = min(self._count, _REMEMBERED_STATUSES)
        order = (np.arange(known) + self._count - known) % _REMEMBERED_STATUSES
        instants, (x, y, psi) = self._at_ns[order], self._past[order, robot].T
        since_first_ns = float(at_ns - int(instants[0]))  # an instant that a message names may be any number
        return [float(np.interp(since_first_ns, instants - instants[0], each)) for each in (x, y, np.unwrap(psi))]

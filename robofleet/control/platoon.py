"""Algorithm 1: the platoon. The leader follows r(gamma t); every other robot its predecessor's predicted point.

Decentralised: robot i uses the path and its predecessor's prediction x + T u alone. Robots are updated in platoon
order, so that a prediction holds the newest u; and u is what the wheels can do, so that a robot that cannot move is
not predicted to move.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from robofleet.control import path as paths
from robofleet.control.flow import integrator_gain, point_update
from robofleet.control.path import Path
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]

_body_from_point = njit(cache=True)(differential_drive.body_from_point)
_point_from_pose = njit(cache=True)(differential_drive.point_from_pose)
_wheels_from_body = njit(cache=True)(differential_drive.wheels_from_body)
_feasible_ratio = njit(cache=True)(differential_drive.feasible_ratio)


@dataclass(frozen=True)
class PlatoonSettings:
    """Parameters of the law, named as in the paper."""

    alpha: float  # speed-up [1/s]
    horizon: float  # T [s]
    point_ahead: float  # l [m]
    spacing: float  # d [m]
    path_rate: float  # gamma [sides/s]
    tick: float  # control step [s]
    integrator: Literal["exact", "euler"]
    track: Literal["point", "centre"]  # what follows the path


@dataclass
class Decisions:
    """What one tick decided, one row a robot."""

    point: Array  # x: the point p (N, 2) [m]
    reference: Array  # rho at the horizon (N, 2) [m]
    control_error: Array  # |rho - (x + T u)| before the update (N,) [m]
    wheels: Array  # left, right (N, 2) [rad/s]
    saturated: Array  # 1 where the wheels could not do all of it (N,)


@dataclass
class Platoon:
    """The platoon's law and its state: u (N, 2) [m/s], and where each robot is along the path."""

    path: Path
    settings: PlatoonSettings
    vehicles: tuple[DifferentialDrive, ...]
    u: Array = field(init=False)
    reference_parameter: Array = field(init=False)  # (N,) of rho; NaN: none yet
    _nearest_parameter: Array = field(init=False)  # (N,) of q; NaN: search the whole path

    def __post_init__(self) -> None:
        """Start at rest."""
        n = len(self.vehicles)
        self.u, self.reference_parameter, self._nearest_parameter = np.empty((n, 2)), np.empty(n), np.empty(n)
        self.restart()
        self._limits = np.array(
            [(v.wheel_radius, v.wheel_base, v.max_wheel_speed, v.max_speed) for v in self.vehicles]
        )
        s = self.settings
        self._gain = integrator_gain(s.alpha, s.tick, s.integrator)
        self._offset = s.point_ahead if s.track == "centre" else 0.0

    def restart(self) -> None:
        """Begin a new run: at rest, and with no reference yet."""
        self.u[:] = 0.0
        self.reference_parameter[:] = np.nan
        self._nearest_parameter[:] = np.nan

    def carried(self, robot: int) -> None:
        """Forget where a robot was along the path: it was put somewhere else."""
        self._nearest_parameter[robot] = np.nan

    def tick(self, t: float, poses: Array, driving: Array) -> Decisions:
        """Return the wheel speeds of all robots for the next tick.

        t: time since the start at the moment when the commands act [s]. poses (N, 3): x, y [m], psi [rad] of the
        centres at that moment. driving (N,): false where a robot must stand still (its u becomes 0).
        """
        n, s = len(poses), self.settings
        decisions = Decisions(
            np.empty((n, 2)), np.empty((n, 2)), np.empty(n), np.zeros((n, 2)), np.zeros(n)
        )
        _tick(
            self.path.coefficients,
            s.path_rate * (t + s.horizon),
            s.spacing,
            s.horizon,
            s.point_ahead,
            self._offset,
            self._gain,
            self._limits,
            poses,
            driving,
            self.u,
            self._nearest_parameter,
            self.reference_parameter,
            decisions.point,
            decisions.reference,
            decisions.control_error,
            decisions.wheels,
            decisions.saturated,
        )
        return decisions


@njit(cache=True)
def _follow(
    coefficients: Array, i: int, T: float, offset: float, d: float,
    poses: Array, points: Array, u: Array, nearest: Array, reference: Array,
) -> float:  # fmt: skip
    """Return the parameter of rho_i from the predecessor's predicted point (Algorithm 1); it never retreats."""
    sides = len(coefficients)
    j = i - 1
    x = points[j, 0] + T * u[j, 0] - offset * np.cos(poses[j, 2])
    y = points[j, 1] + T * u[j, 1] - offset * np.sin(poses[j, 2])
    q = paths.nearest(coefficients, x, y, nearest[j])
    nearest[j] = q
    tau = paths.back(coefficients, q, d)
    before = reference[i]
    if np.isnan(before):
        return tau
    advance = (tau - before + sides / 2) % sides - sides / 2
    return tau if advance > 0.0 else before


@njit(cache=True)
def _tick(
    coefficients: Array, leader: float, d: float, T: float, l: float, offset: float, gain: float, limits: Array,
    poses: Array, driving: Array, u: Array, nearest: Array, reference: Array,
    points: Array, rho: Array, error: Array, wheels: Array, saturated: Array,
) -> None:  # fmt: skip
    for i in range(len(poses)):
        psi = poses[i, 2]
        points[i] = _point_from_pose(poses[i, 0], poses[i, 1], psi, l)
        if i == 0:
            reference[i] = leader % len(coefficients)
        else:
            reference[i] = _follow(coefficients, i, T, offset, d, poses, points, u, nearest, reference)
        rho[i] = paths.point(coefficients, reference[i])
        if offset != 0.0:
            tangent_x, tangent_y = paths.unit_tangent(coefficients, reference[i])
            rho[i, 0] += offset * tangent_x
            rho[i, 1] += offset * tangent_y
        error[i] = np.hypot(rho[i, 0] - points[i, 0] - T * u[i, 0], rho[i, 1] - points[i, 1] - T * u[i, 1])
        if not driving[i]:
            u[i] = 0.0
            continue
        u_x = point_update(u[i, 0], points[i, 0], rho[i, 0], T, gain)
        u_y = point_update(u[i, 1], points[i, 1], rho[i, 1], T, gain)
        radius, base, max_wheel_speed, max_speed = limits[i]
        v, omega = _body_from_point(u_x, u_y, psi, l)
        left, right = _wheels_from_body(v, omega, radius, base)
        ratio = _feasible_ratio(left, right, radius, max_wheel_speed, max_speed)
        u[i] = ratio * u_x, ratio * u_y
        wheels[i] = ratio * left, ratio * right
        saturated[i] = ratio < 1.0

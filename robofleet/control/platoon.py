"""Algorithm 1: the platoon. The leader follows r(gamma t); every other robot its predecessor's predicted point.

Decentralised: robot i uses the path and its predecessor's prediction x + T u alone. Robots are updated in platoon
order, so that a prediction holds the newest u; and u is what the wheels can do, so that a robot that cannot move is
not predicted to move.

Offset-free (this project's extension). A velocity disturbance w (a worn wheel, slip, a dead band) makes x' = u + w,
and eq. 31, which predicts x + T u, then comes to rest with rho - x = T u while x really moves by T (u + w): the point
is T w off. With an estimate w^ in the prediction, u' = (alpha/T) (rho - x - T (u + w^)). Put z = u + w: where w is
constant and w^ = w, z' = (alpha/T) (rho - x - T z) and x' = z, which is the undisturbed loop: no offset is left, and
its poles are the same. Otherwise e = w - w^ enters that loop as an input, and e obeys the filter alone, which is
driven by the commands and the images whatever the law does: the poles are the loop's and the filter's together, so
the loop is stable where both are. u stays what the wheels were asked for, so that its limits bind where they are.
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np

from robofleet.control import path as paths
from robofleet.control.flow import integrator_gain, point_update
from robofleet.control.path import Path
from robofleet.control.wheels import body_from_point, feasible_ratio, limits, point_from_pose, wheels_from_body
from robofleet.core.arrays import Array, Flags
from robofleet.core.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive


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


class Column(IntEnum):
    """Columns of what a tick decides, one row a robot."""

    U_X = 0  # the input after the update [m/s]: what the wheels cannot do of it is still in it
    U_Y = 1
    REFERENCE_X = 2  # rho at the horizon [m]
    REFERENCE_Y = 3
    REFERENCE_PARAMETER = 4  # of rho on the path
    CONTROL_ERROR = 5  # |rho - (x + T (u + w))| before the update [m]; w: the estimated disturbance, else 0
    PATH_ERROR = 6  # of p, to the path [m]
    SPACING = 7  # of p, to the predecessor's [m]; NaN: it has none


INPUTS = slice(Column.U_X, Column.U_Y + 1)
REFERENCES = slice(Column.REFERENCE_X, Column.REFERENCE_Y + 1)
_COLUMNS = len(Column)


@dataclass
class PlatoonLaw:
    """The platoon's law and its state: u (N, 2) [m/s], and where each robot is along the path."""

    path: Path
    settings: PlatoonSettings
    vehicles: tuple[DifferentialDrive, ...]
    u: Array = field(init=False)
    reference_parameter: Array = field(init=False)  # (N,) of rho; NaN: none yet
    _nearest_parameter: Array = field(init=False)  # (N,) of q; NaN: search the whole path
    _along: Array = field(init=False)  # (N,) of the point of the path that is nearest to p; NaN: search the whole path

    def __post_init__(self) -> None:
        n = len(self.vehicles)
        self.u, self.reference_parameter = np.empty((n, 2)), np.empty(n)
        self._nearest_parameter, self._along = np.empty(n), np.empty(n)
        self.restart()
        self._limits = limits(self.vehicles)
        s = self.settings
        self._gain = integrator_gain(s.alpha, s.tick, s.integrator)
        self._offset = s.point_ahead if s.track == "centre" else 0.0

    def restart(self) -> None:
        """Begin a new run: at rest, and with no reference yet."""
        self.u[:] = 0.0
        self.reference_parameter[:] = np.nan
        self._nearest_parameter[:] = np.nan
        self._along[:] = np.nan
        self._origin = math.nan  # the leader's parameter at t = 0

    def carried(self, robot: int) -> None:
        """Forget where a robot was along the path: it was put somewhere else."""
        self._nearest_parameter[robot] = np.nan
        self._along[robot] = np.nan

    def changed(self, u: Array) -> None:
        """Remember what the robots are asked for instead: u (N, 2) [m/s]."""
        self.u[:] = u

    def tick(self, t: float, poses: Array, driving: Flags, disturbance: Array | None = None) -> Array:
        """Return what all robots do in the next tick: (N, 8), columns as in :class:`Column`.

        t: time since the start at the moment when the commands act [s]. poses (N, 3): x, y [m], psi [rad] of the
        centres at that moment. driving (N,): false where a robot must stand still (its u becomes 0).
        disturbance (N, 2): w, the points' velocity beyond u as estimated [m/s; world]; None takes it as 0.
        """
        s = self.settings
        if math.isnan(self._origin):
            self._origin = self._beginning(t, poses[0])
        decisions = np.empty((len(poses), _COLUMNS))
        _tick(
            self.path.coefficients,
            self._origin + s.path_rate * (t + s.horizon),
            s.spacing,
            s.horizon,
            s.point_ahead,
            self._offset,
            self._gain,
            self._limits,
            poses,
            driving,
            np.zeros((len(poses), 2)) if disturbance is None else disturbance,
            self.u,
            self._nearest_parameter,
            self.reference_parameter,
            self._along,
            decisions,
        )
        return decisions

    def _beginning(self, t: float, leader: Array) -> float:
        """Return the parameter from which a run counts: 0, or what lets it go on where the leader is on its lap.

        A leader that was stopped there must not turn round to the path's beginning, through those who follow it.
        """
        ahead = self.settings.point_ahead if self._offset == 0.0 else 0.0
        x, y = differential_drive.point_from_pose(leader[0], leader[1], leader[2], ahead)
        start_x, start_y = paths.point(self.path.coefficients, 0.0)
        if not np.hypot(x - start_x, y - start_y) > self.settings.spacing / 2.0:
            return 0.0
        return float(paths.nearest(self.path.coefficients, x, y, np.nan)) - self.settings.path_rate * t


@kernel
def follow(
    coefficients: Array, predicted_x: float, predicted_y: float, d: float, near: float, before: float
) -> tuple[float, float]:
    """Algorithm 1: return the parameters of q, nearest to the predecessor's predicted point, and of rho, d behind it.

    rho does not retreat behind ``before``, where it was in the last tick (NaN: nowhere).
    """
    sides = len(coefficients)
    q = paths.nearest(coefficients, predicted_x, predicted_y, near)
    tau = paths.back(coefficients, q, d)
    if np.isnan(before):
        return q, tau
    advance = (tau - before + sides / 2) % sides - sides / 2
    return q, tau if advance > 0.0 else before


@kernel
def _tick(
    coefficients: Array, leader: float, d: float, T: float, l: float, offset: float, gain: float, limits: Array,
    poses: Array, driving: Flags, w: Array, u: Array, nearest: Array, reference: Array, along: Array,
    decisions: Array,
) -> None:  # fmt: skip
    predicted_x, predicted_y = np.nan, np.nan  # of the robot before
    before_x, before_y = np.nan, np.nan  # its p
    for i in range(len(poses)):
        psi = poses[i, 2]
        x, y = point_from_pose(poses[i, 0], poses[i, 1], psi, l)
        if i == 0:
            reference[i] = leader % len(coefficients)
        else:
            nearest[i - 1], reference[i] = follow(
                coefficients, predicted_x, predicted_y, d, nearest[i - 1], reference[i]
            )
        rho_x, rho_y = paths.point(coefficients, reference[i])
        if offset != 0.0:  # p is l ahead of the centre, which is what follows the path
            tangent_x, tangent_y = paths.unit_tangent(coefficients, reference[i])
            rho_x, rho_y = rho_x + offset * tangent_x, rho_y + offset * tangent_y
        drifted_x, drifted_y = x + T * w[i, 0], y + T * w[i, 1]
        error = np.hypot(rho_x - drifted_x - T * u[i, 0], rho_y - drifted_y - T * u[i, 1])
        u_x, u_y, ratio = 0.0, 0.0, 1.0
        if driving[i]:
            u_x = point_update(u[i, 0], drifted_x, rho_x, T, gain)
            u_y = point_update(u[i, 1], drifted_y, rho_y, T, gain)
            radius, base, max_wheel_speed, max_speed = limits[i, 0], limits[i, 1], limits[i, 2], limits[i, 3]
            v, omega = body_from_point(u_x, u_y, psi, l)
            left, right = wheels_from_body(v, omega, radius, base)
            ratio = feasible_ratio(left, right, radius, max_wheel_speed, max_speed)
        u[i, 0], u[i, 1] = ratio * u_x, ratio * u_y
        predicted_x = drifted_x + T * u[i, 0] - offset * np.cos(psi)
        predicted_y = drifted_y + T * u[i, 1] - offset * np.sin(psi)
        row = decisions[i]  # columns as in Column; number by number, as an assignment of a tuple compiles slowly
        row[0], row[1], row[2], row[3], row[4], row[5] = u_x, u_y, rho_x, rho_y, reference[i], error
        along[i] = paths.nearest(coefficients, x, y, along[i])
        path_x, path_y = paths.point(coefficients, along[i])
        row[6], row[7] = np.hypot(x - path_x, y - path_y), np.hypot(x - before_x, y - before_y)
        before_x, before_y = x, y


def rehearse(drive: DifferentialDrive) -> None:
    """Call every kernel of the law once: numba compiles them then, or loads them from disk."""
    knots = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    circle = Path.hermite(knots, np.roll(knots, -1, 0))
    law = PlatoonLaw(circle, PlatoonSettings(1.0, 0.5, 0.1, 0.1, 0.1, 0.03, "exact", "point"), (drive, drive))
    law.tick(0.0, np.full((2, 3), 0.5), np.ones(2, dtype=np.bool_))


KERNELS = (_tick, *paths.KERNELS)  # that are called from Python

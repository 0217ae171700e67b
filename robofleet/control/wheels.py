"""From what robots are to do to what their wheels can do, for all robots at once."""

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]

_body_from_point = kernel(differential_drive.body_from_point)
_point_from_pose = kernel(differential_drive.point_from_pose)
_wheels_from_body = kernel(differential_drive.wheels_from_body)
_feasible_ratio = kernel(differential_drive.feasible_ratio)


def limits(drives: tuple[DifferentialDrive, ...]) -> Array:
    """Return what ``commanded`` must know of each robot: (N, 4)."""
    return np.array([(d.wheel_radius, d.wheel_base, d.max_wheel_speed, d.max_speed) for d in drives]).reshape(-1, 4)


@kernel
def commanded(
    velocities: Array, of_body: NDArray[np.bool_], poses: Array, l: float, geometry: Array, driving: NDArray[np.bool_],
    u: Array, wheels: Array, saturated: Array, points: Array,
) -> None:  # fmt: skip
    """Write what each robot is asked for: ``u`` (N, 2), ``wheels`` (N, 2) [rad/s], and whether they were limited (N,).

    velocities (N, 2): of the points ``l`` [m] ahead [m/s; world], or where ``of_body`` v [m/s] and omega [rad/s].
    poses (N, 3): x, y [m], psi [rad] of the centres; ``points`` (N, 2) become the points ahead. A robot whose wheels
    cannot do all of it does a part: both wheels are slowed by one ratio, and so is
    ``u``, the velocity of its point [m/s; world]. A robot that may not drive stands.
    """
    for i in range(len(u)):
        psi = poses[i, 2]
        points[i, 0], points[i, 1] = _point_from_pose(poses[i, 0], poses[i, 1], psi, l)
        u[i, 0], u[i, 1], wheels[i, 0], wheels[i, 1], saturated[i] = 0.0, 0.0, 0.0, 0.0, 0.0
        if not driving[i]:
            continue
        u_x, u_y = velocities[i, 0], velocities[i, 1]
        if of_body[i]:
            v, omega = u_x, u_y
            c, s = np.cos(psi), np.sin(psi)
            u_x, u_y = c * v - s * l * omega, s * v + c * l * omega
        else:
            v, omega = _body_from_point(u_x, u_y, psi, l)
        left, right = _wheels_from_body(v, omega, geometry[i, 0], geometry[i, 1])
        ratio = _feasible_ratio(left, right, geometry[i, 0], geometry[i, 2], geometry[i, 3])
        wheels[i, 0], wheels[i, 1] = ratio * left, ratio * right
        u[i, 0], u[i, 1] = ratio * u_x, ratio * u_y
        saturated[i] = 1.0 if ratio < 1.0 else 0.0


KERNELS = (commanded,)  # that are called from Python

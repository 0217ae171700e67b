"""From commanded velocities to feasible wheel speeds, for all robots at once."""

from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array, Flags
from robofleet.core.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive

body_from_point = kernel(differential_drive.body_from_point)
point_from_pose = kernel(differential_drive.point_from_pose)
wheels_from_body = kernel(differential_drive.wheels_from_body)
feasible_ratio = kernel(differential_drive.feasible_ratio)


class Request(NamedTuple):
    """What robots are asked for, as far as their wheels can do it."""

    points: Array  # (N, 2) the points ahead when the commands act [m; world]
    u: Array  # (N, 2) their velocities [m/s; world]
    wheels: Array  # (N, 2) [rad/s]
    saturated: Array  # (N,) 1 where the wheels cannot do all of it


def limits(drives: tuple[DifferentialDrive, ...]) -> Array:
    """Return what ``limited`` must know of each robot: (N, 4)."""
    return np.array([(d.wheel_radius, d.wheel_base, d.max_wheel_speed, d.max_speed) for d in drives]).reshape(-1, 4)


def limited(velocities: Array, of_body: Flags, poses: Array, l: float, geometry: Array, driving: Flags) -> Request:
    """Return what each of N robots is asked for, within the limits of its wheels.

    velocities (N, 2): of the points ``l`` [m] ahead [m/s; world], or where ``of_body`` v [m/s] and omega [rad/s].
    poses (M >= N, 3): x, y [m], psi [rad] of the centres when the commands act, the N robots first. A robot whose
    wheels cannot do all of it does a part: both wheels and ``u`` are slowed by one ratio. A robot that may not drive
    stands.
    """
    n = len(velocities)
    request = Request(np.empty((n, 2)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n))
    limit_commands(velocities, of_body, poses, l, geometry, driving, *request)  # arrays that a kernel returns cost more
    return request


@kernel
def limit_commands(
    velocities: Array, of_body: Flags, poses: Array, l: float, geometry: Array, driving: Flags,
    points: Array, u: Array, wheels: Array, saturated: Array,
) -> None:  # fmt: skip
    for i in range(len(velocities)):
        psi = poses[i, 2]
        points[i, 0], points[i, 1] = point_from_pose(poses[i, 0], poses[i, 1], psi, l)
        if not driving[i]:
            continue
        u_x, u_y = velocities[i, 0], velocities[i, 1]
        if of_body[i]:
            v, omega = u_x, u_y
            c, s = np.cos(psi), np.sin(psi)
            u_x, u_y = c * v - s * l * omega, s * v + c * l * omega
        else:
            v, omega = body_from_point(u_x, u_y, psi, l)
        left, right = wheels_from_body(v, omega, geometry[i, 0], geometry[i, 1])
        ratio = feasible_ratio(left, right, geometry[i, 0], geometry[i, 2], geometry[i, 3])
        wheels[i, 0], wheels[i, 1] = ratio * left, ratio * right
        u[i, 0], u[i, 1] = ratio * u_x, ratio * u_y
        saturated[i] = 1.0 if ratio < 1.0 else 0.0


KERNELS = (limit_commands,)  # that are called from Python

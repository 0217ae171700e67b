"""Differential drive: wheels, body, and a point ahead of the axle. Scalars only, so that numba can compile them.

``left, right``: wheel speeds [rad/s; forward +]. ``v`` [m/s; forward +], ``omega`` [rad/s; CCW +]: body velocity.
``psi``: heading [rad; world frame, CCW +]. ``l``: distance of the point p ahead of the axle's middle [m].
"""

import math
from dataclasses import dataclass

WHOLE = 1.5 * 2.0**52  # a float beside it is a whole number
_INSIDE = 1.0 - 1e-9  # a scaled wheel stays inside its limit whatever is rounded later


@dataclass(frozen=True)
class DifferentialDrive:
    """What the controller assumes of a robot.

    Attributes:
        wheel_radius: Radius of the wheels [m].
        wheel_base: Distance between the wheels [m].
        max_wheel_speed: The fastest speed of a wheel [rad/s].
        max_speed: The fastest speed of the body [m/s].
        motor_lag: Time constant of the wheel-speed loop [s].
        max_wheel_acceleration: The greatest acceleration that the gate asks of a wheel [rad/s^2].
    """

    wheel_radius: float
    wheel_base: float
    max_wheel_speed: float
    max_speed: float
    motor_lag: float
    max_wheel_acceleration: float


def body_from_wheels(left: float, right: float, radius: float, base: float) -> tuple[float, float]:
    """Return (v, omega)."""
    return radius * (right + left) / 2.0, radius * (right - left) / base


def wheels_from_body(v: float, omega: float, radius: float, base: float) -> tuple[float, float]:
    """Return (left, right)."""
    return (v - omega * base / 2.0) / radius, (v + omega * base / 2.0) / radius


def body_from_point(u_x: float, u_y: float, psi: float, l: float) -> tuple[float, float]:
    """Return the (v, omega) that move p with velocity u [m/s; world frame] (eq. 28)."""
    c, s = math.cos(psi), math.sin(psi)
    return c * u_x + s * u_y, (c * u_y - s * u_x) / l


def point_from_pose(x: float, y: float, psi: float, l: float) -> tuple[float, float]:
    """Return the point p, l ahead of the axle's middle [m; world frame]."""
    return x + l * math.cos(psi), y + l * math.sin(psi)


def feasible_ratio(left: float, right: float, radius: float, max_wheel_speed: float, max_speed: float) -> float:
    """Return the one ratio <= 1 for both wheels that keeps wheel and body limits and the path of the motion."""
    fastest = max(abs(left), abs(right)) / max_wheel_speed
    fastest = max(fastest, radius * abs(left + right) / 2.0 / max_speed)
    return 1.0 if fastest <= _INSIDE else _INSIDE / fastest


def arc(x: float, y: float, psi: float, v: float, omega: float, duration: float) -> tuple[float, float, float]:
    """Return the pose after ``duration`` [s] of constant body velocity: an exact arc; psi in (-pi, pi]."""
    half = omega * duration / 2.0
    return end_of_arc(x, y, psi, v * duration, half, math.sin(half), math.sin(psi + half), math.cos(psi + half))


def end_of_arc(
    x: float, y: float, psi: float, way: float, half: float, sin_half: float, s: float, c: float
) -> tuple[float, float, float]:
    """Return the pose at the end of an arc of a length, of ``half`` its turn; s, c: of the chord's direction."""
    chord = way * (1.0 - half * half / 6.0 if abs(half) < 1e-4 else sin_half / half)
    psi += 2.0 * half
    if psi > math.pi or psi <= -math.pi:
        psi += math.tau * floor((math.pi - psi) / math.tau)
    return x + chord * c, y + chord * s, psi


def floor(x: float) -> float:
    """Return the whole number not above x, as a float: vector instructions do not make integers of floats."""
    rounded = (x + WHOLE) - WHOLE
    return rounded - 1.0 if rounded > x else rounded

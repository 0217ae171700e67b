"""Dynamic bicycle with linear tyres (eqs 16-22), for numba to compile.

State x (6,): z1, z2 position of the centre of gravity [m; world], v_l, v_n longitudinal and lateral velocity
[m/s; body, forward and left +], psi heading [rad; CCW +], psi_dot yaw rate [rad/s]. Input u (2,): a_l longitudinal
acceleration [m/s^2], delta_f steering angle of the front wheel [rad; left +]. Holds for v_l > 0.

``p`` is :meth:`BicycleParameters.numbers`: six floats, so that one compiled function serves every vehicle.
"""

import math
from dataclasses import astuple, dataclass

import numpy as np

from robofleet.core.arrays import Array

Numbers = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class BicycleParameters:
    """A vehicle; forces and stiffnesses are those of one wheel, an axle has two."""

    mass: float  # m [kg]
    yaw_inertia: float  # I_z [kg m^2]
    front_axle: float  # l_f, from the centre of gravity [m]
    rear_axle: float  # l_r [m]
    front_stiffness: float  # C_alpha,f, of one tyre [N/rad]
    rear_stiffness: float  # C_alpha,r [N/rad]

    def numbers(self) -> Numbers:
        return astuple(self)


ZHOU_2017 = BicycleParameters(1587.0, 2315.3, 1.218, 1.628, 35_000.0, 35_000.0)  # section III-A, Table 1
FALCONE_2007 = BicycleParameters(2050.0, 3344.0, 1.105, 1.738, 57_500.0, 92_500.0)  # section III-B, Table 2


def derivative(x: Array, u: Array, p: Numbers) -> Array:
    """Return dx/dt (6,)."""
    v_l, v_n, psi, rate = x[2], x[3], x[4], x[5]
    mass, inertia, l_f, l_r, stiff_f, stiff_r = p
    c, s = math.cos(psi), math.sin(psi)
    front = stiff_f * (u[1] - math.atan((v_n + l_f * rate) / v_l)) * math.cos(u[1])  # eq. 21, times cos delta_f
    rear = -stiff_r * math.atan((v_n - l_r * rate) / v_l)  # eq. 22
    dx = np.empty(6)
    dx[0] = v_l * c - v_n * s  # eq. 16
    dx[1] = v_l * s + v_n * c  # eq. 17
    dx[2] = rate * v_n + u[0]  # eq. 18
    dx[3] = -rate * v_l + 2.0 * (front + rear) / mass  # eq. 19
    dx[4] = rate
    dx[5] = 2.0 * (l_f * front - l_r * rear) / inertia  # eq. 20
    return dx


def state_jacobian(x: Array, u: Array, p: Numbers) -> Array:
    """Return the Jacobian of :func:`derivative` in x, (6, 6)."""
    v_l, v_n, psi, rate = x[2], x[3], x[4], x[5]
    mass, inertia, l_f, l_r, stiff_f, stiff_r = p
    c, s = math.cos(psi), math.sin(psi)
    at_front, at_rear = v_n + l_f * rate, v_n - l_r * rate  # lateral velocity of the axles
    front = -2.0 * stiff_f * math.cos(u[1]) / (v_l * v_l + at_front * at_front)
    rear = -2.0 * stiff_r / (v_l * v_l + at_rear * at_rear)
    j = np.zeros((6, 6))
    j[0, 2], j[0, 3], j[0, 4] = c, -s, -v_l * s - v_n * c
    j[1, 2], j[1, 3], j[1, 4] = s, c, v_l * c - v_n * s
    j[2, 3], j[2, 5] = rate, v_n
    j[3, 2] = -rate - (front * at_front + rear * at_rear) / mass
    j[3, 3] = (front + rear) * v_l / mass
    j[3, 5] = -v_l + (front * l_f - rear * l_r) * v_l / mass
    j[4, 5] = 1.0
    j[5, 2] = -(l_f * front * at_front - l_r * rear * at_rear) / inertia
    j[5, 3] = (l_f * front - l_r * rear) * v_l / inertia
    j[5, 5] = (l_f * l_f * front + l_r * l_r * rear) * v_l / inertia
    return j


def input_jacobian(x: Array, u: Array, p: Numbers) -> Array:
    """Return the Jacobian of :func:`derivative` in u, (6, 2)."""
    slip = u[1] - math.atan((x[3] + p[2] * x[5]) / x[2])
    slope = p[4] * (math.cos(u[1]) - slip * math.sin(u[1]))  # d(F_c,f cos delta_f) / d delta_f [N/rad]
    j = np.zeros((6, 2))
    j[2, 0] = 1.0
    j[3, 1] = 2.0 * slope / p[0]
    j[5, 1] = 2.0 * p[2] * slope / p[1]
    return j


def position(x: Array) -> Array:
    """Return y = C x = (z1, z2) [m] (eq. 23)."""
    return x[:2].copy()


def position_jacobian(x: Array) -> Array:
    """Return C (2, 6)."""
    c = np.zeros((2, 6))
    c[0, 0] = c[1, 1] = 1.0
    return c


def fastest_rate(x: Array, u: Array, p: Numbers) -> float:
    """Return the largest |eigenvalue| of the lateral motion (v_n, psi_dot) [1/s]; it grows like 1 / v_l."""
    v_l, v_n, rate = x[2], x[3], x[5]
    mass, inertia, l_f, l_r, stiff_f, stiff_r = p
    front = -2.0 * stiff_f * v_l / (v_l * v_l + (v_n + l_f * rate) ** 2)
    rear = -2.0 * stiff_r * v_l / (v_l * v_l + (v_n - l_r * rate) ** 2)
    lateral, yaw = (front + rear) / mass, (l_f * l_f * front + l_r * l_r * rear) / inertia
    moment = l_f * front - l_r * rear
    determinant = lateral * yaw - moment / inertia * (moment / mass - v_l)
    half = 0.5 * (lateral + yaw)
    root = half * half - determinant
    return abs(half) + math.sqrt(root) if root > 0.0 else math.sqrt(abs(determinant))

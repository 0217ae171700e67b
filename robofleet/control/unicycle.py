"""The unicycle as a plant of the Newton-Raphson flow (eqs 8 to 13): the output is the centre, the prediction an arc.

State x (5,): the centre z1, z2 [m; world] and the heading psi [rad; CCW +]; then v_w [m/s] and omega_w [rad/s], what
the body does beyond what was asked, held over the horizon. Input u (2,): v [m/s], omega [rad/s]. With u held the centre
moves along a circle: g(x, u) and dg/du are known in closed form, and no integration is needed.

dg/du is singular for v = 0: a robot at rest cannot choose the direction in which it would go. Who uses it keeps v above
a floor, and lets the robot stand where the reference is nearer than that.
"""

import functools
import math

import numpy as np

from robofleet.control.arrays import cached, finite
from robofleet.control.prediction import Plant
from robofleet.core.arrays import Array

_STRAIGHT = 1e-4  # half an arc's turn below which it is a straight line, to the second order [rad]


@functools.cache
def unicycle_plant() -> Plant:
    def predict(x: Array, u: Array, T: float, steps: int, y: Array, dg: Array) -> int:
        return _predict(x, u, T, y, dg)

    return Plant(_derivative, _centre, 5, 2, _state_jacobian, _input_jacobian, _centre_jacobian, _no_rate, predict)


def _derivative(x: Array, u: Array) -> Array:
    dx = np.zeros(5)
    v = u[0] + x[3]
    dx[0], dx[1], dx[2] = v * math.cos(x[2]), v * math.sin(x[2]), u[1] + x[4]
    return dx


def _state_jacobian(x: Array, u: Array) -> Array:
    j, v = np.zeros((5, 5)), u[0] + x[3]
    j[0, 2], j[1, 2] = -v * math.sin(x[2]), v * math.cos(x[2])
    j[0, 3], j[1, 3], j[2, 4] = math.cos(x[2]), math.sin(x[2]), 1.0
    return j


def _input_jacobian(x: Array, u: Array) -> Array:
    j = np.zeros((5, 2))
    j[0, 0], j[1, 0], j[2, 1] = math.cos(x[2]), math.sin(x[2]), 1.0
    return j


def _centre(x: Array) -> Array:
    return x[:2].copy()


def _centre_jacobian(x: Array) -> Array:
    c = np.zeros((2, 5))
    c[0, 0] = c[1, 1] = 1.0
    return c


def _no_rate(x: Array, u: Array) -> float:
    return 0.0


@cached
def _predict(x: Array, u: Array, T: float, y: Array, dg: Array) -> int:
    """Return as ``Plant.fused`` says: the end of the arc, and its derivatives by v and omega."""
    v, half = u[0] + x[3], (u[1] + x[4]) * T / 2.0
    chord, slope = 1.0 - half * half / 6.0, -half / 3.0  # sin(half) / half, and its derivative
    if abs(half) > _STRAIGHT:
        chord = math.sin(half) / half
        slope = (math.cos(half) - chord) / half
    c, s = math.cos(x[2] + half), math.sin(x[2] + half)
    y[0], y[1] = x[0] + v * T * chord * c, x[1] + v * T * chord * s
    dg[0, 0], dg[1, 0] = T * chord * c, T * chord * s
    dg[0, 1] = v * T * T / 2.0 * (slope * c - chord * s)
    dg[1, 1] = v * T * T / 2.0 * (slope * s + chord * c)
    return 0 if finite(y) else 1

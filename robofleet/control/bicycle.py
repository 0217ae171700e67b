"""The dynamic bicycle as a plant of the Newton-Raphson flow: output z1, z2; the prediction by hand.

RK4 of the state and its sensitivity (eq. 25) together, with the zeros of the Jacobians left out.
"""

import functools
import math

import numpy as np

from robofleet.control.arrays import cached, finite
from robofleet.control.prediction import RK4_LIMIT, Plant, needed_steps
from robofleet.core.arrays import Array
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import BicycleParameters, Numbers

_derivative = cached(bicycle.derivative)
_state_jacobian = cached(bicycle.state_jacobian)
_input_jacobian = cached(bicycle.input_jacobian)
_fastest_rate = cached(bicycle.fastest_rate)


@functools.cache
def bicycle_plant(parameters: BicycleParameters) -> Plant:
    """Return the plant, with analytic Jacobians; one plant (and one compilation) for equal parameters."""
    p = parameters.numbers()

    def f(x: Array, u: Array) -> Array:
        return _derivative(x, u, p)

    def f_x(x: Array, u: Array) -> Array:
        return _state_jacobian(x, u, p)

    def f_u(x: Array, u: Array) -> Array:
        return _input_jacobian(x, u, p)

    def fastest_rate(x: Array, u: Array) -> float:
        return _fastest_rate(x, u, p)

    def predict(x: Array, u: Array, T: float, steps: int, y: Array, dg: Array) -> int:
        return _predict(x, u, p, T, steps, y, dg)

    return Plant(f, bicycle.position, 6, 2, f_x, f_u, bicycle.position_jacobian, fastest_rate, predict)


@cached
def _slopes(s: Array, u: Array, c_delta: float, s_delta: float, p: Numbers, k: Array) -> None:
    """Write d/dtau of state and sensitivities (eqs 16-22, 25); s, k (18,): x, dx/da_l, dx/ddelta_f."""
    v_l, v_n, rate = s[2], s[3], s[5]
    mass, inertia, l_f, l_r, stiff_f, stiff_r = p
    cos, sin = math.cos(s[4]), math.sin(s[4])
    at_front, at_rear = v_n + l_f * rate, v_n - l_r * rate
    slip = u[1] - math.atan(at_front / v_l)
    front, rear = stiff_f * slip * c_delta, -stiff_r * math.atan(at_rear / v_l)
    k[0], k[1] = v_l * cos - v_n * sin, v_l * sin + v_n * cos
    k[2], k[3] = rate * v_n + u[0], -rate * v_l + 2.0 * (front + rear) / mass
    k[4], k[5] = rate, 2.0 * (l_f * front - l_r * rear) / inertia
    front_slope = stiff_f * c_delta / (v_l * v_l + at_front * at_front)
    rear_slope = stiff_r / (v_l * v_l + at_rear * at_rear)
    for c in (6, 12):
        d_l, d_n, d_psi, d_rate = s[c + 2], s[c + 3], s[c + 4], s[c + 5]
        d_front = front_slope * (at_front * d_l - v_l * (d_n + l_f * d_rate))
        d_rear = rear_slope * (at_rear * d_l - v_l * (d_n - l_r * d_rate))
        if c == 12:
            d_front += stiff_f * (c_delta - slip * s_delta)
        k[c] = cos * d_l - sin * d_n - k[1] * d_psi
        k[c + 1] = sin * d_l + cos * d_n + k[0] * d_psi
        k[c + 2] = d_rate * v_n + rate * d_n + (1.0 if c == 6 else 0.0)
        k[c + 3] = -d_rate * v_l - rate * d_l + 2.0 * (d_front + d_rear) / mass
        k[c + 4] = d_rate
        k[c + 5] = 2.0 * (l_f * d_front - l_r * d_rear) / inertia


@cached
def _predict(x: Array, u: Array, p: Numbers, T: float, steps: int, y: Array, dg: Array) -> int:
    """Return as ``Plant.fused`` says."""
    work = np.zeros((4, 18))
    s, at, k, total = work[0], work[1], work[2], work[3]
    s[:6] = x
    c_delta, s_delta, step = math.cos(u[1]), math.sin(u[1]), T / steps
    for count in range(1, steps + 1):
        _slopes(s, u, c_delta, s_delta, p, k)
        for i in range(18):
            total[i] = k[i]
            at[i] = s[i] + 0.5 * step * k[i]
        for part in (0.5 * step, step):
            _slopes(at, u, c_delta, s_delta, p, k)
            for i in range(18):
                total[i] += 2.0 * k[i]
                at[i] = s[i] + part * k[i]
        _slopes(at, u, c_delta, s_delta, p, k)
        for i in range(18):
            s[i] += step / 6.0 * (total[i] + k[i])
        if not finite(s):
            return count
    for i in range(2):
        y[i], dg[i, 0], dg[i, 1] = s[i], s[6 + i], s[12 + i]
    enough = needed_steps(_fastest_rate(s[:6], u, p), T, RK4_LIMIT)
    return -enough if enough > steps else 0

"""Prediction and update of the covariance in the fleet filter, an extended Kalman filter, for one robot.

State: x, y [m], psi [rad], efficiency of the left and of the right wheel. P: its covariance (5, 5). ``room`` is
overwritten: to allocate it for each robot would take longer than to compute.
"""

import math

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel

_MOST_EFFICIENT = 2.0
_LEAST_VARIANCE = 1e-14  # of a measurement [m^2, rad^2]: a tenth of a micrometre
_LEAST_SHARE = 1e-6  # of a coordinate's variance that the others leave


@kernel
def copy(to: Array, source: Array) -> None:
    """Write the first numbers of ``source`` over ``to`` (k,). An assignment of slices compiles slowly."""
    for k in range(len(to)):
        to[k] = source[k]


@kernel
def covariance_of(measured: Array, variance: Array, r: Array) -> None:
    """Write R (3, 3) of a measurement (9,): as it says itself; without that, ``variance`` (3,) of x, y and psi."""
    xx, xy, yy, x_psi, y_psi, psi_psi = (
        measured[3], measured[4], measured[5], measured[6], measured[7], measured[8],
    )  # fmt: skip
    if not psi_psi > 0.0:
        xx, xy, yy, x_psi, y_psi, psi_psi = variance[0], 0.0, variance[1], 0.0, 0.0, variance[2]
    r[0, 0], r[1, 1], r[2, 2] = max(xx, _LEAST_VARIANCE), max(yy, _LEAST_VARIANCE), max(psi_psi, _LEAST_VARIANCE)
    r[0, 1] = r[1, 0] = xy
    r[0, 2] = r[2, 0] = x_psi
    r[1, 2] = r[2, 1] = y_psi


@kernel
def whitening(r: Array, w: Array) -> None:
    """Write the lower triangle W (3, 3) with W R W' = 1: of a measurement times W the parts are independent."""
    for i in range(3):
        for j in range(i + 1):
            total = r[i, j]
            for k in range(j):
                total -= w[i, k] * w[j, k]
            w[i, j] = math.sqrt(max(total, _LEAST_SHARE * r[i, i])) if i == j else total / w[j, j]
    for i in range(3):
        w[i, i] = 1.0 / w[i, i]
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total -= w[i, k] * w[k, j]
            w[i, j] = total * w[i, i]


@kernel
def start_anew(x: Array, p: Array, measured: Array, r: Array, wander: Array) -> None:
    """Believe a measurement with covariance R (3, 3) alone, and every wheel again."""
    for i in range(len(x)):
        for j in range(len(x)):
            p[i, j] = r[i, j] if i < 3 and j < 3 else 0.0
    for k in range(3):
        x[k] = measured[k]
    for k in range(3, 5):
        x[k] = 1.0
        p[k, k] = wander[0]


@kernel
def predict_covariance(
    x: Array, p: Array, moved: Array, travel: Array, base: float, duration: float, drift: Array, wander: Array,
    room: Array,
) -> None:  # fmt: skip
    """P <- F P F' + Q, F the derivative of the motion: a wrong heading turns the way that was covered, a wrong
    efficiency lengthens one wheel's part of it. Efficiencies forget towards 1. ``room``: (8, 5).
    """
    heading = x[2] - moved[2] / 2.0
    kept = np.exp(-duration / wander[1])
    c, s = np.cos(heading), np.sin(heading)
    f, product = room[:3], room[3:]  # f: what heading and efficiencies do to x, y and psi
    f[0, 0], f[1, 0], f[2, 0] = -moved[1], moved[0], 0.0
    for side in range(2):
        k = 1 + side
        f[0, k], f[1, k] = travel[side] / 2.0 * c, travel[side] / 2.0 * s
        f[2, k] = travel[side] / base * (1.0 if side == 1 else -1.0)
        x[3 + side] = 1.0 + (x[3 + side] - 1.0) * kept
    for i in range(3):
        for j in range(5):
            product[i, j] = p[i, j] + f[i, 0] * p[2, j] + f[i, 1] * p[3, j] + f[i, 2] * p[4, j]
    for i in range(3, 5):
        for j in range(5):
            product[i, j] = kept * p[i, j]
    for i in range(3):
        for j in range(5):
            p[i, j] = product[j, i] + f[i, 0] * product[j, 2] + f[i, 1] * product[j, 3] + f[i, 2] * product[j, 4]
        p[i, i] += drift[i] * duration
    for i in range(3, 5):
        for j in range(5):
            p[i, j] = kept * product[j, i]
        p[i, i] += wander[0] * (1.0 - kept * kept)


@kernel
def held_up(p: Array, moved: Array, wide: Array) -> Array:
    """Return ``wide`` (5, 5): the covariance of a robot that may have done all, none or twice of the motion since it
    was seen last.

    Blocked motors and spinning wheels are no outliers: without this a robot that is held up would be refused for
    several images, and believed to drive on.
    """
    for i in range(len(p)):
        copy(wide[i], p[i])
    for i in range(3):
        for j in range(3):
            wide[i, j] += moved[i] * moved[j]
    return wide


@kernel
def correct(x: Array, p: Array, prior: Array, innovation: Array, w: Array, gate: float, room: Array) -> bool:
    """Correct state and covariance ``p``, with ``prior`` in its place, unless the innovation is beyond the gate.

    Times W (3, 3) of ``whitening``, the three coordinates are independent: they correct one after the other. ``room``:
    (8, 5).
    """
    n = len(x)
    change, gain, shared, trial = room[0], room[1], room[2], room[3:]
    for i in range(n):
        change[i] = 0.0
        copy(trial[i], prior[i])
    distance = 0.0
    for k in range(3):
        s, residual = 1.0, 0.0
        for i in range(n):
            shared[i] = 0.0
            for j in range(k + 1):
                shared[i] += w[k, j] * trial[j, i]
        for j in range(k + 1):
            s += w[k, j] * shared[j]
            residual += w[k, j] * (innovation[j] - change[j])
        distance += residual * residual / s
        for i in range(n):
            gain[i] = shared[i] / s
            change[i] += gain[i] * residual
        for j in range(n):
            for i in range(n):
                trial[i, j] -= gain[i] * shared[j]
    if distance > gate:
        return False
    for i in range(n):
        x[i] += change[i]
    for k in range(3, n):
        x[k] = min(max(x[k], 0.0), _MOST_EFFICIENT)
    for i in range(n):
        copy(p[i], trial[i])
    return True


@kernel
def wrapped(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))

"""The predicted output g(x, u) and its sensitivity dg/du (eqs 11-13, 24, 25) for a user's own plant, compiled.

The prediction holds u: xi' = f(xi, u) + w, xi(t) = x (eq. 11), g = h(xi(t+T)) (eqs 12, 13). Beside it runs
S = d xi / du, S' = f_x S + f_u, S(t) = 0 (eq. 25); then dg/du = h_x S (eq. 24). Without Jacobians f_x S + f_u is
the difference of the slope at xi and one beside it along (S, 1): m + 1 rollouts at once, each stage from the same
state, so that the size of the output is not what is rounded. The sides alternate: stages of equal weight cancel each
other's curvature (on one side alone, differences are right to 3e-6 only).

w (n,) is the disturbance of the state equation that ``offset_free`` estimates, else zero.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from robofleet.control.arrays import all_finite, cached, compiled, copy, finite
from robofleet.control.sensitivity import (
    analytic_output,
    analytic_slopes,
    difference_output,
    difference_slopes,
    forward_jacobian,
)
from robofleet.core.arrays import Array
from robofleet.core.kernels import model

RK4_LIMIT, EULER_LIMIT = 2.7, 1.95  # |eigenvalue| * prediction step where the method becomes unstable
RK4_CHOICE, EULER_CHOICE = 1.5, 0.02  # and where it is accurate: what is chosen
MAX_STEPS = 20_000


@dataclass(frozen=True)
class Plant:
    """A plant x' = f(x, u), y = h(x) (eqs 8, 9); all functions are plain Python that numba can compile.

    Attributes:
        f: State equation: x (n,), u (m,) -> x' (n,).
        h: Output: x (n,) -> y (m,).
        n: Number of states.
        m: Number of inputs and of outputs.
        f_x: df/dx: x, u -> (n, n). Given together with ``f_u``, or found by differences.
        f_u: df/du: x, u -> (n, m).
        h_x: dh/dx: x -> (m, n).
        fastest_rate: Largest |eigenvalue| of f_x: x, u -> [1/s]. None: it is computed.
        fused: The prediction by hand (RK4): x, u, T, steps, y, dg -> status. It writes g (m,) to y and dg/du (m, m) to
            dg, and returns 0, or the step k that was not finite, or -k where the eigenvalues met on the way need k
            steps.
    """

    f: Callable[[Array, Array], Array]
    h: Callable[[Array], Array]
    n: int
    m: int
    f_x: Callable[[Array, Array], Array] | None = None
    f_u: Callable[[Array, Array], Array] | None = None
    h_x: Callable[[Array], Array] | None = None
    fastest_rate: Callable[[Array, Array], float] | None = None
    fused: Callable[[Array, Array, float, int, Array, Array], int] | None = None


@dataclass(frozen=True)
class Compiled:
    """A plant's compiled parts."""

    predict: Any  # (x, u, w, T, steps, euler, y, dg) -> as Plant.fused
    rollout: Any  # (x, u, w, duration, out) -> None
    fastest_rate: Any  # (x, u) -> float [1/s]


def compile_plant(plant: Plant) -> Compiled:
    """Return the compiled parts of a plant; compiled at their first call, once for plants that mean the same now."""
    parts = plant_parts(plant)
    return Compiled(model(parts.predict), model(parts.rollout), model(parts.fastest_rate))


def plant_parts(plant: Plant) -> Compiled:
    """Return the parts of a plant for a larger model, which compiles each of them once."""
    f, h = compiled(plant.f), compiled(plant.h)
    if plant.f_x is not None and plant.f_u is not None:
        f_x = compiled(plant.f_x)
        along = analytic_slopes(f_x, compiled(plant.f_u))
    else:
        f_x = forward_jacobian(f)
        along = difference_slopes(f)
    output = difference_output(h) if plant.h_x is None else analytic_output(compiled(plant.h_x))
    rate = spectral_radius_bound(f_x) if plant.fastest_rate is None else compiled(plant.fastest_rate)
    return Compiled(_predictor(f, h, along, output, rate), _rollout(f, rate), rate)


@cached
def needed_steps(rate: float, duration: float, limit: float) -> int:
    """Return how many prediction steps keep |eigenvalue| * step within ``limit``; MAX_STEPS + 1: too many."""
    steps = math.ceil(rate * duration / limit)
    return max(1, int(steps)) if steps <= MAX_STEPS else MAX_STEPS + 1


def spectral_radius_bound(f_x: Any) -> Any:
    """Return the function that bounds the largest |eigenvalue| of f_x by |A^16|^(1/16); 0 for chains of integrators."""

    @compiled
    def rate(x: Array, u: Array) -> float:
        a = f_x(x, u)
        logarithm, weight = 0.0, 1.0
        for _ in range(5):
            size = 0.0
            for value in a.flat:
                size = max(size, abs(value))
                if not abs(value) < np.inf:
                    return np.inf
            if size == 0.0:
                return 0.0
            logarithm += weight * math.log(size)
            weight *= 0.5
            b, inverse = np.zeros_like(a), 1.0 / size
            for i in range(len(a)):
                for k in range(len(a)):
                    if a[i, k] != 0.0:
                        for j in range(len(a)):
                            b[i, j] += (a[i, k] / size) * (a[k, j] * inverse)
            a = b
        return float(math.exp(logarithm) * len(a) ** 0.0625)

    return rate


def _predictor(f: Any, h: Any, along: Any, output: Any, rate: Any) -> Any:
    @compiled
    def predict(x: Array, u: Array, w: Array, T: float, steps: int, euler: bool, y: Array, dg: Array) -> int:
        n, m, step = len(x), len(u), T / steps
        start, xi, total, S = np.zeros((n, 1 + m)), x.copy(), np.zeros((n, 1 + m)), np.zeros((n, m))
        k, moved, moved_u = np.empty((n, 1 + m)), np.empty(n), np.empty(m)
        copy(start[:, 0], x)
        for count in range(1, steps + 1):
            for stage in range(1 if euler else 4):
                slope = f(xi, u)
                side = 1.0 if (count + stage) % 2 == 0 else -1.0
                along(xi, u, S, slope, side, moved, moved_u, k[:, 1:])
                for i in range(n):
                    k[i, 0] = slope[i] + w[i]
                _stage(stage, euler, step, start, k, total, xi, S)
            if not all_finite(start):
                return count
        copy(y, h(xi))
        output(xi, S, dg)
        if not (finite(y) and all_finite(dg)):
            return steps
        enough = needed_steps(rate(xi, u), T, EULER_LIMIT if euler else RK4_LIMIT)
        return -enough if enough > steps else 0

    return predict


@cached
def _stage(stage: int, euler: bool, step: float, start: Array, k: Array, total: Array, xi: Array, S: Array) -> None:
    """Go from the slopes k (n, 1 + m) of a stage to where the next one is taken; after the last, ``start`` moves."""
    last = euler or stage == 3
    share = 1.0 if euler else (1.0 / 6.0 if stage in (0, 3) else 1.0 / 3.0)
    part = step if stage == 2 else 0.5 * step
    for i in range(k.shape[0]):
        for j in range(k.shape[1]):
            total[i, j] = share * k[i, j] + (total[i, j] if stage > 0 else 0.0)
            if last:
                start[i, j] += step * total[i, j]
            value = start[i, j] if last else start[i, j] + part * k[i, j]
            if j == 0:
                xi[i] = value
            else:
                S[i, j - 1] = value


def _rollout(f: Any, rate: Any) -> Any:
    """RK4 of the state alone, for the delay and for what the last step should have done."""

    @compiled
    def rollout(x: Array, u: Array, w: Array, duration: float, out: Array) -> None:
        steps = min(MAX_STEPS, 1 + needed_steps(rate(x, u), duration, 0.2))
        step, start, xi, total = duration / steps, x.copy(), x.copy(), np.zeros_like(x)
        for _ in range(steps):
            for stage in range(4):
                k = f(xi, u)
                for i in range(len(x)):
                    slope = k[i] + w[i]
                    total[i] = slope if stage == 0 else total[i] + (slope if stage == 3 else 2.0 * slope)
                    xi[i] = start[i] + (step if stage == 2 else 0.5 * step) * slope
            for i in range(len(x)):
                start[i] += step / 6.0 * total[i]
                xi[i] = start[i]
        copy(out, xi)

    return rollout

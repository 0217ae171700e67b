"""What eq. 25 needs of a plant: f_x S + f_u and h_x S, from its Jacobians or by differences.

A user's function may return a part of its argument: what it returned is read before the argument changes.
"""

from typing import Any

import numpy as np

from robofleet.control.arrays import cached, compiled, copy
from robofleet.core.arrays import Array

_DIFFERENCE = 6e-6  # relative step of a central difference: third root of the rounding error
_ONE_SIDED = 1e-7  # of a difference whose curvature is cancelled by the next one's, on the other side


def analytic_slopes(f_x: Any, f_u: Any) -> Any:
    """Return ``along``, which writes f_x S + f_u (n, m) to ``out``, from the Jacobians.

    ``slope`` is f(xi, u); ``side``, 1.0 or -1.0, and ``moved`` (n,), ``moved_u`` (m,) to work in: for differences.
    """

    @compiled
    def along(
        xi: Array, u: Array, S: Array, slope: Array, side: float, moved: Array, moved_u: Array, out: Array
    ) -> None:
        b, j = f_u(xi, u), f_x(xi, u)
        for i in range(S.shape[0]):
            copy(out[i], b[i])
            for k in range(S.shape[0]):
                if j[i, k] != 0.0:
                    for c in range(S.shape[1]):
                        out[i, c] += j[i, k] * S[k, c]

    return along


def difference_slopes(f: Any) -> Any:
    """Return the same from f alone: the slope at xi, and the one on one side of it along (S, 1)."""

    @compiled
    def along(
        xi: Array, u: Array, S: Array, slope: Array, side: float, moved: Array, moved_u: Array, out: Array
    ) -> None:
        copy(moved_u, u)
        for c in range(len(u)):
            moved_u[c] = u[c] + side * _ONE_SIDED * min(1.0 + abs(u[c]), _reach(xi, S[:, c]))
            step = moved_u[c] - u[c]
            _move(moved, xi, step, S[:, c])
            beside = f(moved, moved_u)
            for i in range(len(xi)):
                out[i, c] = (beside[i] - slope[i]) / step
            moved_u[c] = u[c]

    return along


@cached
def _reach(xi: Array, direction: Array) -> float:
    """Return how far along ``direction`` xi changes by its own size or by 1, whichever is more."""
    reach = np.inf
    for i in range(len(xi)):
        if direction[i] != 0.0:
            reach = min(reach, (1.0 + abs(xi[i])) / abs(direction[i]))
    return reach


@cached
def _move(moved: Array, xi: Array, step: float, direction: Array) -> None:
    for i in range(len(xi)):
        moved[i] = xi[i] + step * direction[i]


def forward_jacobian(f: Any) -> Any:
    """Return the function (x, u) -> df/dx by forward differences, n + 1 calls: for bounds, right to about 1e-6."""

    @compiled
    def f_x(xi: Array, u: Array) -> Array:
        jacobian, moved, slope = np.empty((len(xi), len(xi))), xi.copy(), f(xi, u)
        for k in range(len(xi)):
            moved[k] = xi[k] + _ONE_SIDED * (1.0 + abs(xi[k]))
            step = moved[k] - xi[k]
            beside = f(moved, u)
            for i in range(len(xi)):
                jacobian[i, k] = (beside[i] - slope[i]) / step
            moved[k] = xi[k]
        return jacobian

    return f_x


def difference_jacobian(f: Any) -> Any:
    """Return the function (x, u) -> df/dx by central differences."""

    @compiled
    def f_x(xi: Array, u: Array) -> Array:
        jacobian = np.empty((len(xi), len(xi)))
        moved = xi.copy()
        for k in range(len(xi)):
            step = _DIFFERENCE * (1.0 + abs(xi[k]))
            moved[k] = xi[k] + step
            copy(jacobian[:, k], f(moved, u))
            moved[k] = xi[k] - step
            below = f(moved, u)
            for i in range(len(xi)):
                jacobian[i, k] = (jacobian[i, k] - below[i]) / (2.0 * step)
            moved[k] = xi[k]
        return jacobian

    return f_x


def analytic_output(h_x: Any) -> Any:
    """Return ``output(xi, S, dg)``, which writes h_x S (m, m) (eq. 24)."""

    @compiled
    def output(xi: Array, S: Array, dg: Array) -> None:
        c = h_x(xi)
        for i in range(dg.shape[0]):
            for j in range(dg.shape[1]):
                dg[i, j] = 0.0
                for k in range(len(xi)):
                    dg[i, j] += c[i, k] * S[k, j]

    return output


def difference_output(h: Any) -> Any:
    @compiled
    def output(xi: Array, S: Array, dg: Array) -> None:
        moved = xi.copy()
        for j in range(dg.shape[1]):
            step = _DIFFERENCE * min(1e100, _reach(xi, S[:, j]))
            _move(moved, xi, step, S[:, j])
            copy(dg[:, j], h(moved))
            _move(moved, xi, -step, S[:, j])
            below = h(moved)
            for i in range(dg.shape[0]):
                dg[i, j] = (dg[i, j] - below[i]) / (2.0 * step)

    return output

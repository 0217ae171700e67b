"""Linear-time-varying model-predictive control with OSQP, warm-started.

At every update the bicycle is linearised along the motion that the last input sequence U gives from the measured
state, z = z(U) + G dU, and one quadratic program in dU is solved (states eliminated: 2 N unknowns):

min of  |z(U) + G dU - r|^2 + sum_k (u_k - u_k-1)' R (u_k - u_k-1),  |u_k| <= limits,  u = U + dU.
"""

import numpy as np
import osqp
from scipy import sparse

from robofleet.control.arrays import cached
from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel
from robofleet.experiments.baselines.problem import Input, Problem
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import Numbers

_derivative = cached(bicycle.derivative)
_state_jacobian = cached(bicycle.state_jacobian)
_input_jacobian = cached(bicycle.input_jacobian)


class OsqpMpc:
    """Linear-time-varying MPC; ``failures`` counts the updates whose solver gave up and whose last iterate was used."""

    name = "LTV-MPC OSQP"

    def __init__(self, problem: Problem, horizon: float, nodes: int, weights: tuple[float, float]):
        """``horizon`` [s], ``weights``: R's diagonal [m^2 / (m/s^2)^2, m^2 / rad^2]."""
        self.failures = 0
        self._problem, self._interval = problem, horizon / nodes
        self._p = problem.model.numbers()
        self._times: Array = self._interval * np.arange(1, nodes + 1, dtype=np.float64)
        self._u = np.zeros((nodes, 2))
        self._last = np.zeros(2)
        difference = np.kron(np.eye(nodes) - np.eye(nodes, k=-1), np.eye(2))
        self._scale = np.tile(np.array([1.0, np.sqrt(weights[0] / weights[1])]), nodes)  # equal weight on both inputs
        self._pull = difference.T @ (np.tile(weights, nodes)[:, None] * difference)  # of U on the cost's gradient
        self._hold = np.array(weights)  # of u_-1
        self._limits = np.tile([problem.max_acceleration, problem.max_steering], nodes) / self._scale
        self._upper = tuple(np.tril_indices(2 * nodes)[::-1])  # column by column
        self._solver = osqp.OSQP()
        full = sparse.csc_matrix(np.triu(np.ones((2 * nodes, 2 * nodes))))
        self._solver.setup(
            full, np.zeros(2 * nodes), sparse.eye(2 * nodes, format="csc"), -self._limits, self._limits,
            warm_starting=True, verbose=False, eps_abs=1e-6, eps_rel=1e-6, scaling=0, max_iter=400,
        )  # fmt: skip

    def update(self, t: float, x: Array) -> Input:
        z, G = linearised(x, self._u, self._p, self._interval)
        r = self._problem.target(t + self._times).ravel()
        U, scale = self._u.ravel(), self._scale
        gradient = G.T @ (z - r) + self._pull @ U
        gradient[:2] -= self._hold * self._last
        hessian = (G.T @ G + self._pull) * scale * scale[:, None]
        at = U / scale
        self._solver.update(
            Px=hessian[self._upper], q=gradient * scale, l=-self._limits - at, u=self._limits - at
        )  # fmt: skip
        found = self._solver.solve(raise_error=False)
        self.failures += found.info.status_val != 1
        if not np.isfinite(found.x).all():
            raise ValueError(f"{self.name}: no solution at t = {t:.2f} s")
        self._u += (found.x * scale).reshape(-1, 2)
        a, delta = self._problem.limited((float(self._u[0, 0]), float(self._u[0, 1])))
        self._last = np.array((a, delta))
        return a, delta


@kernel
def linearised(x: Array, U: Array, p: Numbers, h: float) -> tuple[Array, Array]:
    """Return the positions z (2 N,) at the nodes' ends under the inputs U (N, 2), and G (2 N, 2 N) = dz / dU.

    RK4 with one step of h [s] a node, of the state and its sensitivities to all inputs so far.
    """
    nodes, x = len(U), x.copy()
    z, G = np.empty(2 * nodes), np.zeros((2 * nodes, 2 * nodes))
    S, St, dS = np.zeros((6, 2 * nodes)), np.zeros((6, 2 * nodes)), np.zeros((6, 2 * nodes))
    total = np.zeros((6, 2 * nodes))
    for k in range(nodes):
        used, sum_x, at = 2 * k + 2, np.zeros(6), x.copy()
        St[:], total[:] = S, 0.0
        for stage in range(4):
            share = 1.0 / 6.0 if stage in (0, 3) else 1.0 / 3.0
            part = h if stage == 2 else 0.5 * h
            slope = _derivative(at, U[k], p)
            _slopes(_state_jacobian(at, U[k], p), _input_jacobian(at, U[k], p), St, used, dS)
            sum_x += share * slope
            at = x + part * slope
            for i in range(6):
                for c in range(used):
                    total[i, c] += share * dS[i, c]
                    St[i, c] = S[i, c] + part * dS[i, c]
        x += h * sum_x
        for i in range(6):
            for c in range(used):
                S[i, c] += h * total[i, c]
        for i in range(2):
            z[2 * k + i] = x[i]
            G[2 * k + i] = S[i]
    return z, G


@kernel
def _slopes(j: Array, b: Array, S: Array, used: int, dS: Array) -> None:
    """Write f_x S + f_u; the newest two of the ``used`` inputs act now."""
    for i in range(6):
        for c in range(used):
            dS[i, c] = b[i, c - used + 2] if c >= used - 2 else 0.0
        for m in range(6):
            if j[i, m] != 0.0:
                for c in range(used):
                    dS[i, c] += j[i, m] * S[m, c]

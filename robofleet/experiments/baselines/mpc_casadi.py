"""Nonlinear model-predictive control with casadi: direct multiple shooting, solved by IPOPT or by fatrop.

min over u_0..u_N-1 of  sum_k |z(t_k+1) - r(t_k+1)|^2 + (u_k - u_k-1)' R (u_k - u_k-1),  |u_k| <= limits,

with RK4 over each node's interval. The state is augmented by the last input, so that the problem has the stagewise
structure that fatrop asks for. Every update starts from the last one's solution.
"""

import math
from typing import Any, Literal

import casadi as ca
import numpy as np

from robofleet.core.arrays import Array
from robofleet.experiments.baselines.problem import Input, Problem
from robofleet.vehicles.bicycle import BicycleParameters

Solver = Literal["ipopt", "fatrop"]

_START_BARRIER, _TOLERANCE = 1e-4, 1e-6  # a small first barrier parameter: the solution is near the last one


def has(solver: Solver) -> bool:
    return bool(ca.has_nlpsol(solver))


def derivative(x: Any, u: Any, p: BicycleParameters) -> Any:
    """Return dx/dt (eqs 16-22) as an expression."""
    v_l, v_n, psi, rate = x[2], x[3], x[4], x[5]
    front = p.front_stiffness * (u[1] - ca.atan((v_n + p.front_axle * rate) / v_l)) * ca.cos(u[1])
    rear = -p.rear_stiffness * ca.atan((v_n - p.rear_axle * rate) / v_l)
    return ca.vertcat(
        v_l * ca.cos(psi) - v_n * ca.sin(psi),
        v_l * ca.sin(psi) + v_n * ca.cos(psi),
        rate * v_n + u[0],
        -rate * v_l + 2.0 * (front + rear) / p.mass,
        rate,
        2.0 * (p.front_axle * front - p.rear_axle * rear) / p.yaw_inertia,
    )


class CasadiMpc:
    """Nonlinear MPC; ``failures`` counts the updates whose solver gave up and whose last iterate was used."""

    def __init__(self, problem: Problem, horizon: float, nodes: int, weights: tuple[float, float], solver: Solver):
        """``horizon`` [s], ``weights``: R's diagonal [m^2 / (m/s^2)^2, m^2 / rad^2]."""
        self.name = f"MPC casadi {solver}"
        self.failures = 0
        self._problem, self._nodes, self._interval = problem, nodes, horizon / nodes
        self._times: Array = self._interval * np.arange(1, nodes + 1, dtype=np.float64)
        cost, gaps, parameters, unknowns, kinds = self._transcribed(weights)
        options: dict[str, Any] = {"print_time": False, "expand": True, "error_on_fail": False}
        if solver == "ipopt":
            options["ipopt"] = {"print_level": 0, "sb": "yes", "mu_init": _START_BARRIER, "tol": _TOLERANCE}
            options["ipopt"]["warm_start_init_point"] = "yes"
        else:
            options |= {"structure_detection": "auto", "equality": [kind is None for kind in kinds]}
            options["fatrop"] = {"print_level": 0, "mu_init": _START_BARRIER, "tol": _TOLERANCE}
        self._solve = ca.nlpsol("mpc", solver, {"x": unknowns, "f": cost, "g": gaps, "p": parameters}, options)
        bounds = np.array([0.0 if kind is None else kind for kind in kinds])
        self._start: dict[str, Any] = {"lbg": -bounds, "ubg": bounds}
        self._last = np.zeros(2)

    def update(self, t: float, x: Array) -> Input:
        r = self._problem.target(t + self._times)
        first = np.concatenate([x, self._last])
        if "x0" not in self._start:
            self._start["x0"] = self._guess(first, r)
        found = self._solve(**self._start, p=np.concatenate([first, r.ravel()]))
        self.failures += not self._solve.stats()["success"]
        self._start |= {"x0": found["x"], "lam_x0": found["lam_x"], "lam_g0": found["lam_g"]}
        a, delta = self._last + np.asarray(found["x"][8:10]).ravel()
        if not (math.isfinite(a) and math.isfinite(delta)):
            raise ValueError(f"{self.name}: no solution at t = {t:.2f} s")
        self._last = np.array(self._problem.limited((float(a), float(delta))))
        return float(a), float(delta)

    def _transcribed(self, weights: tuple[float, float]) -> tuple[Any, Any, Any, Any, list[float | None]]:
        """Return cost, constraints, parameters, unknowns, and each constraint's kind: None: = 0, else |g| <= kind."""
        problem, nodes = self._problem, self._nodes
        states = [ca.SX.sym(f"x{k}", 8) for k in range(nodes + 1)]  # (x, u_k-1)
        changes = [ca.SX.sym(f"du{k}", 2) for k in range(nodes)]
        parameters = ca.SX.sym("p", 8 + 2 * nodes)
        limits = [problem.max_acceleration, problem.max_steering]
        cost, gaps, kinds = ca.SX(0), [], list[float | None]()
        for k in range(nodes):
            gaps.append(states[k + 1] - self._stepped(states[k], changes[k]))
            kinds += [None] * 8
            if k == 0:
                gaps.append(states[0] - parameters[:8])
                kinds += [None] * 8
            gaps.append(states[k][6:] + changes[k])
            kinds += limits
            cost += ca.sumsqr(states[k + 1][:2] - parameters[8 + 2 * k : 10 + 2 * k])
            cost += ca.dot(ca.DM(weights), changes[k] ** 2)
        unknowns = [part for pair in zip(states, changes, strict=False) for part in pair]
        return cost, ca.vertcat(*gaps), parameters, ca.vertcat(*unknowns, states[-1]), kinds

    def _stepped(self, state: Any, change: Any) -> Any:
        """Return the augmented state one node later, by RK4."""
        x, u, h, model = state[:6], state[6:] + change, self._interval, self._problem.model
        k1 = derivative(x, u, model)
        k2 = derivative(x + h / 2.0 * k1, u, model)
        k3 = derivative(x + h / 2.0 * k2, u, model)
        k4 = derivative(x + h * k3, u, model)
        return ca.vertcat(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), u)

    def _guess(self, first: Array, r: Array) -> Array:
        """Return the first update's guess: along the reference, no change of input."""
        later = np.tile(np.concatenate([first, np.zeros(2)]), (self._nodes + 1, 1))
        later[1:, :2] = r
        return later.ravel()[:-2]

"""Nonlinear model-predictive control with do-mpc: orthogonal collocation, IPOPT.

The cost is that of :mod:`mpc_casadi`, by do-mpc's own stage cost, penalty on input changes and time-varying reference.
"""

import warnings
from typing import Any

import numpy as np

from robofleet.core.arrays import Array
from robofleet.experiments.baselines.mpc_casadi import derivative
from robofleet.experiments.baselines.problem import Input, Problem

with warnings.catch_warnings():  # it warns of each of its optional parts that is not installed
    warnings.filterwarnings("ignore", message="The .* feature", category=UserWarning)
    import do_mpc

_QUIET = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": 0}


class DoMpc:
    """Nonlinear MPC; ``failures`` counts the updates whose solver gave up and whose last iterate was used."""

    name = "MPC do-mpc"

    def __init__(self, problem: Problem, horizon: float, nodes: int, weights: tuple[float, float]):
        """``horizon`` [s], ``weights``: of input changes [m^2 / (m/s^2)^2, m^2 / rad^2]."""
        self.failures = 0
        self._problem, self._interval, self._nodes = problem, horizon / nodes, nodes
        self._r = np.zeros((nodes + 1, 2))
        self._times: Array = self._interval * np.arange(nodes + 1, dtype=np.float64)
        model = do_mpc.model.Model("continuous")
        x, u = model.set_variable("_x", "x", shape=(6, 1)), model.set_variable("_u", "u", shape=(2, 1))
        r = model.set_variable("_tvp", "r", shape=(2, 1))
        model.set_rhs("x", derivative(x, u, problem.model))
        model.setup()
        self._mpc = self._set_up(model, (x[0] - r[0]) ** 2 + (x[1] - r[1]) ** 2, weights)
        self._started = False

    def update(self, t: float, x: Array) -> Input:
        self._r[:] = self._problem.target(t + self._times)
        if not self._started:
            self._mpc.x0 = x
            self._mpc.set_initial_guess()
            self._started = True
        u = self._mpc.make_step(x).ravel()
        self.failures += not self._mpc.solver_stats["success"]
        if not np.isfinite(u).all():
            raise ValueError(f"{self.name}: no solution at t = {t:.2f} s")
        return float(u[0]), float(u[1])

    def _set_up(self, model: Any, cost: Any, weights: tuple[float, float]) -> Any:
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon, mpc.settings.t_step = self._nodes, self._interval
        mpc.settings.store_full_solution = False
        mpc.settings.nlpsol_opts = dict(_QUIET)
        mpc.set_objective(lterm=cost, mterm=cost)
        mpc.set_rterm(u=np.array(weights))
        limits = np.array([[self._problem.max_acceleration], [self._problem.max_steering]])
        mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -limits, limits
        template = mpc.get_tvp_template()

        def reference(_: float) -> Any:
            for k, r in enumerate(self._r):
                template["_tvp", k, "r"] = r
            return template

        mpc.set_tvp_fun(reference)
        with warnings.catch_warnings():  # it hands casadi's arrays to numpy, as casadi 3.8 says
            warnings.filterwarnings("ignore", message=r"\s*casadi: a numpy function", category=FutureWarning)
            mpc.setup()
        return mpc

"""The Newton-Raphson flow as one of the comparison's controllers; it rolls the state forward by itself."""

import numpy as np
from numpy.typing import NDArray

from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow
from robofleet.experiments.baselines.problem import Input, Problem
from robofleet.experiments.driving import FlowParameters

Array = NDArray[np.float64]


class Flow:
    """The flow with the bicycle's analytic Jacobians."""

    def __init__(self, problem: Problem, law: FlowParameters, delay: int) -> None:
        """``delay``: control periods that the law knows of and rolls the measured state forward over."""
        known, limits = delay * problem.step, (problem.max_acceleration, problem.max_steering)
        self.name = f"NR flow T {law.horizon_s:g}"
        settings = FlowSettings(
            law.alpha, law.horizon_s, problem.step, law.integrator,
            delay=known, lower=(-limits[0], -limits[1]), upper=limits,
        )  # fmt: skip
        self._ahead = known + law.horizon_s
        self._flow = NewtonRaphsonFlow(bicycle_plant(problem.model), settings, np.zeros(2))
        self._problem = problem

    def update(self, t: float, x: Array) -> Input:
        """Return u after one control step; r(t + delay + T) is the problem's."""
        u = self._flow.update(x, self._problem.target(np.array([t + self._ahead]))[0])
        return float(u[0]), float(u[1])

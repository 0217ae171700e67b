"""The comparison's controllers by name, with their parameters. A library is imported when its controller is built."""

from importlib import import_module
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow
from robofleet.core.arrays import Array
from robofleet.core.errors import RobofleetError
from robofleet.core.settings import Model, NonNegative, Positive
from robofleet.experiments.baselines.geometric import CurvatureLqr, PurePursuit, Stanley
from robofleet.experiments.baselines.problem import Controller, Input, Problem, RollForward
from robofleet.experiments.driving import FlowParameters


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


Key = Literal[
    "flow-paper", "flow", "lqr", "osqp", "osqp-sharp", "fatrop", "ipopt", "do-mpc", "pure-pursuit", "stanley"
]  # fmt: skip
_LIBRARIES = {"osqp": "osqp", "scipy": "osqp", "casadi": "casadi", "do_mpc": "do-mpc"}  # module: what to install


class MissingLibraryError(RobofleetError, RuntimeError):
    """Raised where a controller's library, or its solver, is not installed. The message says what to do."""


class MpcParameters(Model):
    """Cost and horizon of all predictive controllers: |z - r|^2 + weights times (change of input)^2 a node."""

    horizon_s: Positive
    nodes: Annotated[int, Field(ge=2, le=200)]
    acceleration_weight: Positive  # [m^2 / (m/s^2)^2]
    steering_weight: Positive  # [m^2 / rad^2]
    sharp: Positive  # osqp-sharp: both weights times this


class LqrParameters(Model):
    """Weights of e_y, e_y', e_psi, e_psi'; the steering's is 1."""

    weights: Annotated[tuple[NonNegative, NonNegative, NonNegative, NonNegative], Field(strict=False)]


class PurePursuitParameters(Model):
    """The point that is pursued."""

    look_ahead_s: Positive


class StanleyParameters(Model):
    """Gains of the lateral error of the front axle [1/s] and of the yaw rate's error [s]."""

    gain: Positive
    damping_s: NonNegative


class Laws(Model):
    """Parameters of every controller."""

    flow_paper: FlowParameters
    flow: FlowParameters
    mpc: MpcParameters
    lqr: LqrParameters
    pure_pursuit: PurePursuitParameters
    stanley: StanleyParameters
    speed_gain: Positive  # of LQR, pure pursuit and Stanley along the curve [1/s]


def build(key: Key, laws: Laws, problem: Problem, delay: int) -> Controller:
    """Return a controller that knows of a delay of whole control periods and rolls the state forward over it.

    Raises:
        MissingLibraryError: its library is not there.
    """
    if key in {"flow", "flow-paper"}:
        return Flow(problem, laws.flow if key == "flow" else laws.flow_paper, delay)
    controller = _predictive(key, laws.mpc, problem) or _geometric(key, laws, problem)
    return RollForward(controller, problem, delay) if delay else controller


def _geometric(key: Key, laws: Laws, problem: Problem) -> Controller:
    if key == "lqr":
        return CurvatureLqr(problem, laws.speed_gain, laws.lqr.weights)
    if key == "pure-pursuit":
        return PurePursuit(problem, laws.speed_gain, laws.pure_pursuit.look_ahead_s)
    return Stanley(problem, laws.speed_gain, laws.stanley.gain, laws.stanley.damping_s)


def _predictive(key: Key, mpc: MpcParameters, problem: Problem) -> Controller | None:
    weights = (mpc.acceleration_weight, mpc.steering_weight)
    given = problem, mpc.horizon_s, mpc.nodes
    controller: Controller | None = None
    if key == "osqp":
        controller = _module("mpc_osqp").OsqpMpc(*given, weights)
    elif key == "osqp-sharp":
        controller = _module("mpc_osqp").OsqpMpc(*given, tuple(mpc.sharp * weight for weight in weights))
        controller.name += " sharp"
    elif key == "do-mpc":
        controller = _module("mpc_dompc").DoMpc(*given, weights)
    elif key in {"ipopt", "fatrop"}:
        module = _module("mpc_casadi")
        if not module.has(key):
            raise MissingLibraryError(f"{key}: this casadi was built without it")
        controller = module.CasadiMpc(*given, weights, key)
    return controller


def _module(name: str) -> Any:
    try:
        return import_module(f"robofleet.experiments.baselines.{name}")
    except ModuleNotFoundError as missing:
        library = _LIBRARIES.get((missing.name or "").partition(".")[0])
        if library is None:
            raise
        raise MissingLibraryError(f"{library} is not installed: pip install -e '.[bench]'") from None

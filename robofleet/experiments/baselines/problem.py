"""What every controller of the comparison is given, and the closed loop that it is judged in."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robofleet.control.arrays import cached
from robofleet.core.arrays import Array
from robofleet.core.kernels import kernel
from robofleet.experiments.curves import Reference
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import BicycleParameters, Numbers

Input = tuple[float, float]  # a_l [m/s^2], delta_f [rad]

_derivative = cached(bicycle.derivative)
_ROLL_SUBSTEPS = 2  # of RK4 a control period, rolling forward: exact to 1e-7 m
_LOST_M = 3.0  # a vehicle this far from the reference's point has left its lane


@dataclass(frozen=True)
class Problem:
    """A reference whose point moves at ``speed``, and the vehicle that the controllers believe in."""

    model: BicycleParameters
    reference: Reference
    speed: float  # [m/s]
    step: float  # control period [s]
    plant_step: float  # of the plant's RK4 [s]
    max_acceleration: float  # |a_l| [m/s^2]
    max_steering: float  # |delta_f| [rad]

    def target(self, t: Array) -> Array:
        """Return r(t) (K, 2) [m; world] at the instants t (K,) [s]."""
        return self.reference.position(self.speed * t)

    def start(self) -> Array:
        """Return the state (6,) on the curve at s = 0, along it, at ``speed``."""
        x = np.zeros(6)
        x[:2], x[2], x[4] = self.reference.positions[0], self.speed, self.reference.headings[0]
        return x

    def limited(self, u: Input) -> Input:
        """Return what the actuators do: each input clipped to its limit."""
        a, d = self.max_acceleration, self.max_steering
        return min(max(u[0], -a), a), min(max(u[1], -d), d)

    def moved(self, x: Array, u: Input, vehicle: BicycleParameters) -> Array:
        """Return the state after one control period of constant input."""
        return advanced(x, u, vehicle.numbers(), self.plant_step, round(self.step / self.plant_step))


class Controller(Protocol):
    """A controller of the comparison; ``name`` as the tables print it."""

    name: str

    def update(self, t: float, x: Array) -> Input:
        """Return the input for the state x (6,) at t [s]; the input acts at t and is held for a control period."""


class RollForward:
    """Any controller behind a known delay: it is given the state and the time of when its input will act.

    The measured state is rolled forward over the delay with the inputs that are on their way and the believed model.
    """

    def __init__(self, controller: Controller, problem: Problem, delay: int) -> None:
        """``delay``: whole control periods."""
        self.name = controller.name
        self._controller, self._problem = controller, problem
        self._on_their_way: list[Input] = [(0.0, 0.0)] * delay
        self._p, self._substep = problem.model.numbers(), problem.step / _ROLL_SUBSTEPS

    @property
    def failures(self) -> int:
        """Updates in which its solver gave up."""
        return int(getattr(self._controller, "failures", 0))

    def update(self, t: float, x: Array) -> Input:
        """Return the input that acts ``delay`` control periods after t."""
        for u in self._on_their_way:
            x = advanced(x, u, self._p, self._substep, _ROLL_SUBSTEPS)
        u = self._controller.update(t + len(self._on_their_way) * self._problem.step, x)
        if self._on_their_way:
            self._on_their_way = [*self._on_their_way[1:], self._problem.limited(u)]
        return u


@dataclass(frozen=True)
class Conditions:
    """What is done to the loop."""

    plant: BicycleParameters
    delay: int = 0  # control periods from the measurement to the moment when the input acts
    position_noise: float = 0.0  # standard deviation of z1 and z2 as measured [m]
    seed: int = 0


@dataclass(frozen=True)
class Drive:
    """One drive, at the K control instants; ``failure`` is empty, or says why the drive ended early."""

    t: Array  # (K,) [s]
    states: Array  # (K, 6) true, before the update
    inputs: Array  # (K, 2) as they act
    lateral: Array  # (K,) [m], + to the left of the curve
    heading: Array  # (K,) [rad]
    step: float  # [s]
    failure: str

    @property
    def peak_lateral_cm(self) -> float:
        """Peak distance of the centre of gravity from the curve [cm]; nan if the vehicle was lost."""
        return float("nan") if self.failure else 100.0 * float(np.abs(self.lateral).max())

    @property
    def peak_heading_deg(self) -> float:
        """Peak of heading minus tangent [deg]; nan if the vehicle was lost."""
        return float("nan") if self.failure else float(np.degrees(np.abs(self.heading).max()))

    @property
    def peak_steering_rate_deg_s(self) -> float:
        """Peak change of the steering from one control period to the next, over the period [deg/s]; nan if lost."""
        if self.failure:
            return float("nan")
        return float(np.degrees(np.abs(np.diff(self.inputs[:, 1])).max()) / self.step)


def drive(problem: Problem, controller: Controller, conditions: Conditions, distance: float) -> Drive:
    """Drive until the reference's point is ``distance`` [m] along the curve, or the vehicle is lost."""
    count = round(distance / problem.speed / problem.step)
    noise = np.random.default_rng(conditions.seed).normal(0.0, 1.0, (count, 2)) * conditions.position_noise
    states = np.empty((count, 6))
    inputs: list[Input] = [(0.0, 0.0)] * conditions.delay
    x, k, failure = problem.start(), 0, ""
    for k in range(count):
        states[k] = x
        measured = x.copy()
        measured[:2] += noise[k]
        try:
            u = controller.update(k * problem.step, measured)
        except (ValueError, RuntimeError) as error:
            failure = f"at {k * problem.step:.2f} s: {error}"
            break
        inputs.append(problem.limited(u))
        x = problem.moved(x, inputs[k], conditions.plant)
        if failure := _lost(problem, x, (k + 1) * problem.step):
            break
    states, used = states[: k + 1], np.array(inputs[: k + 1])
    lateral, heading, _ = problem.reference.errors(states[:, :2], states[:, 4])
    t = np.asarray(problem.step * np.arange(k + 1), dtype=np.float64)
    return Drive(t, states, used, lateral, heading, problem.step, failure)


def _lost(problem: Problem, x: Array, t: float) -> str:
    """Return why the state is the end of a drive, or nothing."""
    if not np.isfinite(x).all():
        return f"at {t:.2f} s: the state is not finite"
    away = float(np.hypot(*(x[:2] - problem.target(np.array([t]))[0])))
    return f"at {t:.2f} s: {away:.1f} m from the reference's point" if away > _LOST_M else ""


@kernel
def advanced(x: Array, u: Input, p: Numbers, step: float, count: int) -> Array:
    """Return the state after ``count`` steps of RK4 with constant input."""
    held = np.array(u)
    for _ in range(count):
        k1 = _derivative(x, held, p)
        k2 = _derivative(x + 0.5 * step * k1, held, p)
        k3 = _derivative(x + 0.5 * step * k2, held, p)
        x = x + step / 6.0 * (k1 + 2.0 * (k2 + k3) + _derivative(x + step * k3, held, p))
    return x

"""Row 9: NR flow beside model-predictive control and the classic steering laws; same plant, reference and period."""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.config.parameters import Parameters
from robofleet.core.clock import stopwatch_ns
from robofleet.core.settings import Model, Positive
from robofleet.experiments.baselines.choice import Key, Laws, MissingLibraryError, build
from robofleet.experiments.baselines.problem import Conditions, Controller, Drive, Problem, drive
from robofleet.experiments.closed_curve import Track
from robofleet.experiments.curves import lane_change
from robofleet.experiments.driving import Speeds
from robofleet.experiments.results import Array, Result
from robofleet.vehicles.bicycle import FALCONE_2007, ZHOU_2017

KNOWS_NO_DELAY: Key = "flow-paper"  # its law, as printed, has no roll-forward: nominally it drives without
_SAME_CODE: dict[Key, Key] = {"flow-paper": "flow", "osqp-sharp": "osqp"}
Delays = Annotated[tuple[Positive, ...], Field(strict=False)]


class Limits(Model):
    """Of both inputs."""

    acceleration_m_s2: Positive
    steering_rad: Positive


class Trouble(Model):
    """What is done to the loop, one thing at a time."""

    speed_m_s: Positive
    delays_s: Delays
    position_noise_m: Positive
    stiffness: Positive
    seed: Annotated[int, Field(ge=0)]
    left_out: Annotated[tuple[Key, ...], Field(strict=False)]  # too slow, and like another one


class ClosedCurve(Model):
    """The first ``drive_m`` of the track."""

    speed_km_h: Positive
    drive_m: Positive
    track: Track


class ComparisonParameters(Parameters):
    """``configs/paper/comparison.yaml``."""

    controllers: Annotated[tuple[Key, ...], Field(min_length=1, strict=False)]
    speeds_m_s: Speeds
    drive_m: Positive
    curve_length_m: Positive
    control_step_s: Positive
    plant_step_s: Positive
    computing_delay_s: Positive
    limits: Limits
    turn: Annotated[int, Field(ge=2)]
    laws: Laws
    trouble: Trouble
    closed_curve: ClosedCurve

    def complaints(self) -> Iterator[Complaint]:
        """Steps that do not divide; no flow to compare with; a curve that ends before the predictions do."""
        step = self.control_step_s
        if "flow" in self.trouble.left_out:
            yield "trouble.left_out", "must not contain flow: the others are compared with it"
        if "flow" not in self.controllers:
            yield "controllers", "must contain flow: the others are compared with it"
        for key, value, unit in (
            ("control_step_s", step, self.plant_step_s),
            ("computing_delay_s", self.computing_delay_s, step),
            *((f"trouble.delays_s.{k}", delay, step) for k, delay in enumerate(self.trouble.delays_s)),
        ):
            if abs(value / unit - round(value / unit)) > 1e-6:
                yield key, f"must be a whole multiple of {unit:g}, not {value:g}"
        laws, fastest = self.laws, max(*self.speeds_m_s, self.trouble.speed_m_s)
        ahead = max(laws.mpc.horizon_s, laws.flow.horizon_s, laws.flow_paper.horizon_s)
        ahead += max(self.computing_delay_s, *self.trouble.delays_s, 0.0) + step
        if self.curve_length_m < (needed := self.drive_m + fastest * ahead):
            yield "curve_length_m", f"must be at least {needed:.0f}: drive_m and what is predicted at {fastest:g} m/s"

    def lane_change(self, speed: float) -> Problem:
        """Return the lane change at a speed [m/s]."""
        reference = lane_change(1.0, self.curve_length_m)
        limits = self.limits.acceleration_m_s2, self.limits.steering_rad
        return Problem(FALCONE_2007, reference, speed, self.control_step_s, self.plant_step_s, *limits)

    def corner(self) -> Problem:
        """Return the drive on the closed curve."""
        track, speed = self.closed_curve.track.reference(), self.closed_curve.speed_km_h / 3.6
        return dataclasses.replace(self.lane_change(speed), model=ZHOU_2017, reference=track)

    def samples(self, delay: float) -> int:
        """Return a delay [s] in control periods."""
        return round(delay / self.control_step_s)


@dataclass(frozen=True)
class Updates:
    """Durations of one controller's updates through its Python API [us]."""

    warm: Array  # just after another of its own
    first: Array  # just after other controllers', which have the processor's caches

    @property
    def p50(self) -> float:
        """Median of the warm ones."""
        return float(np.median(self.warm))


@dataclass(frozen=True)
class Troubled:
    """Drives with one thing wrong."""

    delayed: tuple[tuple[Drive, Drive], ...]  # one a delay: not told of it, rolled forward over it
    noisy: Drive
    soft: Drive  # tyres less stiff than believed


@dataclass(frozen=True)
class Compared:
    """Everything measured of one controller."""

    name: str
    cold_ms: float | None  # building it and its first update; None: its code was there already
    lane_change: tuple[Drive, ...]  # one a speed
    corner: Drive
    troubled: Troubled | None  # None: left out
    failures: int  # updates of the undisturbed lane changes whose solver gave up
    updates: Updates | None = None  # on one sequence of states, in turns with the others


def run(parameters: ComparisonParameters) -> Result:
    """Drive with every controller whose library is there, time them, and say which is better at what."""
    from robofleet.experiments.comparison_views import figures, tables  # noqa: PLC0415 - it knows Compared

    _warm(parameters.lane_change(parameters.speeds_m_s[0]))
    missing: dict[Key, str] = {}
    found: dict[Key, Compared] = {}
    for key in parameters.controllers:
        try:
            cold_ms: float | None = _cold(key, parameters)
        except MissingLibraryError as error:
            missing[key] = str(error)
        else:
            found[key] = _compared(key, parameters, None if _SAME_CODE.get(key) in found else cold_ms)
    times = _timed(list(found), parameters, found["flow"])
    found = {key: dataclasses.replace(result, updates=times[key]) for key, result in found.items()}
    return Result(tables(parameters, found, missing), figures(parameters, found), {"missing": missing})


def in_turns(controllers: Sequence[Controller], times: Array, states: Array, turn: int) -> list[Updates]:
    """Time updates on the same K states: in turns of ``turn`` calls, so that all share a busy machine.

    Each controller's first turn is left out.
    """
    durations = np.empty((len(controllers), len(times) // turn, turn))
    for j in range(durations.shape[1]):
        for i, controller in enumerate(controllers):
            for k in range(turn):
                t, x = float(times[j * turn + k]), states[j * turn + k]
                started = stopwatch_ns()
                controller.update(t, x)
                durations[i, j, k] = (stopwatch_ns() - started) / 1e3
    return [Updates(found[1:, 1:].ravel(), found[1:, 0]) for found in durations]


def _warm(problem: Problem) -> None:
    """Compile what the loop itself needs, so that it is not counted against the first controller."""
    x = problem.start()
    problem.moved(x, (0.0, 0.0), problem.model)
    problem.reference.errors(x[None, :2], x[4:5])
    problem.target(np.zeros(1))


def _cold(key: Key, parameters: ComparisonParameters) -> float:
    problem = parameters.lane_change(parameters.speeds_m_s[0])
    started = stopwatch_ns()
    build(key, parameters.laws, problem, 0).update(0.0, problem.start())
    return (stopwatch_ns() - started) / 1e6


def _compared(key: Key, parameters: ComparisonParameters, cold_ms: float | None) -> Compared:
    laws, trouble, failures = parameters.laws, parameters.trouble, 0
    sample = parameters.samples(parameters.computing_delay_s)
    assumed = 0 if key == KNOWS_NO_DELAY else sample

    def driven(
        problem: Problem, known: int = assumed, delay: int = sample, noise: float = 0.0, stiffness: float = 1.0
    ) -> Drive:
        nonlocal failures
        model = problem.model
        soft = dataclasses.replace(
            model, front_stiffness=stiffness * model.front_stiffness, rear_stiffness=stiffness * model.rear_stiffness
        )
        distance = parameters.drive_m if model == FALCONE_2007 else parameters.closed_curve.drive_m
        controller = build(key, laws, problem, known)
        result = drive(problem, controller, Conditions(soft, delay, noise, trouble.seed), distance)
        failures += getattr(controller, "failures", 0)
        return result

    nominal = tuple(driven(parameters.lane_change(speed)) for speed in parameters.speeds_m_s)
    gave_up = failures
    hard = parameters.lane_change(trouble.speed_m_s)
    delays = [parameters.samples(delay) for delay in trouble.delays_s]
    troubled = None
    if key not in trouble.left_out:
        troubled = Troubled(
            tuple((driven(hard, 0, delay), driven(hard, delay, delay)) for delay in delays),
            driven(hard, noise=trouble.position_noise_m),
            driven(hard, stiffness=trouble.stiffness),
        )
    name = build(key, laws, hard, 0).name
    return Compared(name, cold_ms, nominal, driven(parameters.corner()), troubled, gave_up)


def _timed(keys: list[Key], parameters: ComparisonParameters, flow: Compared) -> dict[Key, Updates]:
    """Time all on the states of the flow's fastest lane change, none rolling forward."""
    fastest = int(np.argmax(parameters.speeds_m_s))
    problem, states = parameters.lane_change(parameters.speeds_m_s[fastest]), flow.lane_change[fastest]
    controllers = [build(key, parameters.laws, problem, 0) for key in keys]
    return dict(zip(keys, in_turns(controllers, states.t, states.states, parameters.turn), strict=True))

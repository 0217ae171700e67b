"""Row 9: NR flow beside model-predictive control and the classic steering laws; same plant, reference and period."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.clock import stopwatch_ns
from robofleet.experiments.baselines.choice import Key, MissingLibraryError, build
from robofleet.experiments.baselines.problem import Conditions, Controller, Drive, Problem, drive
from robofleet.experiments.comparison_results import (
    CORNER,
    NOISE,
    ROLLED,
    SOFT_TYRES,
    Compared,
    ComparisonParameters,
    Updates,
)
from robofleet.experiments.comparison_views import figures, tables
from robofleet.experiments.results import Result
from robofleet.vehicles.bicycle import FALCONE_2007

KNOWS_NO_DELAY: Key = "flow-paper"  # its law, as printed, has no roll-forward: nominally it drives without
_SAME_CODE: dict[Key, Key] = {"flow-paper": "flow", "osqp-sharp": "osqp"}


def run(parameters: ComparisonParameters) -> Result:
    """Drive with every controller whose library is there, time them, and say which is better at what."""
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

    drives = {name: driven(parameters.lane_change(speed)) for name, speed in parameters.lane_changes.items()}
    gave_up = failures
    hard = parameters.lane_change(trouble.speed_m_s)
    if key not in trouble.left_out:
        for name, delay in parameters.delays.items():
            drives[name], drives[name + ROLLED] = driven(hard, 0, delay), driven(hard, delay, delay)
        drives[NOISE] = driven(hard, noise=trouble.position_noise_m)
        drives[SOFT_TYRES] = driven(hard, stiffness=trouble.stiffness)
    drives[CORNER] = driven(parameters.corner())
    return Compared(build(key, laws, hard, 0).name, cold_ms, drives, gave_up)


def _timed(keys: list[Key], parameters: ComparisonParameters, flow: Compared) -> dict[Key, Updates]:
    """Time all on the states of the flow's fastest lane change, none rolling forward."""
    problem, states = parameters.lane_change(max(parameters.speeds_m_s)), flow.drives[parameters.fastest]
    controllers = [build(key, parameters.laws, problem, 0) for key in keys]
    return dict(zip(keys, in_turns(controllers, states.t, states.states, parameters.turn), strict=True))

"""A run is judged by the bounds of its configuration, figure by figure; what was not measured has not met one."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.config.load import load_config
from robofleet.config.tree import Bounds
from robofleet.recording.run import Recording
from robofleet.reports.bounds import JUDGED, complaints, failures, judged
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from tests.shipped import PLATOON

Make = Callable[..., Any]
NO_BOUNDS = "run.bounds={}"


def verdicts(figures: dict[str, Any]) -> dict[str, bool]:
    return {bound["figure"]: bound["pass"] for bound in figures["bounds"]}


def test_every_bound_of_the_configuration_has_its_figure(story: Make, figures: Make) -> None:
    assert set(JUDGED) == set(Bounds.model_fields)
    obstacle = "arena.obstacles=[{circle: {x_m: 0.0, y_m: 0.0, radius_m: 0.1}}]"
    measured = figures(story(obstacle).recording())
    latency = {"exposure_to_wheel": {"p50": 18.0, "p99": 21.0, "max": 40.0}, "stages": {}}
    measured |= {"latency_ms": latency, "gap": {"worst": 1.1}}  # these are measured later, or in real time
    values = {name: figure.value_of(measured) for name, figure in JUDGED.items()}
    assert values["exposure_to_wheel_p99_ms"] == 21.0
    assert None not in values.values()


@pytest.mark.parametrize(("error_mm", "met"), [(0.9, True), (1.0, True), (1.1, False)])
def test_an_error_may_reach_its_bound_and_not_pass_it(story: Make, figures: Make, error_mm: float, met: bool) -> None:
    run = story("run.bounds={control_error_mean_mm: 1.0}")
    run.control_error[:] = error_mm * 1e-3
    (bound,) = figures(run.recording())["bounds"]
    assert bound == {"figure": "control_error_mean_mm", "value": pytest.approx(error_mm), "limit": 1.0, "pass": met}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("off_mm", [-1.0, 0.0, 1.0])
def test_the_gap_of_bodies_must_be_at_least_its_bound(story: Make, figures: Make, off_mm: float) -> None:
    gap = figures(story(NO_BOUNDS).recording())["min_gap_mm"]
    run = story(f"run.bounds={{min_gap_mm: {gap + off_mm}}}")
    assert verdicts(figures(run.recording())) == {"min_gap_mm": off_mm <= 0}


@pytest.mark.parametrize(("late", "met"), [(0, False), (1, True)])
def test_the_timed_error_that_counts_is_the_leaders(story: Make, figures: Make, late: int, met: bool) -> None:
    run = story("run.bounds={timed_error_mean_mm: 4}")
    run.place([0.008 if row == late else 0.0 for row in range(4)])
    assert verdicts(figures(run.recording())) == {"timed_error_mean_mm": met}


def test_what_was_not_measured_has_not_met_its_bound(story: Make, figures: Make) -> None:
    run = story("run.bounds.overruns=30")
    verdict_of = verdicts(figures(run.recording()))
    assert set(verdict_of.values()) == {True}
    blind = figures(run.recording(truth=False))
    not_measured = {"timed_error_mean_mm", "path_error_mean_mm", "min_gap_mm", "pose_error_rms_mm"}
    assert {name for name, met in verdicts(blind).items() if not met} == not_measured
    assert all("not measured" in line for line in failures(blind))
    nothing = figures(Recording(story().config))
    assert set(verdicts(nothing)) == set(verdict_of)
    assert set(verdicts(nothing).values()) == {False}


def test_a_run_that_was_aborted_is_judged_by_what_was_measured(story: Make, figures: Make) -> None:
    run = story("run.bounds.overruns=30")
    run.control_error[:] = 0.0025
    aborted = figures(run.recording(truth=False)) | {"outcome": "fault"}
    assert failures(aborted) == ["control error, mean: 2.5 mm; limit 1 mm"]
    missed, rest = complaints(aborted)
    assert missed == "bound not met: control error, mean: 2.5 mm; limit 1 mm"
    assert rest == "4 of 8 limits were not checked: the run ended too early."
    assert len(complaints(aborted | {"outcome": "completed"})) == 5
    nothing = figures(Recording(run.config)) | {"outcome": "stopped"}
    assert complaints(nothing) == ["No limit was checked: the robots never drove."]


def test_without_bounds_nothing_is_judged(story: Make, figures: Make) -> None:
    assert figures(story(NO_BOUNDS).recording())["bounds"] == []
    assert judged({}, Bounds()) == []


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_lap_of_the_shipped_platoon_meets_its_bounds(seed: int) -> None:
    run = Lockstep(load_config(PLATOON, [f"run.seed={seed}"]))
    outcome, cause = run.run()
    figures = summary(run.recording, name="platoon", mode="lockstep", outcome=outcome, cause=cause)
    assert len(figures["bounds"]) == 8
    assert failures(figures) == []

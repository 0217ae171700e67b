"""Every stop has a cause in words: the run's, the robot's own, or the gate's where nobody said more."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.recording.causes import cause, named
from robofleet.recording.run import Recording
from robofleet.reports.bounds import JUDGED
from robofleet.reports.stops import fleet_stops, how_many
from robofleet.safety.latches import GateStatus
from robofleet.safety.supervisor import Event, Phase

Make = Callable[..., Any]
RUNNING = Phase.RUNNING, Event.PROVED


@pytest.fixture
def stops_of(story: Make, figures: Make, add_status: Make, add_state: Make) -> Callable[..., list[dict[str, Any]]]:
    """Return the stops of a run in which r1's gate closes at tick 100, and things are said before and after."""

    def stops(
        before: tuple[Any, ...] = RUNNING, *, after: tuple[Any, ...] = RUNNING, after_ticks: int = 10, ticks: int = 300,
        gate: GateStatus = GateStatus.NO_ENABLE,
    ) -> list[dict[str, Any]]:  # fmt: skip
        run = story(ticks=ticks)
        recording = run.recording()
        add_state(recording, *RUNNING)
        add_status(recording, "r1", run.stamp(98), output=3.0)
        add_state(recording, *before)
        add_status(recording, "r1", run.stamp(100), gate=gate, after_ms=(21, 300), output=1.0)
        for k in range(101, 100 + after_ticks):
            add_status(recording, "r1", run.stamp(k), gate=gate, after_ms=(21, 47))
        add_state(recording, *after)
        for k in range(100 + after_ticks, 160):
            add_status(recording, "r1", run.stamp(k), gate=gate, after_ms=(21, 47))
        found: list[dict[str, Any]] = figures(recording)["stops"]
        return found

    return stops


def causes(stops: list[dict[str, Any]]) -> list[str]:
    return [stop["cause"] for stop in stops]


def test_a_stop_that_the_supervisor_ordered_has_the_runs_cause(stops_of: Make) -> None:
    (stop,) = stops_of((Phase.HOLD, Event.POSE_JUMPED, 2))
    assert stop == {
        "t_s": pytest.approx(100 * 0.033), "run_time_s": pytest.approx(100 * 0.033),
        "clock_time_s": pytest.approx(100 * 0.033), "robot": "r1", "cause": "no enable: r3: it was moved by hand",
        "by_operator": False, "target_ms": 21.0, "output_ms": 47.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("phase", "event", "requested_event"),
    [(Phase.HOLD, Event.HOLD_REQUESTED, True), (Phase.ESTOP, Event.ESTOP_REQUESTED, True),
     (Phase.ESTOP, Event.STOPPED_AT_GATE, True), (Phase.ESTOP, Event.OPERATOR_LOST, False),
     (Phase.HOLD, Event.CAMERA_STALLED, False)],
)  # fmt: skip
def test_what_the_operator_asked_for_is_no_stop_by_itself(
    stops_of: Make, phase: Phase, event: Event, requested_event: bool
) -> None:
    (stop,) = stops_of((phase, event))
    assert stop["by_operator"] is requested_event
    figures = {"stops": [stop], "ticks": 300}
    assert JUDGED["stops"].value_of(figures) == (0 if requested_event else 1)


def test_a_robot_that_stands_alone_has_its_own_cause(stops_of: Make) -> None:
    assert causes(stops_of((*RUNNING, 0xFFFF, (Event.TAG_LATE, 0, 0, 0)))) == ["no enable: it is not seen"]
    assert causes(stops_of((*RUNNING, 0xFFFF, (0, Event.TAG_LATE, 0, 0)))) == ["no enable"], "that was another robot"


def test_a_gate_that_closed_by_itself_has_the_cause_that_is_found_within_a_second(stops_of: Make) -> None:
    silent = (Phase.FAULT, Event.CONTROLLER_SILENT)
    why = "no command: the controller went silent"
    assert causes(stops_of(after=silent, after_ticks=20, gate=GateStatus.NO_COMMAND)) == [why]
    assert causes(stops_of(after=silent, after_ticks=40, gate=GateStatus.NO_COMMAND)) == ["no command"]


def test_what_an_operator_asks_for_later_closed_no_gate_before(stops_of: Make) -> None:
    estop = (Phase.ESTOP, Event.ESTOP_REQUESTED)
    assert causes(stops_of(after=estop, after_ticks=2)) == ["no enable: emergency stop requested"]
    assert causes(stops_of(after=estop, after_ticks=10)) == ["no enable"]


def test_a_fault_at_the_end_of_a_run_is_a_stop_and_a_controlled_stop_is_none(stops_of: Make) -> None:
    """The controller counts no tick of the run any more when the gates close."""
    assert causes(stops_of((Phase.FAULT, Event.TAG_LOST, 1), ticks=99)) == ["no enable: r2: the tracker lost the robot"]
    assert stops_of((Phase.IDLE, Event.STOP_REQUESTED), ticks=99) == []
    assert stops_of(after=(Phase.IDLE, Event.STOP_REQUESTED), after_ticks=2, ticks=99) == []


def test_a_figure_that_is_of_another_stop_is_none(story: Make, figures: Make, add_status: Make) -> None:
    run = story()
    recording = run.recording()
    add_status(recording, "r1", run.stamp(10), after_ms=(15, 30))
    add_status(recording, "r1", run.stamp(11), gate=GateStatus.NO_COMMAND, after_ms=(120, 30))  # it stood already
    (stop,) = figures(recording)["stops"]
    assert (stop["target_ms"], stop["output_ms"]) == (120.0, None)


def test_values_of_another_version_break_nothing(stops_of: Make, story: Make, figures: Make) -> None:
    assert causes(stops_of((9, 999))) == ["no enable: a cause that is not known here (999)"]
    assert named(GateStatus, 77) == "unknown (77)"
    assert cause(Event.TOO_CLOSE, 0, 1.0, ("r1", "r2")) == "r1: it is too close to r2"
    assert figures(Recording(story().config))["stops"] == []


def test_what_stops_together_for_one_cause_is_one_stop_of_the_fleet() -> None:
    def stop(
        robot: str, clock_s: float, cause: str = "no enable: hold", output_ms: float | None = None
    ) -> dict[str, Any]:
        times = {"t_s": clock_s, "clock_time_s": clock_s, "run_time_s": min(clock_s, 20.7)}
        return times | {
            "robot": robot, "cause": cause, "by_operator": False, "target_ms": None, "output_ms": output_ms,
        }  # fmt: skip

    robots = [f"r{k}" for k in range(1, 5)]
    stops = [stop(robot, 20.7 + 0.01 * k, output_ms=10.0 * k) for k, robot in enumerate(robots)]
    stops += [
        stop("r2", 20.8, "a flat battery"),
        stop("r2", 20.9, "a flat battery"),
        *(stop(robot, 26.7) for robot in robots),
    ]
    found = fleet_stops(stops)
    assert [(own.robots, own.output_ms) for own in found] == [
        (tuple(robots), 30.0),
        (("r2",), None),
        (tuple(robots), None),
    ]
    assert str(found[0]) == "r1, r2, r3, r4 at 20.7 s run time: hold (standing after 30 ms)"
    assert str(found[2]) == "r1, r2, r3, r4 at 20.7 s run time (26.7 s clock time): hold"
    assert how_many(found) == "3 unrequested stops (10 counting each robot)"
    assert how_many(fleet_stops(stops[:1])) == "1 unrequested stop"
    many = fleet_stops([stop(f"r{k}", 1.0) for k in range(100)])
    assert str(many[0]).startswith("r0, r1, r2, r3, r4, r5, r6, r7 and 92 more at 1.0 s run time")

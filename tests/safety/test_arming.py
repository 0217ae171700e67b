"""Arming lets a healthy fleet start, and refuses every other one by name."""

import math
from collections.abc import Callable

import pytest

from robofleet.safety import arming
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.wiggle import room_m
from tests.safety.arming_lab import MS, PROVED, Alter, Lab, S, one
from tests.safety.arming_scenarios import HEALTHY, REFUSED, Scenario

WIRINGS = {
    "swapped": Event.WHEELS_SWAPPED,
    "left_reversed": Event.LEFT_REVERSED,
    "right_reversed": Event.RIGHT_REVERSED,
    "both_reversed": Event.BOTH_REVERSED,
}


@pytest.mark.parametrize("prepare", HEALTHY.values(), ids=HEALTHY)
def test_a_healthy_fleet_is_proved(prepare: Callable[[Lab], None]) -> None:
    lab = Lab(3)
    prepare(lab)
    assert lab.arm() == PROVED
    assert lab.state.stage is Stage.DONE


@pytest.mark.parametrize("scenario", REFUSED.values(), ids=REFUSED)
def test_what_is_wrong_is_named(scenario: Scenario) -> None:
    lab = Lab(3)
    scenario.prepare(lab)
    happening = lab.arm()
    assert happening is not None
    assert (happening.event, happening.robot) == (scenario.event, scenario.robot)
    assert scenario.detail is None or happening.detail == scenario.detail
    early, late = scenario.between_s
    assert early <= (lab.now_ns - S) / S <= late


@pytest.mark.parametrize("encoders", [True, False])
@pytest.mark.parametrize(("wiring", "event"), WIRINGS.items())
@pytest.mark.parametrize("seed", [1, 2])
def test_a_faulty_wiring_is_named_after_one_stroke(wiring: str, event: Event, seed: int, encoders: bool) -> None:
    lab = Lab(3, seed, {1: {"wiring": wiring}})
    lab.silent_encoders = not encoders
    happening = lab.arm()
    assert happening is not None
    assert (happening.event, happening.robot) == (event, 1)
    assert max(stroke for _, probed, stroke in lab.stages if probed == 1) == 1


@pytest.mark.parametrize("error", [0.2, -0.2, 1 / 1.2 - 1])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_wheel_radius_that_is_a_fifth_off_is_found(error: float, seed: int) -> None:
    happening = Lab(3, seed, {2: {"wheel_gain_error": error}}).arm()
    assert happening is not None
    assert (happening.event, happening.robot) == (Event.WRONG_GAIN, 2)
    assert happening.detail == pytest.approx(1 + error, abs=0.07)


def test_without_encoders_what_was_asked_stands_for_them() -> None:
    lab = Lab(2, faults={1: {"wheel_gain_error": -0.3}})
    lab.silent_encoders = True
    happening = lab.arm()
    assert happening is not None
    assert (happening.event, happening.robot) == (Event.WRONG_GAIN, 1)


def test_robots_that_cannot_tell_whether_they_rest_are_given_time() -> None:
    lab = Lab(2, faults={row: {"motor_lag": 0.12} for row in range(2)})
    lab.silent_encoders = True
    assert lab.arm() == PROVED


@pytest.mark.parametrize("robots", [1, 4, 20])
def test_a_robot_takes_one_and_a_half_seconds_and_stands_about_where_it_stood(robots: int) -> None:
    lab = Lab(robots)
    before = [plant.truth() for plant in lab.plants]
    assert lab.arm() == PROVED
    assert (lab.now_ns - S) / S <= 0.4 + 1.5 * robots
    for old, plant in zip(before, lab.plants, strict=True):
        now = plant.truth()
        assert math.hypot(now.x - old.x, now.y - old.y) < 0.008
        assert abs(math.remainder(now.psi - old.psi, math.tau)) < 0.04


def test_one_robot_at_a_time_goes_forth_and_back_and_stands_between() -> None:
    lab = Lab(2)
    lab.arm()
    a_robot = [1, 0, 2, 0]
    wiggled = [(probed, stroke) for stage, probed, stroke in lab.stages if stage is Stage.WIGGLE and probed != NOBODY]
    assert wiggled == [(0, stroke) for stroke in a_robot] + [(1, stroke) for stroke in a_robot]


@pytest.mark.parametrize("wiring", ["straight", *WIRINGS])
def test_nobody_leaves_the_room_that_the_checks_leave_it(wiring: str) -> None:
    """Wheels that go on for ever, whatever way they go, are stopped within the 53 mm that were kept free."""
    lab = Lab(2, faults={0: {"wiring": wiring}})
    lab.runaway = {0}
    start = lab.plants[0].truth()
    furthest = 0.0
    while (happening := lab.run(0.01)) is None:
        now = lab.plants[0].truth()
        furthest = max(furthest, math.hypot(now.x - start.x, now.y - start.y))
    spins = wiring in ("left_reversed", "right_reversed")  # and gets nowhere: it is refused because it does not rest
    assert (happening.event, happening.robot) == (Event.NOT_AT_REST if spins else Event.WRONG_GAIN, 0)
    assert furthest < 0.053


def test_three_images_of_a_robot_at_rest_are_looked_at_before_the_next_stroke() -> None:
    """However often the supervisor looks."""
    lab = Lab(2)
    lab.period_ns = 10 * MS
    lab.run(10.0, done=lambda state: state.wiggle.rest_tick is not None and state.probed == 0)
    at_rest = lab.view.image
    lab.run(10.0, done=lambda state: state.stroke == 2)
    assert lab.view.image >= at_rest + 3


def test_a_proved_fleet_is_asked_for_nothing() -> None:
    lab = Lab(2)
    lab.start = False
    lab.run(20.0, done=lambda state: state.stage is Stage.DONE)
    assert (lab.state.probed, lab.state.stroke, lab.state.latch, lab.state.clear) == (NOBODY, 0, 0, False)
    assert lab.run(0.5) is None


def test_a_proved_fleet_waits_for_its_start_and_not_for_ever() -> None:
    lab = Lab(1)
    lab.start = False
    assert lab.run(20.0, done=lambda state: state.stage is Stage.DONE) is None
    done_ns = lab.now_ns
    assert lab.run(59.9) is None
    assert lab.run(1.0) == Happening(Event.NOT_STARTED)
    assert lab.now_ns - done_ns == 60 * S
    lab.state, lab.start = lab.state._replace(since_ns=lab.now_ns), True
    assert lab.run(1.0) == PROVED


def test_a_proved_fleet_does_not_wait_with_what_is_wrong_for_good() -> None:
    lab = Lab(2)
    lab.start = False
    assert lab.run(20.0, done=lambda state: state.stage is Stage.DONE) is None
    lab.alter = one(1, faults=4)
    assert lab.run(1.0) == Happening(Event.CLIFF, 1)


@pytest.mark.parametrize(
    ("alter", "unready"),
    [
        (lambda view: view, None),
        (one(1, unseen_ns=150 * MS), Happening(Event.TAG_LOST, 1)),
        (one(1, left_speed=0.2), Happening(Event.NOT_AT_REST, 1)),
        (one(1, session=0), Happening(Event.LEASE_LOST, 1)),
        (one(1, pose=(9.0, 0.0, 0.0)), Happening(Event.OUTSIDE_ARENA, 1)),
        (lambda view: view._replace(tracker_ns=view.now_ns - S), Happening(Event.TRACKER_SILENT)),
    ],
)
def test_a_proved_fleet_is_started_only_while_it_is_ready(alter: Alter, unready: Happening | None) -> None:
    lab = Lab(2)
    lab.arm()
    assert arming.unready(lab.settings, alter(lab.view._replace(now_ns=lab.now_ns))) == unready


@pytest.mark.parametrize(
    ("hindered", "reached", "patience_ns"),
    [("deaf", lambda state: bool(state.latch), 200 * MS), ("stubborn", lambda state: state.clear, S)],
)
def test_a_drill_that_is_not_answered_ends_it_after_its_time(
    hindered: str, reached: Callable[[ArmingState], bool], patience_ns: int
) -> None:
    lab = Lab(2)
    setattr(lab, hindered, {1})
    lab.run(1.0, done=reached)
    began_ns = lab.now_ns
    assert lab.arm() is not None
    assert lab.now_ns - began_ns == patience_ns


def test_every_stage_tells_when_it_began() -> None:
    lab = Lab(1)
    for stage in Stage:
        lab.run(10.0, done=lambda state, stage=stage: state.stage is stage)  # type: ignore[misc]
        assert lab.state.stage is stage
        assert lab.state.since_ns == lab.now_ns


FREE_M = 0.01 + room_m(0.016)  # a centimetre more than a wiggle may take


@pytest.mark.parametrize(
    ("body_m", "arena_m", "apart_m", "event"),
    [
        (0.0, (2 * FREE_M, 2 * FREE_M), None, None),
        (0.0, (2 * FREE_M - 1e-6, 9.0), None, Event.TOO_CLOSE),
        (0.25, (0.5, 9.0), None, Event.TOO_CLOSE),  # it touches the wall and is inside
        (0.25, (0.499, 9.0), None, Event.OUTSIDE_ARENA),
        (0.0, (9.0, 9.0), FREE_M, None),
        (0.0, (9.0, 9.0), FREE_M - 1e-6, Event.TOO_CLOSE),
    ],
)
def test_room_is_just_enough_or_not(
    body_m: float, arena_m: tuple[float, float], apart_m: float | None, event: Event | None
) -> None:
    lab = Lab(1 if apart_m is None else 2)
    robots = len(lab.plants)
    lab.settings = lab.settings._replace(body_radius=(body_m,) * robots, arena=arena_m)
    lab.alter = one(0, pose=(0.0, 0.0, 0.0)) if apart_m is None else in_line(apart_m)
    happening = lab.run(10.0, done=lambda state: state.stage is Stage.DRILL)
    assert (None if happening is None else happening.event) is event


def in_line(apart_m: float) -> Alter:
    return lambda view: one(1, pose=(0.0, apart_m, 0.0))(one(0, pose=(0.0, 0.0, 0.0))(view))


def test_the_drill_is_asked_of_all_and_taken_back() -> None:
    lab = Lab(3)
    lab.run(1.0, done=lambda state: bool(state.latch))
    assert not any(robot.latch for robot in lab.view.robots)
    lab.run(1.0, done=lambda state: state.clear)
    assert all(robot.latch for robot in lab.view.robots)
    lab.run(1.0, done=lambda state: state.stage is Stage.WIGGLE)
    assert not any(robot.latch for robot in lab.view.robots)

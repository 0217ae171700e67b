"""Arming lets a healthy fleet start, and refuses every other one by name."""

import math
from collections.abc import Callable

import pytest

from robofleet.safety import arming
from robofleet.safety.arming import ArmingSettings, ArmingState, Stage
from robofleet.safety.distances import least_room_m, room_m
from robofleet.safety.latches import Latch
from robofleet.safety.starts import Reason
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import FleetView, RobotView
from robofleet.safety.wiggle import BACK, FORTH, LEFT, RIGHT, STAND
from robofleet.vehicles.interface import RobotFault
from robofleet.vehicles.solids import Solid
from tests.safety.arming_lab import BODY_M, MS, PROVED, Alter, Lab, S, one
from tests.safety.arming_scenarios import HEALTHY, REFUSED, Scenario

WIRINGS = {
    "swapped": Event.WHEELS_SWAPPED,
    "left_reversed": Event.LEFT_REVERSED,
    "right_reversed": Event.RIGHT_REVERSED,
    "both_reversed": Event.BOTH_REVERSED,
}


@pytest.mark.slow_after_first
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
    assert max(strokes[1] for _, strokes in lab.stages if strokes) == FORTH


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


@pytest.mark.parametrize(
    ("robots", "within_s"), [(1, 2.0), (4, 4.0), (20, 8.0), pytest.param(100, 20.0, marks=pytest.mark.slow)]
)
def test_a_fleet_is_proved_in_time_and_stands_about_where_it_stood(robots: int, within_s: float) -> None:
    lab = Lab(robots)
    before = [plant.truth() for plant in lab.plants]
    assert lab.arm() == PROVED
    assert (lab.now_ns - S) / S <= within_s
    for old, plant in zip(before, lab.plants, strict=True):
        now = plant.truth()
        assert math.hypot(now.x - old.x, now.y - old.y) < 0.008
        assert abs(math.remainder(now.psi - old.psi, math.tau)) < 0.04


def test_robots_go_forth_and_back_in_rounds_of_their_own_and_stand_between() -> None:
    lab = Lab(3)
    lab.arm()
    strokes = [strokes for stage, strokes in lab.stages if stage is Stage.WIGGLE]
    still = (0, 0, 0)
    assert strokes == [still, (1, 0, 1), still, (2, 1, 0), still, (0, 2, 2), still]


@pytest.mark.parametrize("wiring", ["straight", *WIRINGS])
def test_nobody_leaves_the_room_that_the_checks_leave_it(wiring: str) -> None:
    """Wheels that go on for ever, whatever way they go, are stopped within the 43 mm that were kept free."""
    lab = Lab(2, faults={0: {"wiring": wiring}})
    lab.runaway = {0}
    start = lab.plants[0].truth()
    furthest = 0.0
    while (happening := lab.run(0.01)) is None:
        now = lab.plants[0].truth()
        furthest = max(furthest, math.hypot(now.x - start.x, now.y - start.y))
    spins = wiring in ("left_reversed", "right_reversed")  # and gets nowhere: it is refused because it does not rest
    assert (happening.event, happening.robot) == (Event.NOT_AT_REST if spins else Event.WRONG_GAIN, 0)
    assert furthest < room_m(0.016)


def test_three_images_of_a_robot_at_rest_are_looked_at_before_the_next_stroke() -> None:
    """However often the supervisor looks."""
    lab = Lab(2)
    lab.period_ns = 10 * MS
    lab.run(10.0, done=lambda state: state.wiggle.rest_tick is not None and 0 in state.wiggle.tried)
    at_rest = lab.view.image
    lab.run(10.0, done=lambda state: state.stroke(0) == BACK)
    assert lab.view.image >= at_rest + 3


def test_a_proved_fleet_is_asked_for_nothing() -> None:
    lab = Lab(2)
    lab.start = False
    lab.run(20.0, done=lambda state: state.stage is Stage.DONE)
    assert (lab.state.stroke(0), lab.state.stroke(1), lab.state.latch, lab.state.clear) == (0, 0, 0, False)
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


def test_the_first_camera_that_is_out_is_named() -> None:
    lab = Lab(2)
    lab.arm()
    out = tuple(Happening(Event.CAMERA_FROZEN, NOBODY, camera) for camera in (2, 3))
    assert arming.missing(lab.view._replace(now_ns=lab.now_ns, cameras_out=out)) == out[0]._replace(
        event=Event.CAMERA_OUT
    )


def placed(*x_m: float, driven: int, wheel_radius: tuple[float, ...]) -> tuple[ArmingSettings, FleetView]:
    """Return a fleet that has passed its drill, in a row along x; the last ones are bystanders."""
    n = len(x_m)
    settings = ArmingSettings(0, wheel_radius, (0.105,) * n, (BODY_M,) * n, (9.0, 9.0))
    robots = tuple(
        RobotView(heard_ns=S, session=1, seen_ns=S, pose=(x, 0.0, 0.0), driven=row < driven)
        for row, x in enumerate(x_m)
    )
    return settings, FleetView(S, robots, controller_ns=S, tracker_ns=S)


@pytest.mark.parametrize(
    ("gap_m", "on_the_spot", "rounds"),
    [(0.03, True, ((0, 1), (1, 2))), (0.06, False, ((0, 1), (2, 3))), (0.1, False, ((0, 1), (1, 2)))],
)
def test_two_robots_wiggle_at_once_where_there_is_room_for_both_wiggles(
    gap_m: float, on_the_spot: bool, rounds: tuple[tuple[int, int], ...]
) -> None:
    """10 mm each on the spot, and 44 mm each along an arc; what room others need does not matter."""
    settings, view = placed(0.0, 2 * BODY_M + gap_m, 3.0, driven=2, wheel_radius=(0.016, 0.016, 0.03))
    state, happening = arming.step(ArmingState(Stage.DRILL, S, clear=True), settings, view, True)
    assert happening is None
    assert (state.wiggle.on_the_spot, state.wiggle.rounds) == (on_the_spot, rounds)


def test_robots_that_need_more_room_leave_others_their_rounds() -> None:
    second = 2 * BODY_M + 0.1
    settings, view = placed(0.0, second, second + 0.3, driven=3, wheel_radius=(0.016, 0.016, 0.05))
    state, _ = arming.step(ArmingState(Stage.DRILL, S, clear=True), settings, view, True)
    assert {*state.wiggle.rounds[0]} & {*state.wiggle.rounds[1]}


def test_a_bystander_needs_no_room_of_its_own_however_large_its_wheels_are() -> None:
    settings, view = placed(0.0, 2 * BODY_M + 0.06, driven=1, wheel_radius=(0.016, 0.1))
    state, _ = arming.step(ArmingState(Stage.DRILL, S, clear=True), settings, view, True)
    assert state.stage is Stage.WIGGLE
    assert not state.wiggle.on_the_spot


@pytest.mark.parametrize(
    ("order", "happening"),
    [(None, Happening(Event.WAYS_CROSS, 2, 1)), ((0, 2, 1), Happening(Event.WRONG_ORDER, 1, 2))],
)
def test_who_would_not_get_past_whom_is_named_before_a_wheel_is_tried(
    order: tuple[int, ...] | None, happening: Happening
) -> None:
    calls: list[object] = []

    def jam(poses: tuple[tuple[float, float, float], ...]) -> Reason:
        calls.append(poses)
        return Reason(1, 2, order)

    lab = Lab(3)
    lab.settings = lab.settings._replace(jam=jam)
    assert lab.arm() == happening
    assert lab.state.stage is Stage.CHECKS
    view = one(2, driven=False)(lab.view._replace(now_ns=lab.now_ns))
    assert arming.unready(lab.settings, view) == happening
    assert calls[-1] == tuple(robot.pose for robot in view.robots[:2]), "it is asked of the robots that drive"


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


FREE_M = least_room_m(0.016)


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


SQUARE = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
NOTCHED = Solid("floor", ((-2.0, -2.0), (2.0, -2.0), (2.0, 0.0), (0.0, 0.0), (0.0, 2.0), (-2.0, 2.0)), floor=True)


@pytest.mark.parametrize(
    ("solid", "x_m", "event"),
    [
        (Solid("pillar", ((0.0, 0.2),), 0.5), 0.6 + FREE_M + 1e-9, None),
        (Solid("pillar", ((0.0, 0.2),), 0.5), 0.6 + FREE_M - 1e-6, Event.TOO_CLOSE),
        (Solid("box", SQUARE), 0.6 + FREE_M + 1e-9, None),
        (Solid("box", SQUARE), 0.6 + FREE_M - 1e-6, Event.TOO_CLOSE),
        (Solid("box", SQUARE), 0.1, Event.TOO_CLOSE),  # it stands in it
        (NOTCHED, -0.1 - FREE_M - 1e-9, None),
        (NOTCHED, -0.1 - FREE_M + 1e-6, Event.TOO_CLOSE),
        (NOTCHED, -0.0999, Event.OUTSIDE_ARENA),
        (NOTCHED, 0.5, Event.OUTSIDE_ARENA),
    ],
)
def test_a_wiggle_has_room_to_obstacles_and_to_the_floors_end(solid: Solid, x_m: float, event: Event | None) -> None:
    lab = Lab(1)
    lab.settings = lab.settings._replace(body_radius=(0.1,), arena=(9.0, 9.0), solids=(solid,))
    lab.alter = one(0, pose=(x_m, 0.2, 0.0))
    happening = lab.run(10.0, done=lambda state: state.stage is Stage.DRILL)
    assert (None if happening is None else happening.event) is event
    assert happening is None or happening.detail == (NOBODY if event is Event.TOO_CLOSE else 0.0)


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


def bystanders(lab: Lab, *rows: int, **fields: object) -> None:
    """Let the last robots be nobody's: no driver of theirs is there."""
    nothing = {"driven": False, "heard_ns": 1, "build": 0, "session": 0}  # its driver went long ago
    for row in rows:
        lab.also(one(row, **nothing | fields))


def test_bystanders_are_not_driven_and_a_fleet_beside_them_is_proved() -> None:
    lab = Lab(4)
    bystanders(lab, 2, 3)
    assert lab.arm() == PROVED
    assert {row for _, strokes in lab.stages for row, stroke in enumerate(strokes) if stroke} == {0, 1}
    assert all(plant.truth()[:2] == (0.3 * (row - 1.5), 0.0) for row, plant in enumerate(lab.plants) if row > 1)


@pytest.mark.parametrize(
    ("says", "happening"),
    [
        ({"battery": 0.0}, PROVED),
        ({"faults": RobotFault.CHARGING}, PROVED),
        ({"latch": Latch.DRILL}, Happening(Event.GATE_LATCHED, 2)),  # of a start before: it is waited for
        ({"faults": RobotFault.WIRED_STOP}, Happening(Event.WIRED_STOP, 2)),
        ({"latch": Latch.EMERGENCY_STOP}, Happening(Event.GATE_LATCHED, 2, Latch.EMERGENCY_STOP)),
        ({"seen_ns": 0}, Happening(Event.TAG_LOST, 2)),
    ],
)
def test_of_a_bystander_only_its_stop_and_its_tag_matter(says: dict[str, object], happening: Happening) -> None:
    lab = Lab(3)
    bystanders(lab, 2, **says)
    assert lab.arm() == happening


def test_a_bystander_must_stand() -> None:
    lab = Lab(3)
    bystanders(lab, 2)
    lab.noise = (0.0, 0.0, 0.0)
    lab.also(lambda view: one(2, pose=(0.3 + 0.05 * (view.now_ns - S) / S, 0.0, 0.0))(view))
    happening = lab.arm()
    assert happening is not None
    assert (happening.event, happening.robot) in ((Event.NOT_AT_REST, 2), (Event.WRONG_TAG_MOVED, 0))


def test_who_turns_a_bystanders_tag_is_named() -> None:
    """Its tag is on a robot of the group, and that robot's on the bystander."""
    lab = Lab(3)
    lab.tags = [0, 2, 1]
    bystanders(lab, 2)
    assert lab.arm() == Happening(Event.WRONG_TAG_MOVED, 1, 2)


@pytest.mark.parametrize("row", [1, 2])
@pytest.mark.parametrize("spare", [1e-6, -1e-6])
def test_a_bystander_keeps_clear_of_a_wiggle(row: int, spare: float) -> None:
    """Within reach of a robot's wiggle, and beside another bystander, where nothing wiggles."""
    lab = Lab(3)
    lab.noise = (0.0, 0.0, 0.0)
    bystanders(lab, *range(row, 3))
    reach = 2 * BODY_M + least_room_m(0.016) + spare
    x, y, psi = lab.plants[0].truth()[:3] if row == 1 else lab.plants[1].truth()[:3]
    lab.also(one(row, pose=(x + reach * math.cos(2.0), y + reach * math.sin(2.0), psi)))
    assert lab.arm() == (PROVED if spare > 0 else Happening(Event.TOO_CLOSE, row - 1, row))


def test_bystanders_may_stand_anywhere_else() -> None:
    lab = Lab(4)
    bystanders(lab, 2, 3)
    for row, x in ((2, 2.0), (3, 2.05)):  # beyond the edge, and into each other
        lab.also(one(row, pose=(x, 0.0, 0.0)))
    assert lab.arm() == PROVED


@pytest.mark.parametrize("spare", [1e-6, -1e-6])
def test_a_bystanders_own_wheels_need_no_room(spare: float) -> None:
    """It does not wiggle, so however large its wheels are, the others' wiggle alone needs room."""
    lab = Lab(3)
    lab.noise = (0.0, 0.0, 0.0)
    radii = (*lab.settings.wheel_radius[:2], 10.0 * lab.settings.wheel_radius[2])
    lab.settings = lab.settings._replace(wheel_radius=radii)
    bystanders(lab, 2)
    x, y, psi = lab.plants[1].truth()[:3]
    lab.also(one(2, pose=(x + 2 * BODY_M + least_room_m(0.016) + spare, y, psi)))
    assert lab.arm() == (PROVED if spare > 0 else Happening(Event.TOO_CLOSE, 1, 2))


TIGHT_M = least_room_m(0.016) + 0.002  # noise may take some of it


def tight(seed: int = 1, **fault: object) -> Lab:
    """Return two robots beside each other without room for an arc; something may be wrong with the first one."""
    return Lab(2, seed, {0: fault}, [(0.0, 0.0), (0.0, 2 * BODY_M + TIGHT_M)])


def test_robots_without_room_for_an_arc_are_tried_on_the_spot() -> None:
    lab = tight()
    before = [plant.truth() for plant in lab.plants]
    assert lab.arm() == PROVED
    assert {stroke for _, strokes in lab.stages for stroke in strokes} == {STAND, LEFT, RIGHT}
    for old, plant in zip(before, lab.plants, strict=True):
        assert math.dist(old[:2], plant.truth()[:2]) < 0.002
    assert (lab.now_ns - S) / S < 10.0


@pytest.mark.parametrize("encoders", [True, False])
@pytest.mark.parametrize(("wiring", "event"), WIRINGS.items())
@pytest.mark.parametrize("seed", [1, 2])
def test_on_the_spot_a_faulty_wiring_is_named_and_nobody_leaves_the_room(
    wiring: str, event: Event, seed: int, encoders: bool
) -> None:
    lab = tight(seed, wiring=wiring)
    lab.silent_encoders = not encoders
    start, furthest = lab.plants[0].truth(), 0.0
    while (happening := lab.run(0.01)) is None:
        furthest = max(furthest, math.dist(start[:2], lab.plants[0].truth()[:2]))
    lab.state = lab.program.begin(lab.now_ns)
    for _ in range(50):  # to rest
        lab.now_ns += 10 * MS
        lab._move()
        furthest = max(furthest, math.dist(start[:2], lab.plants[0].truth()[:2]))
    assert (happening.event, happening.robot) == (event, 0)
    assert furthest < least_room_m(0.016) - 0.002


@pytest.mark.parametrize("error", [0.2, -0.2, 1 / 1.2 - 1])
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("on_the_spot", [False, True])
def test_a_wheel_radius_that_is_a_fifth_off_is_found(error: float, seed: int, on_the_spot: bool) -> None:
    lab = tight(seed, wheel_gain_error=error) if on_the_spot else Lab(3, seed, {0: {"wheel_gain_error": error}})
    happening = lab.arm()
    assert happening == Happening(Event.WRONG_GAIN, 0, pytest.approx(1 + error, abs=0.07))


def test_on_the_spot_a_stuck_robot_and_exchanged_tags_are_named() -> None:
    lab = tight()
    lab.stuck = {0}
    assert lab.arm() == Happening(Event.DID_NOT_MOVE, 0)
    lab = tight()
    lab.tags = [1, 0]
    assert lab.arm() == Happening(Event.WRONG_TAG_MOVED, 0, 1)

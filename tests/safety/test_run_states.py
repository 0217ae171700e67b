"""The run's state machine: every cell of phase and event, against rules that are said here in other words."""

from itertools import product

import pytest

from robofleet.safety.supervisor import (
    CAUSES,
    MOVING,
    NOBODY,
    TRANSITIONS,
    Event,
    Happening,
    Phase,
    Roster,
    RunStatus,
    describe,
    step,
)

EMERGENCIES = {Event.ESTOP_REQUESTED, Event.WIRED_STOP, Event.RUNAWAY}  # whatever the run does
ENDS = {  # nobody can go on from here without looking
    Event.SUPERVISOR_STALLED, Event.DRIVER_SILENT, Event.DRIVER_RESTARTED, Event.CONTROLLER_SILENT,
    Event.CONTROLLER_RESTARTED, Event.OTHER_BUILD, Event.LEASE_LOST, Event.CAMERA_LOST, Event.CAMERA_MOVED,
    Event.GATE_LATCHED, Event.ROBOT_FAULT, Event.BATTERY_LOW, Event.TAG_LOST, Event.OUTSIDE_ARENA,
    Event.POSE_JUMPED, Event.BUMPED, Event.CLIFF, Event.WHEEL_DROPPED, Event.OVERCURRENT, Event.CHARGING,
    Event.UNREACHABLE,
}  # fmt: skip
HOLDS = {  # it may pass, and the run can be resumed
    Event.TRACKER_SILENT, Event.TRACKER_RESTARTED, Event.CAMERA_STALLED, Event.CAMERA_FROZEN, Event.TAG_TWICE,
    Event.TOO_CLOSE, Event.DISK_FULL, Event.BYSTANDER_LOST, Event.BYSTANDER_MOVED, Event.LINK_LOST, Event.POSES_SILENT,
}  # fmt: skip
OF_MOTION = {  # mean something while the fleet drives
    Event.TICKS_OVERRUN, Event.FILTER_INFEASIBLE, Event.DEADLOCKED, Event.UNDER_WAY_TOO_LONG,
    Event.BEHAVIOUR_RAISED, Event.BEHAVIOUR_NOT_FINITE, Event.BEHAVIOUR_SHAPE, Event.BEHAVIOUR_LATE,
    Event.SCRIPT_SILENT, Event.SCRIPT_FAILED, Event.BEHAVIOUR_NO_WAY, Event.WHEEL_STALLED,
}  # fmt: skip
OF_CHECKS = {event for event in Event if 50 <= event < 60} | {  # the fifties are the checks'
    Event.ARMED_TOO_LONG, Event.WRONG_ORDER, Event.WAYS_CROSS, Event.MOVED_UNASKED,
}  # fmt: skip
WISHES = {
    (Phase.IDLE, Event.ARM_REQUESTED): Phase.ARMED,
    (Phase.IDLE, Event.START_REQUESTED): Phase.ARMED,
    (Phase.ARMED, Event.PROVED): Phase.RUNNING,
    (Phase.ARMED, Event.SET_OUT): Phase.POSITIONING,
    (Phase.ARMED, Event.CAMERA_OUT): Phase.FAULT,
    (Phase.POSITIONING, Event.AT_START): Phase.RUNNING,
    (Phase.RUNNING, Event.ACCOMPLISHED): Phase.IDLE,
    (Phase.RUNNING, Event.OFF_TO_PARK): Phase.PARKING,
    **dict.fromkeys(product((Phase.RUNNING, Phase.POSITIONING, Phase.HOLD), (Event.PARK_REQUESTED,)), Phase.PARKING),
    (Phase.PARKING, Event.PARKED): Phase.IDLE,
    (Phase.ARMED, Event.STOP_REQUESTED): Phase.IDLE,
    **dict.fromkeys(product(MOVING, (Event.STOP_REQUESTED,)), Phase.IDLE),
    (Phase.HOLD, Event.STOP_REQUESTED): Phase.IDLE,
    (Phase.ARMED, Event.NOT_STARTED): Phase.IDLE,  # nothing is wrong
    **dict.fromkeys(product(MOVING, (Event.HOLD_REQUESTED,)), Phase.HOLD),
    (Phase.HOLD, Event.RESUME_REQUESTED): Phase.RUNNING,
    (Phase.HOLD, Event.CAUGHT_UP): Phase.RUNNING,  # what may say so is in test_busy.py
    (Phase.FAULT, Event.RESET): Phase.IDLE,
    (Phase.ESTOP, Event.RESET): Phase.IDLE,
}
UNDER_WAY = (Phase.ARMED, Phase.HOLD, *MOVING)


def expected(phase: Phase, event: Event) -> Phase | None:
    rules = [
        (Phase.ESTOP, event is Event.STOPPED_AT_GATE and phase not in (Phase.IDLE, Phase.ESTOP)),
        (Phase.ESTOP, event in EMERGENCIES and phase is not Phase.ESTOP),
        (Phase.ESTOP, event is Event.OPERATOR_LOST and phase in UNDER_WAY),
        (Phase.FAULT, event in ENDS - {Event.TAG_LOST} and phase in UNDER_WAY),
        (Phase.FAULT, event is Event.TAG_LOST and phase in (Phase.ARMED, *MOVING)),  # in HOLD it stands anyway
        (Phase.HOLD, event in HOLDS | OF_MOTION and phase in MOVING),
        (Phase.FAULT, event in HOLDS | OF_CHECKS and phase is Phase.ARMED),
        (Phase.FAULT, event is Event.HELD_TOO_LONG and phase is Phase.HOLD),
    ]
    return next((to for to, applies in rules if applies), WISHES.get((phase, event)))


def test_every_cell() -> None:
    for phase, event in product(Phase, Event):
        before = RunStatus(phase, Event.NOTHING, 3, 0.5)
        after = step(before, Happening(event, 1, 2.5))
        to = expected(phase, event)
        if to is None:
            assert after is before, (phase, event)  # neither phase nor cause nor robot
        else:
            assert after[:4] == (to, event, 1, 2.5), (phase, event)


def test_only_a_proof_the_operator_and_a_machine_that_caught_up_start_the_wheels() -> None:
    starts = {cell for cell, phase in TRANSITIONS.items() if phase is Phase.RUNNING}
    assert starts == {
        (Phase.ARMED, Event.PROVED), (Phase.HOLD, Event.RESUME_REQUESTED), (Phase.HOLD, Event.CAUGHT_UP),
        (Phase.POSITIONING, Event.AT_START),
    }  # fmt: skip
    ways = {cell for cell, phase in TRANSITIONS.items() if phase in (Phase.POSITIONING, Phase.PARKING)}
    assert ways == {
        (Phase.ARMED, Event.SET_OUT), (Phase.RUNNING, Event.OFF_TO_PARK), (Phase.RUNNING, Event.PARK_REQUESTED),
        (Phase.POSITIONING, Event.PARK_REQUESTED), (Phase.HOLD, Event.PARK_REQUESTED),
    }  # fmt: skip


def test_only_a_reset_leaves_an_emergency_stop_and_it_leads_to_idle() -> None:
    assert [(e, to) for (phase, e), to in TRANSITIONS.items() if phase is Phase.ESTOP] == [(Event.RESET, Phase.IDLE)]


def test_every_cause_has_its_words() -> None:
    assert set(CAUSES) == set(Event)
    robots = ("a", "b")
    for event in Event:
        assert describe(Happening(event, 0, 1.0), robots).startswith("a: ")
        assert not describe(Happening(event, NOBODY, 1.0), robots).startswith("a: ")
        for odd in (-0.5, 2.0, 7.0, 1e300):  # of another version, or of no robot
            for nobody in (2, 9):
                assert "{" not in describe(Happening(event, nobody, odd), robots)


@pytest.mark.parametrize(
    ("happening", "words"),
    [
        (Happening(Event.BATTERY_LOW, 0, 0.07), "a: the battery is low (7 %)"),
        (Happening(Event.BATTERY_LOW, 1, 1.0), "b: the battery is low (100 %)"),
        (Happening(Event.WRONG_TAG_MOVED, 0, 1.0), "a: its driver moves the tag of b"),
        (Happening(Event.TOO_CLOSE, 1, 0.0), "b: it is too close to a"),
        (Happening(Event.STOP_REQUESTED), "stop requested"),
    ],
)
def test_a_cause_names_the_robot_and_its_figure(happening: Happening, words: str) -> None:
    assert describe(happening, ("a", "b")) == words
    assert RunStatus(Phase.FAULT, *happening).describe(("a", "b")) == words


def test_a_behaviours_failure_names_its_group_where_the_groups_are_known() -> None:
    late = Happening(Event.BEHAVIOUR_LATE, 1)
    assert describe(late, Roster(("a", "b"), ("", "ring"))).startswith("b: the behaviour of its group ring ")
    assert describe(late, ("a", "b")).startswith("b: the behaviour of its group ")
    for nobody in (2, NOBODY):
        assert "ring" not in describe(late._replace(robot=nobody), Roster(("a", "b"), ("", "ring")))


@pytest.mark.parametrize("phase", MOVING)
@pytest.mark.parametrize("event", [Event.RESUME_REQUESTED, Event.CAUGHT_UP])
def test_what_was_held_goes_on(phase: Phase, event: Event) -> None:
    held = step(RunStatus(phase), Happening(Event.HOLD_REQUESTED))
    assert step(held, Happening(Event.TAG_LATE, 1)).held is phase
    assert step(held, Happening(event)).phase is phase


def test_what_was_held_is_forgotten_by_a_phase_that_comes_after() -> None:
    held = step(RunStatus(Phase.POSITIONING), Happening(Event.HOLD_REQUESTED))
    parking = step(held, Happening(Event.PARK_REQUESTED))
    assert (parking.phase, parking.held) == (Phase.PARKING, Phase.PARKING)


def test_what_a_robot_is_too_close_to_and_which_camera_is_out_are_named() -> None:
    close, out = Happening(Event.TOO_CLOSE, 0, NOBODY), Happening(Event.CAMERA_OUT, 0, 0.0)
    assert describe(close, ("a", "b")) == "a: it is too close to the wall or to an obstacle"
    roster = Roster(("a", "b"), ("", ""), ("left",))
    assert describe(out, roster) == "a: only the camera left could see it, and that gives no poses"
    for robots, camera in ((("a", "b"), 0.0), (roster, 1.0), (roster, -1.0)):
        words = describe(out._replace(detail=camera), robots)
        assert words == "a: only a camera could see it, and that gives no poses"


def test_a_status_of_another_version_is_not_read() -> None:
    assert RunStatus.read(Phase.HOLD, Event.TOO_CLOSE, 1, 2.0) == RunStatus(Phase.HOLD, Event.TOO_CLOSE, 1, 2.0)
    assert RunStatus.read(99, Event.TOO_CLOSE, 1, 2.0) is None
    assert RunStatus.read(Phase.HOLD, 9999, 1, 2.0) is None

"""What an operator may ask for, and what he is told where he may not."""

from itertools import product

import pytest

from robofleet.safety.advice import WAY_OUT
from robofleet.safety.latches import Latch
from robofleet.safety.requests import acknowledged, gone, latched, refusal
from robofleet.safety.supervisor import NOBODY, TRANSITIONS, Event, Happening, Phase, RunStatus
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.vehicles.interface import WIRED_STOP, RobotFault

MS = 1_000_000
NOW = 1_000_000 * MS
SILENT_NS = 500 * MS
IDS = ("a", "b", "c")
THERE = RobotView(heard_ns=NOW)
HELD = THERE._replace(latch=Latch.EMERGENCY_STOP)
WISHES = {  # what an operator may ask for, and where it was met already, or is heard
    Event.ARM_REQUESTED: {Phase.ARMED},
    Event.START_REQUESTED: {Phase.ARMED, Phase.POSITIONING, Phase.RUNNING},
    Event.STOP_REQUESTED: {Phase.IDLE},
    Event.HOLD_REQUESTED: {Phase.HOLD},
    Event.RESUME_REQUESTED: {Phase.RUNNING, Phase.POSITIONING, Phase.PARKING},
    Event.PARK_REQUESTED: {Phase.PARKING},
    Event.ESTOP_REQUESTED: {Phase.ESTOP},
    Event.RESET: {Phase.IDLE},
}


def why(event: Event, phase: Phase, *robots: RobotView, standing: tuple[Happening, ...] = ()) -> str | None:
    """Return why it is refused in a view of three robots; those that are not named are healthy."""
    group = (*robots, THERE, THERE, THERE)[:3]
    return refusal(event, RunStatus(phase), standing, FleetView(NOW, group), IDS)


@pytest.mark.parametrize(("event", "phase"), list(product(WISHES, Phase)))
def test_what_leads_somewhere_or_was_met_already_is_granted_and_all_else_is_told_the_way_out(
    event: Event, phase: Phase
) -> None:
    robots = (HELD,) * 3 if event is Event.RESET else ()
    allowed = (phase, event) in TRANSITIONS or phase in WISHES[event]
    assert why(event, phase, *robots) == (None if allowed else WAY_OUT[phase])


def test_every_phase_has_a_way_out_in_words() -> None:
    assert set(WAY_OUT) == set(Phase)
    assert len(set(WAY_OUT.values())) == len(Phase)


@pytest.mark.parametrize("phase", [Phase.FAULT, Phase.ESTOP, Phase.IDLE])
@pytest.mark.parametrize(
    ("hindrance", "message"),
    [
        ({"left_speed": 0.1}, "b is not at rest: wait until it stands"),
        ({"right_output": -0.1}, "b is not at rest: wait until it stands"),
        (
            {"left_speed": 6.1, "latch": Latch.RUNAWAY},
            "b: a wheel turns by itself: switch off its power, then reset",
        ),
        ({"left_speed": 6.1, "latch": Latch.ROBOT_FAULT}, "b is not at rest: wait until it stands"),
        ({"faults": WIRED_STOP}, "b: its own e-stop is pressed: release it, then reset"),
        ({"faults": WIRED_STOP | 4}, "b: its own e-stop is pressed: release it, then reset"),
        (
            {"faults": RobotFault.UNREACHABLE, "left_speed": 3.0},
            "b: its driver has lost the connection to it: plug it in, switch it on, then reset",
        ),
    ],
)
def test_a_reset_waits_for_every_robot_and_names_the_one(
    phase: Phase, hindrance: dict[str, float], message: str
) -> None:
    hindered = HELD._replace(**hindrance)  # type: ignore[arg-type]
    assert why(Event.RESET, phase, HELD, hindered, HELD) == message
    assert why(Event.RESET, phase, HELD, hindered._replace(heard_ns=NOW - SILENT_NS - 1), HELD) is None, "it is gone"


@pytest.mark.parametrize("latch", [Latch.NONE, Latch.DRILL])
def test_an_emergency_stop_is_reset_when_everybody_has_acknowledged_it(latch: Latch) -> None:
    deaf = THERE._replace(latch=latch)
    message = "c has not acknowledged the emergency stop: look at its driver"
    assert why(Event.RESET, Phase.ESTOP, HELD, HELD, deaf) == message
    assert why(Event.RESET, Phase.FAULT, HELD, HELD, deaf) is None
    assert why(Event.RESET, Phase.ESTOP, HELD, HELD, HELD._replace(latch=Latch.WIRED_STOP, faults=4)) is None


@pytest.mark.parametrize("latch", list(Latch))
def test_an_e_stop_or_worse_acknowledges(latch: Latch) -> None:
    assert acknowledged(THERE._replace(latch=latch)) is (latch not in (Latch.NONE, Latch.DRILL))


def test_no_start_with_a_latched_gate_and_all_of_them_are_named() -> None:
    message = "a, c: the gate is latched: look at the robot, then reset"
    assert why(Event.START_REQUESTED, Phase.IDLE, HELD, THERE, THERE._replace(latch=Latch.DRILL)) == message
    assert why(Event.START_REQUESTED, Phase.ARMED, HELD) is None, "it was met already"
    assert why(Event.START_REQUESTED, Phase.IDLE, HELD._replace(heard_ns=NOW - SILENT_NS - 1)) is None
    assert why(Event.STOP_REQUESTED, Phase.IDLE, HELD) is None
    assert why(Event.ARM_REQUESTED, Phase.IDLE, HELD, THERE, THERE._replace(latch=Latch.DRILL)) == message
    assert latched(FleetView(NOW, (THERE, HELD, HELD._replace(heard_ns=NEVER))), IDS) == ["b"]


def test_a_fleet_that_waits_is_not_started_while_something_is_missing() -> None:
    unready = Happening(Event.TAG_LOST, 1)
    view, message = FleetView(NOW, (THERE,) * 3), "b: the tracker lost the robot: mend it, then start, or stop"
    assert refusal(Event.START_REQUESTED, RunStatus(Phase.ARMED), (), view, IDS, unready) == message
    for event in (Event.ARM_REQUESTED, Event.STOP_REQUESTED, Event.ESTOP_REQUESTED):
        assert refusal(event, RunStatus(Phase.ARMED), (), view, IDS, unready) is None


def test_a_run_is_not_resumed_into_what_would_end_it_again() -> None:
    harmless = Happening(Event.TAG_LATE, 0)
    late = (harmless, Happening(Event.DRIVER_SILENT, 2), Happening(Event.DISK_FULL))
    message = "c: the driver went silent: mend it, then resume, or stop"
    assert why(Event.RESUME_REQUESTED, Phase.HOLD, standing=late) == message
    assert why(Event.RESUME_REQUESTED, Phase.HOLD, standing=(harmless,)) is None
    assert why(Event.HOLD_REQUESTED, Phase.RUNNING, standing=late) is None
    assert why(Event.RESUME_REQUESTED, Phase.RUNNING, standing=late) is None, "it was met already"


def test_a_run_is_not_resumed_into_what_would_hold_it_at_once() -> None:
    """In HOLD itself too close is no event any more."""
    close = (Happening(Event.TOO_CLOSE, 1, NOBODY),)
    assert why(Event.RESUME_REQUESTED, Phase.HOLD, standing=close) == (
        "b: it is too close to the wall or to an obstacle: mend it, then resume, or stop"
    )


@pytest.mark.parametrize(
    ("heard_ns", "is_gone"), [(NOW, False), (NOW - SILENT_NS, False), (NOW - SILENT_NS - 1, True), (NEVER, True)]
)
def test_a_robot_is_gone_that_says_nothing_for_half_a_second(heard_ns: int, is_gone: bool) -> None:
    assert gone(THERE._replace(heard_ns=heard_ns), FleetView(NOW, ())) is is_gone


def test_a_robot_of_which_nothing_was_heard_is_gone_also_where_the_clock_began_just_now() -> None:
    assert gone(RobotView(heard_ns=NEVER), FleetView(MS, ()))


@pytest.mark.parametrize("wheel", ["left_speed", "right_speed", "left_output", "right_output"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_robot_is_at_rest_if_no_wheel_turns_as_asked_and_as_measured(wheel: str, sign: int) -> None:
    assert THERE._replace(**{wheel: sign * 0.0499}).at_rest  # type: ignore[arg-type]
    assert not THERE._replace(**{wheel: sign * 0.05}).at_rest  # type: ignore[arg-type]

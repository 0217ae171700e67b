"""The run's state machine: every cell of phase and event."""

from itertools import product

import pytest

from robofleet.safety.supervisor import CAUSES, NOBODY, TRANSITIONS, Event, Phase, RunStatus, step

CHANGES = {
    (Phase.IDLE, Event.START_REQUESTED): Phase.ARMED,
    (Phase.ARMED, Event.FLEET_READY): Phase.RUNNING,
    (Phase.ARMED, Event.STOP_REQUESTED): Phase.IDLE,
    (Phase.RUNNING, Event.STOP_REQUESTED): Phase.IDLE,
    (Phase.RUNNING, Event.DRIVER_SILENT): Phase.FAULT,
    (Phase.RUNNING, Event.CONTROLLER_SILENT): Phase.FAULT,
    (Phase.RUNNING, Event.ROBOT_LOST): Phase.FAULT,
}


@pytest.mark.parametrize(("phase", "event"), list(product(Phase, Event)))
def test_every_cell(phase: Phase, event: Event) -> None:
    before = RunStatus(phase, Event.NOTHING, 3)
    after = step(before, event, 1)
    if (phase, event) in CHANGES:
        assert after == RunStatus(CHANGES[phase, event], event, 1)
    else:
        assert after is before  # neither phase nor cause nor robot


def test_only_one_event_starts_the_wheels() -> None:
    starts = [cell for cell, phase in TRANSITIONS.items() if phase is Phase.RUNNING]
    assert starts == [(Phase.ARMED, Event.FLEET_READY)]


def test_nothing_leaves_a_fault() -> None:
    assert all(phase is not Phase.FAULT for phase, _ in TRANSITIONS)


def test_a_whole_run() -> None:
    status = RunStatus()
    assert (status.phase, status.robot) == (Phase.IDLE, NOBODY)
    for event in (Event.START_REQUESTED, Event.FLEET_READY, Event.ROBOT_LOST, Event.STOP_REQUESTED):
        status = step(status, event, 2 if event is Event.ROBOT_LOST else NOBODY)
    assert status == RunStatus(Phase.FAULT, Event.ROBOT_LOST, 2)
    assert status.describe(("a", "b", "c")) == "the tracker lost the robot: c"


def test_every_cause_has_its_words() -> None:
    assert set(CAUSES) == set(Event)
    assert RunStatus(Phase.IDLE, Event.STOP_REQUESTED).describe(()) == "stop requested"

"""The run's state machine: one transition table, no I/O."""

from enum import IntEnum
from typing import NamedTuple

NOBODY = 0xFFFF


class Phase(IntEnum):
    """State of a run. Wheels may move in RUNNING alone."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2
    FAULT = 3


class Event(IntEnum):
    """What can happen to a run; also the recorded cause of a state."""

    NOTHING = 0
    START_REQUESTED = 1
    FLEET_READY = 2
    STOP_REQUESTED = 3
    DRIVER_SILENT = 4
    CONTROLLER_SILENT = 5
    ROBOT_LOST = 6


CAUSES = {
    Event.NOTHING: "nothing",
    Event.START_REQUESTED: "start requested",
    Event.FLEET_READY: "every robot seen and answering",
    Event.STOP_REQUESTED: "stop requested",
    Event.DRIVER_SILENT: "the driver went silent",
    Event.CONTROLLER_SILENT: "the controller went silent",
    Event.ROBOT_LOST: "the tracker lost the robot",
}

TRANSITIONS: dict[tuple[Phase, Event], Phase] = {
    (Phase.IDLE, Event.START_REQUESTED): Phase.ARMED,
    (Phase.ARMED, Event.FLEET_READY): Phase.RUNNING,
    (Phase.ARMED, Event.STOP_REQUESTED): Phase.IDLE,
    (Phase.RUNNING, Event.STOP_REQUESTED): Phase.IDLE,
    (Phase.RUNNING, Event.DRIVER_SILENT): Phase.FAULT,
    (Phase.RUNNING, Event.CONTROLLER_SILENT): Phase.FAULT,
    (Phase.RUNNING, Event.ROBOT_LOST): Phase.FAULT,
}


class RunStatus(NamedTuple):
    """Where the run is, and what led there."""

    phase: Phase = Phase.IDLE
    cause: Event = Event.NOTHING
    robot: int = NOBODY  # index in the group's order

    def describe(self, robots: tuple[str, ...]) -> str:
        """Return the cause in words; ``robots`` are the ids in the group's order."""
        cause = CAUSES[self.cause]
        return cause if self.robot == NOBODY else f"{cause}: {robots[self.robot]}"


def step(status: RunStatus, event: Event, robot: int = NOBODY) -> RunStatus:
    """Return the status after an event; an event that means nothing in this phase changes nothing."""
    phase = TRANSITIONS.get((status.phase, event))
    return status if phase is None else RunStatus(phase, event, robot)

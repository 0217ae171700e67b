"""What an operator may ask for, and why it is refused: in words that say what to do. Pure."""

from robofleet.safety.advice import WAY_OUT
from robofleet.safety.latches import Latch
from robofleet.safety.monitor import SILENT_NS
from robofleet.safety.supervisor import MOVING, TRANSITIONS, Event, Happening, Phase, RunStatus, describe
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.vehicles.interface import RobotFault

# Where a wish changes no phase: it was met already, and whoever heard no answer asks again; or it is a start that
# checks are under way for, or waiting for.
_MET = {
    Event.ARM_REQUESTED: (Phase.ARMED,),
    Event.START_REQUESTED: (Phase.ARMED, Phase.POSITIONING, Phase.RUNNING),
    Event.STOP_REQUESTED: (Phase.IDLE,),
    Event.HOLD_REQUESTED: (Phase.HOLD,),
    Event.RESUME_REQUESTED: MOVING,
    Event.PARK_REQUESTED: (Phase.PARKING,),
    Event.ESTOP_REQUESTED: (Phase.ESTOP,),
    Event.RESET: (Phase.IDLE,),
}


def refusal(
    event: Event,
    status: RunStatus,
    standing: tuple[Happening, ...],
    view: FleetView,
    robots: tuple[str, ...],
    unready: Happening | None = None,
) -> str | None:
    """Return why what an operator asks for cannot be done, None where it can.

    ``standing`` is what the monitor tells of this view; ``robots`` are the ids in the group's order; ``unready`` is
    what keeps a fleet that waits for its start from starting.
    """
    phase = TRANSITIONS.get((status.phase, event))
    if phase is None and status.phase not in _MET[event]:
        return WAY_OUT[status.phase]
    if event is Event.RESET:
        present = [(robot, seen) for robot, seen in zip(robots, view.robots, strict=True) if not gone(seen, view)]
        return next((why for robot, seen in present if (why := _unsettled(robot, seen, status.phase))), None)
    if phase is Phase.ARMED and (held := latched(view, robots)):
        return f"{', '.join(held)}: the gate is latched: look at the robot, then reset"
    if event is Event.START_REQUESTED and unready is not None:
        return f"{describe(unready, robots)}: mend it, then start, or stop"
    if event is Event.RESUME_REQUESTED:
        for happening in standing:
            if (phase, happening.event) in TRANSITIONS:
                return f"{describe(happening, robots)}: mend it, then resume, or stop"
    return None


def _unsettled(robot: str, seen: RobotView, phase: Phase) -> str | None:
    """Return why a robot keeps a reset from being granted."""
    if seen.faults & RobotFault.UNREACHABLE:
        return f"{robot}: its driver has lost the connection to it: plug it in, switch it on, then reset"
    if not seen.at_rest and seen.latch == Latch.RUNAWAY:
        return f"{robot}: a wheel turns by itself: switch off its power, then reset"
    if not seen.at_rest:
        return f"{robot} is not at rest: wait until it stands"
    if seen.faults & RobotFault.WIRED_STOP:
        return f"{robot}: its own e-stop is pressed: release it, then reset"
    if phase is Phase.ESTOP and not acknowledged(seen):
        return f"{robot} has not acknowledged the emergency stop: look at its driver"
    return None


def latched(view: FleetView, robots: tuple[str, ...]) -> list[str]:
    """Return the robots that are there and whose gates are latched."""
    return [robot for robot, seen in zip(robots, view.robots, strict=True) if seen.latch and not gone(seen, view)]


def acknowledged(robot: RobotView) -> bool:
    """Whether a robot's gate is closed by an e-stop, or by something as grave."""
    return robot.latch >= Latch.EMERGENCY_STOP


def gone(robot: RobotView, view: FleetView) -> bool:
    """Whether nothing is heard of a robot: without permissions its gate has closed long ago."""
    return robot.heard_ns == NEVER or view.now_ns - robot.heard_ns > SILENT_NS

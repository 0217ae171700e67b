"""What a run's messages say, in words; a value of another version is shown as its number and breaks nothing."""

from enum import IntEnum

from robofleet.comms.messages import RobotTick, RunState
from robofleet.safety.supervisor import NOBODY, Event, Happening, describe


def named(kind: type[IntEnum], value: int) -> str:
    """Return the name of an enum's value."""
    try:
        return kind(value).name.lower().replace("_", " ")
    except ValueError:
        return f"unknown ({value})"


def cause(event: int, robot: int, detail: float, robots: tuple[str, ...]) -> str:
    """Return an event in words; ``robots`` are the ids in the group's order."""
    try:
        return describe(Happening(Event(event), robot, detail), robots)
    except (ValueError, KeyError):
        return f"a cause that is not known here ({event})"


def run_cause(state: RunState, robots: tuple[str, ...]) -> str:
    """Return what led to a run's state."""
    return cause(state.cause, state.robot, state.detail, robots)


def halt_cause(state: RunState, row: int) -> str:
    """Return why one robot alone stands still; an empty string where it does not."""
    own = state.robots[row].cause if row < len(state.robots) else 0
    return cause(own, len(state.robots), 0.0, ()) if own else ""


def own_halt(state: RunState | None, row: int, item: RobotTick | None) -> str:
    """Return why a robot alone, or its group alone, stands still; an empty string where neither does."""
    halted = "" if state is None else halt_cause(state, row)
    failed = 0 if item is None else int(item.failed)
    return halted or (cause(failed, NOBODY, 0.0, ()) if failed else "")

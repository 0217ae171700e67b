"""What a run's messages say, in words; a value of another version is shown as its number and breaks nothing."""

from enum import IntEnum

from robofleet.bus.messages import RobotTick, RunState
from robofleet.safety.supervisor import DRIVEN_OUT, NOBODY, Event, Happening, describe


def named(kind: type[IntEnum], value: int) -> str:
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
    return cause(state.cause, state.robot, state.detail, robots)


def halt_cause(state: RunState, row: int) -> str:
    """Return why one robot alone stands still; an empty string where it does not."""
    return "" if row >= len(state.robots) or state.robots[row].cause in DRIVEN_OUT else _own(state, row)


def driven_out(state: RunState, row: int) -> str:
    """Return who drives one robot out of a held run; an empty string where nobody does."""
    return _own(state, row) if row < len(state.robots) and state.robots[row].cause in DRIVEN_OUT else ""


def _own(state: RunState, row: int) -> str:
    own = state.robots[row].cause
    return cause(own, len(state.robots), 0.0, ()) if own else ""


def own_state(state: RunState | None, row: int, item: RobotTick | None) -> str:
    """Return why a robot alone, or its group alone, stands still, or drives alone; an empty string where none is so."""
    own = "" if state is None or row >= len(state.robots) else _own(state, row)
    failed = 0 if item is None else int(item.failed)
    return own or (cause(failed, NOBODY, 0.0, ()) if failed else "")

"""A run's messages as the lines of a log: what changed, and why."""

from collections.abc import Iterator
from enum import IntEnum
from typing import NamedTuple

from robofleet.bus.messages import BusyMachine, RunState, TrackerNews
from robofleet.recording.causes import driven_out, halt_cause, named, run_cause
from robofleet.recording.state_words import busy_notice
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Phase
from robofleet.tracking.events import TrackerEvent, describe


class Level(IntEnum):
    """How grave a line is."""

    INFO = 2
    WARNING = 3
    ERROR = 4


class Line(NamedTuple):
    """One line."""

    level: Level
    name: str  # of the process, or of the robot
    words: str


_GRAVE = {Phase.HOLD: Level.WARNING, Phase.FAULT: Level.ERROR, Phase.ESTOP: Level.ERROR}
_GOOD_NEWS = (
    TrackerEvent.TAG_FOUND, TrackerEvent.CAMERA_BACK, TrackerEvent.CAMERA_ENDED, TrackerEvent.CAMERA_LIGHT_GOOD,
    TrackerEvent.POSES_BACK, TrackerEvent.BODY_FOUND,
)  # fmt: skip


def state_lines(before: RunState | None, state: RunState, robots: tuple[str, ...]) -> Iterator[Line]:
    """Yield what the supervisor's word says that the one before did not; ``robots`` in the group's order."""
    if before is None or (before.phase, before.cause, before.robot) != (state.phase, state.cause, state.robot):
        grave = next((level for phase, level in _GRAVE.items() if phase == state.phase), Level.INFO)
        why = f": {run_cause(state, robots)}" if state.cause else ""
        yield Line(grave, "supervisor", f"{named(Phase, state.phase)}{why}")
    for row, robot in enumerate(robots):
        was, now = (
            "" if each is None or each.phase == Phase.IDLE else halt_cause(each, row) for each in (before, state)
        )
        out_before, out = "" if before is None else driven_out(before, row), driven_out(state, row)
        if out != out_before:
            yield Line(Level.INFO, robot, out or "it is driven out no more")
        elif now and now != was:
            starts = state.phase == Phase.ARMED  # then the checks wait for it
            yield Line(Level.INFO if starts else Level.WARNING, robot, f"stands still: {now}")
        elif was and not now and row < len(state.robots) and state.robots[row].permitted:
            yield Line(Level.INFO, robot, "may move again")


def latch_line(robot: str, latch: int) -> Line:
    if latch == Latch.NONE:
        return Line(Level.INFO, robot, "gate cleared")
    return Line(Level.INFO if latch == Latch.DRILL else Level.ERROR, robot, f"gate latched: {named(Latch, latch)}")


def news_line(news: TrackerNews, camera: str = "") -> Line:
    """Return what happened to the camera or to a tag; ``camera``: its name, where there are several."""
    level = Level.INFO if news.event in _GOOD_NEWS else Level.WARNING
    return Line(level, "tracker", describe(news.event, news.tag, news.value, camera))


def note_line(group: str, words: str) -> Line:
    return Line(Level.INFO, group, words)


def busy_line(message: BusyMachine, robots: tuple[str, ...]) -> Line:
    """Return that the machine is too busy for the run: the first message says so."""
    return Line(Level.WARNING, "supervisor", busy_notice(message, robots))

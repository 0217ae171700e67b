"""What happened in a run, line by line, as the page lists it."""

from collections import deque
from collections.abc import Iterator

from robofleet.comms.messages import RunState, TrackerNews
from robofleet.processes.web.frames import Frame, event
from robofleet.processes.web.hearing import Hearing
from robofleet.processes.web.words import phase_name
from robofleet.recording.causes import halt_cause, named, run_cause
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import Phase
from robofleet.tracking.events import TrackerEvent, describe

_KEPT = 100  # lines, for who opens the page later
_LEVELS = {Phase.FAULT: "error", Phase.ESTOP: "error", Phase.HOLD: "warning"}
_GOOD_NEWS = (TrackerEvent.TAG_FOUND, TrackerEvent.CAMERA_BACK)


class Diary:
    """Compares what is heard with what was heard before. ``written`` counts the lines since the beginning."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self._robots = robots
        self._lines: deque[Frame] = deque(maxlen=_KEPT)
        self._phase: int | None = None
        self._halts = [""] * len(robots)
        self._latches = [0] * len(robots)
        self.written = 0

    def since(self, written: int) -> list[Frame]:
        """Return the lines after the first ``written``, as far as they are kept."""
        new = self.written - written
        return list(self._lines)[-new:] if new > 0 else []

    def look(self, hearing: Hearing, news: list[TrackerNews]) -> None:
        """Write down what is new."""
        lines: list[tuple[str, str]] = []
        if hearing.state is not None:
            lines += self._run(hearing.state)
        lines += self._gates(hearing)
        for item in news:
            level = "info" if item.event in _GOOD_NEWS else "warning"
            lines.append((level, describe(item.event, item.tag, item.value)))
        for level, text in lines:
            self._lines.append(event(hearing.t_s, level, text))
        self.written += len(lines)

    def _run(self, state: RunState) -> Iterator[tuple[str, str]]:
        if state.phase != self._phase:
            self._phase = state.phase
            levels = (level for phase, level in _LEVELS.items() if phase == state.phase)
            yield next(levels, "info"), f"{phase_name(state)}: {run_cause(state, self._robots)}"
        for row, robot in enumerate(self._robots):
            halt = halt_cause(state, row) if state.phase == Phase.RUNNING else ""
            if halt != self._halts[row]:
                self._halts[row] = halt
                if halt:
                    yield "warning", f"{robot} stands: {halt}"
                elif state.phase == Phase.RUNNING:
                    yield "info", f"{robot} may move again"

    def _gates(self, hearing: Hearing) -> Iterator[tuple[str, str]]:
        for row, status in enumerate(hearing.statuses.newest):
            if status is None or status.latch in (self._latches[row], Latch.DRILL):
                continue
            self._latches[row] = status.latch
            if status.latch:
                yield "error", f"{self._robots[row]}: its gate is latched: {named(Latch, status.latch)}"
            else:
                yield "info", f"{self._robots[row]}: its latch is cleared"

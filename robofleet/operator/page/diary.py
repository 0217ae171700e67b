"""What happened in a run, line by line, as the page lists it."""

from collections import deque
from collections.abc import Iterator

from robofleet.bus.messages import RunState, TrackerNews
from robofleet.operator.page.frames import Frame, event
from robofleet.operator.page.hearing import Hearing
from robofleet.recording.lines import Line, busy_line, latch_line, news_line, said_line, state_lines
from robofleet.safety.latches import Latch

_KEPT = 100  # lines, for who opens the page later


class Diary:
    """Compares what is heard with what was heard before. ``written`` counts the lines since the beginning."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self._robots = robots
        self._lines: deque[Frame] = deque(maxlen=_KEPT)
        self._state: RunState | None = None
        self._busy = False
        self._latches: list[int] = [Latch.NONE] * len(robots)
        self.written = 0

    def since(self, written: int) -> list[Frame]:
        """Return the lines after the first ``written``, as far as they are kept."""
        new = self.written - written
        return list(self._lines)[-new:] if new > 0 else []

    def look(self, hearing: Hearing, news: list[tuple[str, TrackerNews]]) -> None:
        """Write down what is new."""
        lines: list[Line] = []
        if hearing.state is not None:
            lines += state_lines(self._state, hearing.state, self._robots)
            self._state = hearing.state
        if hearing.busy is not None and not self._busy:
            self._busy = True
            lines.append(busy_line(hearing.busy, self._robots))
        lines += self._gates(hearing)
        several = len(hearing.cameras) > 1
        lines += [news_line(item, camera if several else "") for camera, item in news]
        lines += [said_line(group, note.line) for group, note in hearing.notes if note.line is not None]
        for level, name, words in lines:
            line = words if name == "supervisor" else f"{name}: {words}"
            self._lines.append(event(hearing.t_s, level.name.lower(), line))
        self.written += len(lines)

    def _gates(self, hearing: Hearing) -> Iterator[Line]:
        for row, status in enumerate(robot.status for robot in hearing.robots):
            if status is None or status.latch in (self._latches[row], Latch.DRILL):  # the drill is in every start
                continue
            self._latches[row] = status.latch
            yield latch_line(self._robots[row], status.latch)

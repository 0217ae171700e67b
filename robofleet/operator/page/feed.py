"""From the bus to every open page. All of it runs in the event loop's thread, but for Zenoh's ``wake``.

A page is owed the newest tick and no other: it says which it has drawn, and one that draws slowly, or sleeps, is sent
fewer. So nothing grows behind a slow page, and no other page waits for it.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from robofleet.bus.bus import Bus
from robofleet.bus.keys import SHOWING, TICK
from robofleet.bus.messages import RunState, TrackerNews
from robofleet.bus.notes import Marks
from robofleet.config import groups
from robofleet.config.projectors import shown
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.core.valid_json import dumps
from robofleet.operator.page import frames
from robofleet.operator.page.frames import Frame, event
from robofleet.operator.page.hearing import Hearing
from robofleet.operator.page.words import end_words, phase_name
from robofleet.recording.lines import Level, Line, busy_line, latch_line, news_line, note_line, state_lines
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event
from robofleet.tracking.outlines import TagOutlines

_SUPERVISOR = "supervisor"
_MOST_LINES = 100  # lines, for who opens the page later


class Diary:
    """Makes lines of changes in the messages. ``written`` counts the lines since the beginning."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self._robots = robots
        self._lines: deque[Frame] = deque(maxlen=_MOST_LINES)
        self._state: RunState | None = None
        self._busy = False
        self._ends = ""
        self._latches: list[int] = [Latch.NONE] * len(robots)
        self.written = 0

    def since(self, written: int) -> list[Frame]:
        """Return the lines after the first ``written``, as far as they are kept."""
        new = self.written - written
        return list(self._lines)[-new:] if new > 0 else []

    def look(self, hearing: Hearing, news: list[tuple[str, TrackerNews]], ends: str = "") -> None:
        """Make lines of what is new; ``ends``: how the run ends, if it does."""
        lines: list[Line] = []
        if ends and not self._ends:
            self._ends = ends
            lines.append(Line(Level.INFO if ends.startswith("completed") else Level.WARNING, _SUPERVISOR, ends))
        if hearing.state is not None:
            changed = state_lines(self._state, hearing.state, self._robots)
            stopped = hearing.state.cause == Event.STOP_REQUESTED and self._ends  # by the launcher, which has said why
            lines += [line for line in changed if not (stopped and line.name == _SUPERVISOR)]
            self._state = hearing.state
        if hearing.busy is not None and not self._busy:
            self._busy = True
            lines.append(busy_line(hearing.busy, self._robots))
        lines += self._gates(hearing)
        several = len(hearing.cameras) > 1
        lines += [news_line(item, camera if several else "") for camera, item in news]
        lines += [note_line(group, note.line) for group, note in hearing.notes if note.line is not None]
        for level, name, words in lines:
            line = words if name == _SUPERVISOR else f"{name}: {words}"
            at_s = hearing.reached_s if self._ends else hearing.t_s
            self._lines.append(event(at_s, hearing.clock.clock_s, level.name.lower(), line))
        self.written += len(lines)

    def _gates(self, hearing: Hearing) -> Iterator[Line]:
        for row, status in enumerate(robot.status for robot in hearing.robots):
            if status is None or status.latch in (self._latches[row], Latch.DRILL):  # the drill is in every start
                continue
            self._latches[row] = status.latch
            yield latch_line(self._robots[row], status.latch)


_IDLE_POLL_NS = 100 * MS  # when nothing comes
_BEAT_NS = 90 * MS  # then the next look brings a beat: at least one in 200 ms
_MOST_UNDRAWN_TICKS = 4  # on their way to a page: 130 ms of a distant phone
_ANYWAY_NS = S  # a page that draws nothing is sent a tick so often, and when the phase changes
_MOST_ANSWERS = 16
_WHAT_IS_SHOWN = b"?"  # a server that begins asks the others: an operator may have switched it at one of them

Say = Callable[[str], Awaitable[None]]


class Feed:
    """Hears the run, and wakes the pages when there is something to show."""

    def __init__(self, config: Config, folder: Path, bus: Bus, clock: Clock, progress: Callable[[], str]) -> None:
        """``progress`` returns the newest line of the launcher: how far the start is, or how the run ends."""
        self.config, self.bus, self.now_ns, self._progress = config, bus, clock.now_ns, progress
        self.folder = folder
        self.ended: Frame | None = None  # how the run did, once it has
        self._loop, self._woken = asyncio.get_running_loop(), asyncio.Event()
        self._groups = groups.descriptions(config)
        self.hello = dumps(frames.hello(config, self._groups, folder))
        self._marks = [Marks() for _ in self._groups]  # of each group's scripts
        self.marked = 0  # changes of them
        self.show: tuple[str, ...] = config.projection.show  # what projectors show
        self.projectors = {projector.name for projector in config.projectors if projector.calibration is not None}
        self.showings = 1  # changes of it, and of who shows it
        self._say_show, self._newest_show = bus.publisher(SHOWING), bus.newest(SHOWING)
        self.hearing = Hearing(config, bus, clock, self._wake)
        self.diary = Diary(config.ids)
        self.pages: set[Page] = set()
        self.seq = 0  # of the newest tick frame
        self.record_ns = 0  # arrival of the record that made it; 0: none did
        self._looked_ns = 0
        self._tick: tuple[int, str] = (-1, "")
        self._pictures: dict[str, tuple[int, str]] = {}  # the newest of each camera that somebody looked at

    async def run(self) -> None:
        """Look whenever something comes, and ten times a second in any case; for ever."""
        self._say_show(_WHAT_IS_SHOWN)
        while True:
            try:
                async with asyncio.timeout(_IDLE_POLL_NS / S):
                    await self._woken.wait()
            except TimeoutError:
                pass
            self._woken.clear()
            self._look()

    def end(self, frame: Frame | None) -> None:
        """Tell every page how the run ended, those too that come later."""
        if frame is not None and self.ended is None:
            self.hearing.over = True
            self.diary.look(self.hearing, [], frame["text"])
        self.ended = frame
        for page in self.pages:
            page.wake()

    def tick(self) -> str:
        """Return the newest tick, made once for all pages."""
        if self._tick[0] != self.seq:
            now_ns = self.now_ns()
            frame = frames.tick(self.hearing, self.config, self._groups, self.seq, now_ns, self._progress())
            self._tick = self.seq, dumps(frame, compact=True)
        return self._tick[1]

    def picture(self, camera: str) -> tuple[int, str]:
        """Return a camera's newest picture's exposure [ns], 0 while there is none, and its frame."""
        shown = next((camera_state.shown for camera_state in self.hearing.cameras if camera_state.name == camera), None)
        before = self._pictures.get(camera, (0, ""))
        if shown is not None and shown.picture.exposure_ns != before[0]:
            frame = frames.picture(camera, shown, self.hearing.tags, self._outlines[camera])
            before = self._pictures[camera] = shown.picture.exposure_ns, dumps(frame, compact=True)
        return before

    def shapes(self) -> str:
        return dumps(frames.shapes(self._groups, [marks.shapes for marks in self._marks]), compact=True)

    def showing(self) -> str:
        return dumps(frames.showing(self.show, sorted(page.projects for page in self.pages if page.projects)))

    def now_shows(self, show: Sequence[str] | None = None) -> None:
        """Tell every page that something else is shown, or that somebody else shows it."""
        if show is not None and tuple(show) != self.show:
            self.show = tuple(show)
            self._say_show(" ".join(show).encode())
        self.showings += 1
        for page in self.pages:
            page.wake()

    def _mark(self) -> None:
        marks = {group.name: own for group, own in zip(self._groups, self._marks, strict=True)}
        self.marked += sum(marks[group].take(note.mark) for group, note in self.hearing.notes if note.mark is not None)

    def beat(self) -> str:
        return dumps(frames.beat(self.hearing, self.now_ns()))

    @property
    def phase(self) -> str:
        return phase_name(self.hearing.state)

    @cached_property
    def _outlines(self) -> dict[str, TagOutlines]:
        return {view.camera.name: TagOutlines(view) for view in self.config.views}

    def _wake(self, _arrival_ns: int) -> None:
        """Say that something came (from Zenoh's thread)."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._woken.set)

    def _look(self) -> None:
        now_ns, before = self.now_ns(), self.hearing.record
        new = self.hearing.hear()
        if not new and now_ns - self._looked_ns < _IDLE_POLL_NS:
            return
        self._looked_ns = now_ns
        self.diary.look(self.hearing, self.hearing.hear_the_rest(), end_words(self._progress()))
        self._mark()
        words = self._newest_show.take()  # another server's, or its own
        if words == _WHAT_IS_SHOWN and self.show != self.config.projection.show:
            self._say_show(" ".join(self.show).encode())
        elif words is not None and (show := shown(words)) is not None and show != self.show:
            self.show, self.showings = show, self.showings + 1
        self.seq += 1
        self.record_ns = self.hearing.run.arrival_ns(TICK) if self.hearing.record is not before else 0
        for page in self.pages:
            page.wake()


class Page:
    """One open page: what it was sent, and what it has drawn."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self._woken = asyncio.Event()
        self._answers: deque[Frame] = deque(maxlen=_MOST_ANSWERS)
        self._undrawn: deque[tuple[int, int]] = deque()  # ticks sent: number, and arrival of its record [ns]
        self._seq = -1  # of the newest tick sent
        self._sent_ns = 0
        self._phase = ""  # that it was sent last
        self._beat_ns = 0
        self._marked = 0  # of the feed's changes of marks that it was sent
        self._marked_ns = 0
        self._written = 0  # lines of the diary sent
        self._pictured = "", 0  # camera and exposure of the newest picture sent
        self._ended: Frame | None = None  # that it was told
        self._left = False
        self._showings = 0  # of the feed's that it was told
        self.projects: tuple[str, tuple[int, int]] | None = None  # a projector's page: its name, its size [px]
        self.wants_picture = ""  # the camera's name; empty: none

    def wake(self) -> None:
        self._woken.set()

    def tell(self, frame: Frame) -> None:
        self._answers.append(frame)
        self.wake()

    def hear(self, request: Any) -> bool:
        """Take what the page says of itself: what it draws, wants and is; returns whether that makes sense."""
        match request:
            case {"ack": int(seq)}:
                self.drawn(seq)
            case {"projector": str(name), "size_px": [int(width), int(height)]} if name in self._feed.projectors:
                self.projects = name, (width, height)
                self._feed.now_shows()
            case {"picture": str() | False as wanted}:  # a camera's name
                self.wants_picture = wanted or ""
                self.wake()
            case _:
                return False
        return True

    def drawn(self, seq: int) -> None:
        """Take note of a tick that the page has drawn, and with it all before."""
        waits = len(self._undrawn) >= _MOST_UNDRAWN_TICKS
        while self._undrawn and self._undrawn[0][0] <= seq:
            self._undrawn.popleft()
        if waits:
            self.wake()

    def leave(self) -> None:
        """Let ``follow`` return, when what is owed is sent."""
        self._left = True
        self.wake()

    async def follow(self, say: Say) -> None:
        """Send what the page is owed, until it is left."""
        await say(self._feed.hello)
        while True:
            for text in self._owed():
                await say(text)
            if self._left:
                return
            await self._woken.wait()
            self._woken.clear()

    def _owed(self) -> Iterator[str]:
        """Yield what is to be sent; each is made when the one before is gone, so that it is the newest."""
        feed = self._feed
        while self._answers:
            yield dumps(self._answers.popleft())
        if feed.ended is not None and feed.ended is not self._ended:
            self._ended = feed.ended
            yield dumps(feed.ended)
        if self._tick_due():
            self._seq, self._sent_ns, self._phase = feed.seq, feed.now_ns(), feed.phase
            self._undrawn.append((feed.seq, feed.record_ns))
            yield feed.tick()
        if feed.marked != self._marked and feed.now_ns() - self._marked_ns >= _BEAT_NS:
            self._marked, self._marked_ns = feed.marked, feed.now_ns()
            yield feed.shapes()
        if feed.showings != self._showings and feed.config.projectors:
            self._showings = feed.showings
            yield feed.showing()
        if feed.now_ns() - self._beat_ns >= _BEAT_NS:
            self._beat_ns = feed.now_ns()
            yield feed.beat()
        lines, self._written = feed.diary.since(self._written), feed.diary.written
        yield from map(dumps, lines)
        exposure_ns, picture = feed.picture(self.wants_picture) if self.wants_picture else (0, "")
        if exposure_ns and (self.wants_picture, exposure_ns) != self._pictured:
            self._pictured = self.wants_picture, exposure_ns
            yield picture

    def _tick_due(self) -> bool:
        if self._feed.seq == self._seq:
            return False
        if len(self._undrawn) >= _MOST_UNDRAWN_TICKS:
            if self._feed.phase == self._phase and self._feed.now_ns() - self._sent_ns < _ANYWAY_NS:
                return False
            self._undrawn.popleft()
        return True

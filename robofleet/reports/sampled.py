"""A run that is too long for memory: some of its ticks in columns, and the figures of all its ticks."""

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.keys import BUSY, NOTE, SENSORS, Topic, named
from robofleet.bus.messages import RunState
from robofleet.core.arrays import Array
from robofleet.recording.reading import TOGETHER, Imports, nothing_imported, parts
from robofleet.recording.reduced import joined
from robofleet.recording.run import Own, Run
from robofleet.reports.metrics import reduced

_MOST_TICK_BYTES = 24 << 20  # a quarter to half an hour of four robots
_STATUS_STEP = 64  # of so many statuses one tells what time it was
_WHOLE_TOPICS = BUSY, NOTE, SENSORS  # topics of which every message is kept


class _Ticks(NamedTuple):
    """Some ticks of a run: which they are, their records, the true poses of all bodies at them."""

    rows: NDArray[np.int64]
    ticks: NDArray[Any]
    bodies: Array

    def at(self, which: Any) -> "_Ticks":
        """Return some of them, in memory of their own."""
        return _Ticks(*(column[which].copy() for column in self))

    def every(self, count: int) -> "_Ticks":
        """Return each of so many."""
        return self.at(self.rows % count == 0)


class Sampled(Run):
    """Every n-th tick of a run in columns, and the last one; its phases, its news, its figures of all ticks."""

    def __init__(self) -> None:
        """Begin with nothing: ``taking`` takes the parts of a run in order, ``run`` puts them together."""
        self._whole: Run | None = None  # of a short run: its only part
        self.own, self.every = Own(), 1
        self._count = 0  # ticks so far
        self._kept: list[_Ticks] = []
        self._known: list[NDArray[np.bool_]] = []
        self._ends: list[NDArray[Any]] = []  # first and last tick, also of those in which the fleet was not running
        self._instants: list[tuple[NDArray[Any], NDArray[Any]]] = []
        self._news: list[tuple[NDArray[Any], NDArray[Any]]] = []
        self._messages: list[tuple[str, bytes]] = []
        self.states: list[tuple[int, RunState]] = []

    def taking(self, parts: Iterable[Run]) -> Iterator[Run]:
        """Yield the parts of a run, and take each."""
        for part in parts:
            if part.own == Own(0):
                self._whole = part
            else:
                self._add(part)
            yield part
            del part  # before the next one is read

    def run(self) -> Run:
        """Return the run that was taken: all of a short one."""
        if self._whole is None:
            self._close()
        return self._whole or self

    def _add(self, run: Run) -> None:
        figures = reduced(run, peaks=True)
        self.reduced = figures if self.reduced is None else joined([self.reduced, figures])
        self.recording, self.config = run.recording, run.config
        self.start_ns, self.began = run.start_ns, run.began
        self._add_ticks(run)
        self._known.append(run.all_known)
        if len(run.all_ticks):
            self._ends = [*self._ends[:1], run.all_ticks[[0, -1]]]
        stamps, places = run.instants
        self._instants.append((stamps[::_STATUS_STEP].copy(), places[::_STATUS_STEP].copy()))
        self._news.append((run.news, run.news_of))
        first, until = run.own.first, run.own.until
        for at, state in run.states:
            if first <= at < until and not (self.states and state.repeats(self.states[-1][1])):
                self.states.append((at, state))
        for full in run.recording.messages:
            if (about := named(full)) is not None and about[0] in _WHOLE_TOPICS:
                self._messages += [(full, payload) for payload in run.recording.between(full, first, until)]

    def _add_ticks(self, run: Run) -> None:
        rows = np.arange(self._count, self._count + len(run.ticks))
        self._count += len(rows)
        unknown = np.full((len(rows), len(run.config.bodies), 3), np.nan)
        ticks = _Ticks(rows, run.ticks, unknown if run.bodies is None else run.bodies)
        if len(rows):
            self._newest = ticks.at(slice(-1, None))
        self._kept.append(ticks.every(self.every))
        while sum(kept.ticks.nbytes for kept in self._kept) > _MOST_TICK_BYTES:
            self.every *= 2
            self._kept = [kept.every(self.every) for kept in self._kept]

    def _close(self) -> None:
        kept, self._kept = self._kept, []
        if self._count and (self._count - 1) % self.every:
            kept.append(self._newest)
        count, self.recording = self.recording.count, self.recording.emptied()
        for full, payload in self._messages:
            self.recording.add(full, payload)
        self.recording.count = count
        self._take(np.concatenate([part.ticks for part in kept]))
        known = np.logical_or.reduce(self._known)
        self._know(np.concatenate([part.bodies for part in kept]) if known.any() and self._count else None, known)
        self.all_ticks = np.concatenate(self._ends) if self._ends else self.ticks
        stamps, places = zip(*self._instants, strict=True)
        self.instants = np.concatenate(stamps), np.concatenate(places)
        news, owners = zip(*self._news, strict=True)
        self.news, self.news_of = np.concatenate(news), np.concatenate(owners)
        self.images = {camera: [] for camera in self.config.camera_names}
        self.frames = []


def look(run: Path, imports: Imports = nothing_imported, together: int = TOGETHER) -> Run:
    """Return a run in columns; of a long one some ticks. ``imports``, ``together``: as of ``reading.parts``.

    Raises:
        RecordingError: if there is none that can be read.
    """
    sampled = Sampled()
    deque(sampled.taking(looks(run, imports, together)), maxlen=0)
    return sampled.run()


def looks(
    run: Path,
    imports: Imports = nothing_imported,
    together: int = TOGETHER,
    topics: Collection[Topic] | None = None,
) -> Iterator[Run]:
    """Yield a run in columns part by part: every tick of it. ``topics``: only what these say; None: all."""
    begun = Own()
    for recording, own in parts(run, imports, together=together, topics=topics):
        part = Run(recording, own=begun._replace(first=own.first, until=own.until, last=own.last))
        begun = Own(start_ns=part.start_ns, began=part.began, newest=part.newest)
        yield part
        del part, recording  # before the next one is read

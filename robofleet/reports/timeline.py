"""What happened in a run, on one time axis: phases, stops, news of the tracker, overruns, faults that were injected."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.config.troubles import InjectedFault
from robofleet.recording import notes
from robofleet.recording.causes import named, run_cause
from robofleet.recording.reduced import Moment
from robofleet.recording.run import Run
from robofleet.safety.supervisor import Phase
from robofleet.tracking.events import NO_TAG, describe

RUN, TRACKER, CONTROLLER, FAULTS = "run", "tracker", "controller", "faults"
_IDLE_SHOWN_S = 3.0  # before the checks of a start
_TOGETHER_NS = 500_000_000  # what happens again so soon is one entry


class Entry(NamedTuple):
    """Something that happened."""

    t_s: float  # clock time: since the run's first tick; before it negative
    until_s: float  # the same, where it took no time
    who: str  # RUN, TRACKER, CONTROLLER, FAULTS, or a robot's id
    what: str
    stop: bool = False


class Span(NamedTuple):
    """A phase of the run."""

    t_s: float
    until_s: float
    phase: int
    name: str
    cause: str


class Timeline:
    """Everything that happened, in order. Without a tick of a run, times count from the first message."""

    def __init__(self, run: Run, stops: Sequence[dict[str, Any]]) -> None:
        """Collect; ``stops`` are the summary's."""
        self._run = run
        self._stamps, self._places = run.instants
        begun = (run.ticks["stamp_ns"], self._stamps, run.all_ticks["stamp_ns"])
        self._zero_ns = next((int(stamps[0]) for stamps in begun if len(stamps)), 0)
        ends = (self._stamps, run.all_ticks["stamp_ns"])
        lasts = [(int(stamps[-1]) - self._zero_ns) / 1e9 for stamps in ends if len(stamps)]
        self.begin_s = min(0.0, self._seconds(self._stamps[:1]).min(initial=0.0))
        self.end_s = max([0.0, *lasts])
        self.phases = list(self._spans())
        awake = next((span.t_s for span in self.phases if span.phase != Phase.IDLE), self.begin_s)
        self.shown_s = max(self.begin_s, awake - _IDLE_SHOWN_S)  # kernels may have been compiled for a minute before
        phases = [Entry(s.t_s, s.t_s, RUN, f"{s.name}: {s.cause}" if s.cause else s.name) for s in self.phases]
        halts = [Entry(s["t_s"], s["t_s"], s["robot"], s["cause"], stop=True) for s in stops]
        found = *phases, *halts, *self._moments(), *self._faults()
        self.entries = sorted(found, key=lambda entry: entry.t_s)

    def run_time_s(self, entry: Entry) -> float | None:
        """Return the run time of an entry; None before the start."""
        run_s = float(self._run.clock.run_time_s(self._zero_ns + round(entry.t_s * 1e9)))
        return None if math.isnan(run_s) else run_s

    def _seconds(self, stamps: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray((stamps - self._zero_ns) / 1e9, dtype=np.float64)

    def _spans(self) -> Iterator[Span]:
        """Yield the phases; a state has no stamp of its own: it was said when the statuses around it were."""
        places = [starts for starts, _ in self._run.states]
        known = len(self._places) > 0
        times = np.interp(places, self._places, self._seconds(self._stamps)) if known else np.zeros(len(places))
        changes = [
            (float(t), state)
            for k, (t, (_, state)) in enumerate(zip(times, self._run.states, strict=True))
            if k == 0 or state.phase != self._run.states[k - 1][1].phase
        ]
        robots = self._run.config.ids
        for k, (t, state) in enumerate(changes):
            until = changes[k + 1][0] if k + 1 < len(changes) else max(t, self.end_s)
            cause = run_cause(state, robots) if state.cause else ""
            yield Span(t, until, state.phase, named(Phase, state.phase), cause)

    def _moments(self) -> Iterator[Entry]:
        run = self._run
        for moment in moments(run) if run.reduced is None else run.reduced.moments:
            first, last = ((ns - self._zero_ns) / 1e9 for ns in (moment.first_ns, moment.last_ns))
            yield Entry(first, last, moment.who, moment.what)

    def _faults(self) -> Iterator[Entry]:
        for fault in self._run.config.faults:
            begin = self.begin_s if fault.at_s is None else fault.at_s
            until = self.end_s if fault.duration_s is None else begin + fault.duration_s
            if begin <= self.end_s:
                yield Entry(begin, min(until, self.end_s), FAULTS, _in_words(fault))


def moments(run: Run) -> Iterator[Moment]:
    """Yield the tracker's news, what was overrun, what the barrier did and what scripts said in a run, or a part."""
    yield from _news(run)
    yield from _overruns(run)
    yield from _barrier(run)
    yield from _notes(run)


def _news(run: Run) -> Iterator[Moment]:
    robots = {robot.tag: robot.id for robot in run.config.robots}
    several = len(run.images) > 1
    for row, camera in zip(run.news, run.news_of, strict=True):
        tag, named, at_ns = int(row["tag"]), str(camera) if several else "", int(row["stamp_ns"])
        who = TRACKER if tag == NO_TAG else robots.get(tag, TRACKER)
        yield Moment(at_ns, at_ns, who, describe(int(row["event"]), tag, float(row["value"]), named))


def _overruns(run: Run) -> Iterator[Moment]:
    ticks = run.all_ticks
    before = (run.before if len(run.before) else ticks[:1])["overruns"].astype(np.int64)
    count = np.diff(ticks["overruns"].astype(np.int64), prepend=before)
    for first, last in _episodes(ticks["stamp_ns"], count > 0):
        many = int(count[first : last + 1].sum())
        at_ns = int(ticks["stamp_ns"][first]), int(ticks["stamp_ns"][last])
        yield Moment(*at_ns, CONTROLLER, f"{many} tick{'s' * (many > 1)} overrun")


def _barrier(run: Run) -> Iterator[Moment]:
    stamps = run.ticks["stamp_ns"]
    for row, robot in enumerate(run.config.members):
        for first, last in _episodes(stamps, run.items["filtered"][:, row] > 0):
            first_ns, last_ns = int(stamps[first]), int(stamps[last])
            took = (last_ns - first_ns) / 1e9 + run.config.controller.tick_s
            yield Moment(first_ns, last_ns, robot.id, f"the barrier changed its command for {took:.2f} s")


def _notes(run: Run) -> Iterator[Moment]:
    """Yield what scripts said; a note has no stamp of its own: it knows the newest tick."""
    stamps: dict[int, int] = {}
    for group in run.groups:
        for note in notes.of_group(run.recording, group.name, run.own):
            if note.line is None:
                continue
            if not stamps:
                stamps = dict(zip(run.near["tick"].tolist(), run.near["stamp_ns"].tolist(), strict=True))
            if (at_ns := stamps.get(note.echo_tick)) is not None:
                yield Moment(at_ns, at_ns, group.name, note.line)


def _in_words(fault: InjectedFault) -> str:
    given = fault.model_dump(exclude={"kind", "at_s", "duration_s"}, exclude_none=True, exclude_defaults=True)
    values = (
        f"{key} {', '.join(map(str, value)) if isinstance(value, tuple | list) else value}"
        for key, value in given.items()
    )
    return f"{fault.kind.replace('_', ' ')} ({'; '.join(values)})" if given else fault.kind.replace("_", " ")


def _episodes(stamps_ns: NDArray[Any], on: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of every time that something is on; shortly after one another is one."""
    where = np.flatnonzero(on)
    if not len(where):
        return []
    breaks = np.flatnonzero(np.diff(stamps_ns[where]) > _TOGETHER_NS)
    return list(zip(where[[0, *(breaks + 1)]].tolist(), where[[*breaks, -1]].tolist(), strict=True))

"""The end of a run, as its page tells it: the verdict of its summary, its report, and how long the page stays."""

from collections.abc import Callable
from pathlib import Path

from robofleet.bus.messages import RunState
from robofleet.core.clock import Clock, S
from robofleet.operator.page.frames import Frame
from robofleet.operator.page.verdict import REPORT, Verdict, verdict_of
from robofleet.operator.page.words import phase_name
from robofleet.recording.causes import run_cause
from robofleet.safety.supervisor import Phase

STAYS_MIN = 10  # after the end, while somebody looks
_RELOAD_NS = 3 * S  # a page that is loaded again is back within
_SUMMARY_WITHIN_NS = 15 * S  # of the end of a run
_UNKNOWN = "How the run ended is not known: look at the robots."


class Ending:
    """Says whether a run is over, and what is known of it then. ``over`` may look at files."""

    def __init__(self, folder: Path, clock: Clock, over: Callable[[], bool], *, patient: bool) -> None:
        """``patient``: stay for the summary also where nobody looks: who started the page by hand is told."""
        self._folder, self._clock, self._over, self._patient = folder, clock, over, patient
        self._over_ns = 0
        self._looked_ns: int | None = None  # when somebody looked last
        self._reported = False
        self.verdict: Verdict | None = None
        self.frame: Frame | None = None  # what the pages are told; None while the run is on

    def look(self, state: RunState | None, robots: tuple[str, ...], *, watched: bool) -> bool:
        """Look at how things stand; returns whether there is something new for the pages."""
        now_ns = self._clock.now_ns()
        if watched:
            self._looked_ns = now_ns
        if not self._over_ns:
            if not self._over():
                return False
            self._over_ns = now_ns
        before = self.frame
        if self.verdict is None:
            self.verdict = verdict_of(self._folder)
        self._reported = self._reported or (self._folder / REPORT).is_file()
        self.frame = _frame(self._folder, self.verdict or _verdict_of_state(state, robots), reported=self._reported)
        return self.frame != before

    @property
    def done(self) -> bool:
        if not self._over_ns:
            return False
        now_ns = self._clock.now_ns()
        since_ns = now_ns - self._over_ns
        if self._patient and self.verdict is None and since_ns <= _SUMMARY_WITHIN_NS:
            return False
        watched = self._looked_ns is not None and now_ns - self._looked_ns <= _RELOAD_NS
        return not watched or since_ns > STAYS_MIN * 60 * S


def _verdict_of_state(state: RunState | None, robots: tuple[str, ...]) -> Verdict:
    """Return what the supervisor said last, while there is no summary."""
    if state is None:
        return Verdict(_UNKNOWN, (), None)
    where = "" if state.phase == Phase.IDLE else f"{phase_name(state)}: "
    return Verdict(f"{where}{run_cause(state, robots)}", (), None)


def _frame(folder: Path, verdict: Verdict, *, reported: bool) -> Frame:
    return {
        "type": "ended",
        "text": verdict.headline,
        "lines": list(verdict.lines),
        "good": verdict.good,
        "report": str(folder / REPORT) if reported else None,
        "folder": str(folder),
        "stays_min": STAYS_MIN,
    }

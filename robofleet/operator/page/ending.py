"""The end of a run, as its page tells it: the verdict of its summary, its report, and how long the page stays."""

from contextlib import suppress
from typing import TYPE_CHECKING

from robofleet.bus.messages import RunState
from robofleet.core.clock import S
from robofleet.core.errors import BadInputError
from robofleet.nodes.unit.state_store import StoredLatch
from robofleet.operator.asking import Outcome
from robofleet.operator.latches import are_simulated, cleared, latched_words, of_run
from robofleet.operator.page.frames import Frame
from robofleet.operator.page.verdict import REPORT, Verdict, verdict_of
from robofleet.operator.page.words import ENDED, end_words, phase_name
from robofleet.recording.causes import run_cause
from robofleet.safety.supervisor import Phase

if TYPE_CHECKING:
    from robofleet.operator.page.server import Served

STAYS_MIN = 10  # after the end, while somebody looks
_RELOAD_NS = 3 * S  # a page that is loaded again is back within
_SUMMARY_WITHIN_NS = 15 * S  # of the end of a run
_DRIVERS_END_NS = 2 * S  # after the end of the run; until then they keep their latches
_LATCHES_NS = S  # between two readings of what they left
_KILLED = (
    "The command that ran it was killed, or it crashed. Its processes end with it, and every gate closes: "
    "look at the robots."
)
_UNKNOWN = "How the run ended is not known: look at the robots."


class Ending:
    """Says whether a run is over, and what is known of it then."""

    def __init__(self, served: "Served") -> None:
        self._served, self._folder, self._clock = served, served.folder, served.clock
        self._over_ns = 0
        self._looked_ns: int | None = None  # when somebody looked last
        self._reported = False
        self._latches: tuple[StoredLatch, ...] | None = None  # None: not known
        self._cleared = ""  # what came of a reset
        self._latches_ns = 0  # when they were read
        self.verdict: Verdict | None = None
        self.frame: Frame | None = None  # what the pages are told; None while the run is on

    def look(self, state: RunState | None, robots: tuple[str, ...], *, watched: bool) -> bool:
        """Look at how things stand; returns whether there is something new for the pages. It may look at files."""
        now_ns = self._clock.now_ns()
        if watched:
            self._looked_ns = now_ns
        if not self._over_ns:
            if not self._served.over():
                return False
            self._over_ns = now_ns
        before = self.frame
        if self.verdict is None:
            self.verdict = verdict_of(self._folder)
        self._reported = self._reported or (self._folder / REPORT).is_file()
        if now_ns - max(self._latches_ns, self._over_ns + _DRIVERS_END_NS - _LATCHES_NS) >= _LATCHES_NS:
            self._latches_ns = now_ns
            with suppress(OSError):
                self._latches = of_run(self._served.config)
        self.frame = self._frame(self.verdict or self._unjudged(state, robots))
        return self.frame != before

    def reset(self) -> Outcome:
        """Clear the latches that the run has left, where nothing of it was real."""
        try:
            latches = of_run(self._served.config)
            if not are_simulated(latches):
                return False, self._how_to_reset
            done, self._cleared = cleared(self._served.config.arena.name, latches)
            return done, self._cleared
        except (BadInputError, OSError) as error:
            return False, str(error)
        finally:
            self._latches_ns = 0  # the next look sees what came of it

    @property
    def _how_to_reset(self) -> str:
        return f"Look at the robots, then clear it with: robofleet reset {self._served.config.arena.name}"

    def _unjudged(self, state: RunState | None, robots: tuple[str, ...]) -> Verdict:
        """Return how the run ended while there is no summary: by the launcher's last words, or the supervisor's."""
        if words := end_words(self._served.line()):
            return Verdict(f"{words[0].upper()}{words[1:]}", (), None)
        if state is None:
            return Verdict(_UNKNOWN, (), None)
        if state.phase not in ENDED:
            return Verdict(_KILLED, (f"Its recording is completed by: robofleet repair {self._folder}",), False)
        where = "" if state.phase == Phase.IDLE else f"{phase_name(state)}: "
        return Verdict(f"{where}{run_cause(state, robots)}", (), None)

    def _frame(self, verdict: Verdict) -> Frame:
        latches, folder = self._latches, self._folder
        resets = bool(latches) and are_simulated(latches or ())
        how = "All of it was simulated." if resets else self._how_to_reset
        return {
            "type": "ended",
            "text": verdict.headline,
            "lines": list(verdict.lines),
            "good": verdict.good,
            "report": str(folder / REPORT) if self._reported else None,
            "report_due": not self._reported and self._served.launcher_lives(),
            "latched": None if latches is None else [stored.robot for stored in latches],
            "latched_words": f"{latched_words(latches)}. {how}" if latches else self._cleared,
            "resets": resets,
            "folder": str(folder),
            "stays_min": STAYS_MIN,
        }

    @property
    def done(self) -> bool:
        if not self._over_ns:
            return False
        now_ns = self._clock.now_ns()
        since_ns = now_ns - self._over_ns
        if self._served.by_hand and self.verdict is None and since_ns <= _SUMMARY_WITHIN_NS:
            return False
        watched = self._looked_ns is not None and now_ns - self._looked_ns <= _RELOAD_NS
        return not watched or since_ns > STAYS_MIN * 60 * S

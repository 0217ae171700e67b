"""How far a start is, and how long it still takes: the same figure for the terminal, the page and a pipe.

What is to be done is counted in seconds of one core of the machine on which it was measured. How fast this machine
does it is seen at what it has done so far.
"""

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import NamedTuple, Self

from robofleet.core.clock import S, stopwatch_ns
from robofleet.core.compiling import Progress
from robofleet.core.folders import kernels_folder
from robofleet.core.kernels import SHIPPED

# What a process compiles where nothing is compiled yet, before it says so itself: by the beginning of its name.
_COMPILING_S = {"tracker": 15.0, "controller": 17.0, "driver": 3.5, "supervisor": 3.0}
_MARK = "starting"
_EXPECTED_S = 1.0  # of work at the expected speed: by so much is a machine known before it has done anything
_SMOOTH_S = 2.0  # in which the shown time follows the estimated one
_LEAST_LEFT_S = 0.5
_SURE = 0.5  # of an estimate that has passed without news, so much is left at least
_ALMOST = 0.99
_FEW_FILES = 20  # of kernels: what a check of a configuration compiles
_FOLLOW_S = 0.1


class Starting(NamedTuple):
    """A start as it stands."""

    share: float  # of its time, from 0 to 1
    left_s: float  # about
    doing: str

    def encode(self) -> str:
        """Return it as a line, for the process of the operator's page."""
        return f"{_MARK} {self.share:.2f} {self.left_s:.1f} {self.doing}"

    @classmethod
    def decode(cls, line: str) -> Self | None:
        """Return the start that a line says; None where it says something else."""
        mark, _, rest = line.partition(" ")
        if mark != _MARK:
            return None
        share, left_s, doing = rest.split(" ", 2)
        return cls(float(share), float(left_s), doing)

    def words(self) -> str:
        return f"{self.short()}: {self.doing}"

    def short(self) -> str:
        return f"{100 * self.share:.0f} %, about {max(1.0, self.left_s):.0f} s left"


class _Work(NamedTuple):
    done_s: float
    left_s: float


class Start:
    """Takes what each process of a start says, and tells how far the whole is."""

    def __init__(
        self, names: Iterable[str], *, loading_s: float, checks_s: float, cores: int | None = None,
        now_ns: Callable[[], int] = stopwatch_ns,
    ) -> None:  # fmt: skip
        """``loading_s``: until a process is there, or compiles; ``checks_s``: from the last one until wheels drive."""
        self._loading_s, self._checks_s, self._now_ns = loading_s, checks_s, now_ns
        self._cores = cores or len(os.sched_getaffinity(0))
        files = [file for folder in (SHIPPED, kernels_folder()) for file in folder.glob("*-*-*")]
        cold = len(files) < _FEW_FILES
        self._works = {name: _Work(0.0, loading_s + (_compiling_s(name) if cold else 0.0)) for name in names}
        self._progress: dict[str, Progress] = {}
        self._ready: set[str] = set()
        self._began_ns = self._news_ns = self._looked_ns = now_ns()
        self._pace = 1.0  # of this machine: seconds for a second of work
        self._checking_ns, self._checking = 0, ""
        self._end_ns = 0.0  # as it is shown; 0: not yet
        self._share = 0.0

    def compiles(self, name: str, progress: Progress) -> None:
        """Take how far a process is that compiles."""
        if self._progress.get(name) != progress and name not in self._ready:
            self._progress[name] = progress
            self._take(name, _Work(self._loading_s + progress.done_s, progress.work_s - progress.done_s))

    def ready(self, name: str) -> None:
        """Take that a process is there."""
        if name not in self._ready:
            self._ready.add(name)
            work_s = 0.0
            if (progress := self._progress.get(name)) is not None:  # another process has compiled what it has not
                work_s = progress.work_s
                self._progress[name] = progress._replace(done=progress.total)
            self._take(name, _Work(self._loading_s + work_s, 0.0))

    def checks(self, words: str) -> None:
        """Take what is checked, when every process is there."""
        self._checking, self._checking_ns = words, self._checking_ns or self._now_ns()

    def look(self) -> Starting:
        """Return how far it is now."""
        now_ns = self._now_ns()
        left_s = self._left_s(now_ns)
        follows = min(1.0, (now_ns - self._looked_ns) / S / _SMOOTH_S)
        self._looked_ns = now_ns
        self._end_ns = self._end_ns or now_ns + left_s * S
        self._end_ns += (now_ns + left_s * S - self._end_ns) * follows
        left_s, elapsed_s = max(_LEAST_LEFT_S, (self._end_ns - now_ns) / S), (now_ns - self._began_ns) / S
        self._share = min(_ALMOST, max(self._share, elapsed_s / (elapsed_s + left_s)))
        return Starting(self._share, left_s, self._doing())

    def _take(self, name: str, work: _Work) -> None:
        self._works[name], self._news_ns = work, self._now_ns()
        left_s = self._lasts_s(work.left_s for work in self._works.values())
        done_s = self._lasts_s(work.done_s + work.left_s for work in self._works.values()) - left_s
        self._pace = ((self._news_ns - self._began_ns) / S + _EXPECTED_S) / (done_s + _EXPECTED_S)

    def _left_s(self, now_ns: int) -> float:
        if self._checking_ns:
            return max(_LEAST_LEFT_S, self._checks_s - (now_ns - self._checking_ns) / S)
        left_s = self._pace * self._lasts_s(work.left_s for work in self._works.values())
        return max(left_s - (now_ns - self._news_ns) / S, _SURE * left_s) + self._checks_s

    def _lasts_s(self, works_s: Iterable[float]) -> float:
        """Return how long the processes take together: a process has one core."""
        each_s = [*works_s]
        return max(*each_s, sum(each_s) / self._cores, 0.0)

    def _doing(self) -> str:
        if self._checking_ns:
            return self._checking
        if any(name not in self._ready for name in self._progress):
            each = self._progress.values()
            return f"compiling kernels, {sum(p.done for p in each)} of {sum(p.total for p in each)}"
        return f"processes, {len(self._ready)} of {len(self._works)} ready"


def _compiling_s(name: str) -> float:
    return next((seconds for start, seconds in _COMPILING_S.items() if name.startswith(start)), 0.0)


@contextmanager
def followed(start: Start, show: Callable[[Starting], None]) -> Iterator[None]:
    """Show how far a start is, again and again from a thread: this one is busy with the start."""
    over = threading.Event()

    def follow() -> None:
        while not over.wait(_FOLLOW_S):
            show(start.look())

    show(start.look())
    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

"""Progress of many runs on stderr, with the time left: a bar on a terminal, else a line every ten seconds."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from robofleet.config.files.yamlfile import printable
from robofleet.core.clock import S, stopwatch_ns

_LINE_NS = 10 * S
_RATE_WINDOW_S = 600.0  # of the estimate of the time left


class Bar:
    """Counts what is finished and what failed."""

    def __init__(self, what: str, total: int, done: int, progress: Progress) -> None:
        self._what, self._total, self._done, self._failed = what, total, done, 0
        self._began_ns, self._before = stopwatch_ns(), done
        self._next_ns = self._began_ns + _LINE_NS
        self._progress = progress
        self._task = progress.add_task(what, total=total, completed=done)

    def add(self, *, failed: bool = False) -> None:
        self._done += 1
        self._failed += failed
        words = f"{self._what}, {self._failed} failed" if self._failed else self._what
        self._progress.update(self._task, completed=self._done, description=words)
        if not self._progress.console.is_terminal and stopwatch_ns() >= self._next_ns:
            self._next_ns = stopwatch_ns() + _LINE_NS
            print(f"{words}: {self._done:,} of {self._total:,}, {self._left()} left", file=sys.stderr, flush=True)

    @property
    def failed(self) -> int:
        return self._failed

    def say(self, *lines: str) -> None:
        for line in lines:
            self._progress.console.print(printable(line), markup=False, highlight=False, soft_wrap=True)

    def _left(self) -> str:
        rate = (stopwatch_ns() - self._began_ns) / S / (self._done - self._before)
        minutes, seconds = divmod(round(rate * (self._total - self._done)), 60)
        return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"


@contextmanager
def bar(what: str, total: int, done: int = 0) -> Iterator[Bar]:
    """Show a bar; ``done``: how many of the total were finished before."""
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(
        *columns, console=(console := Console(stderr=True)), speed_estimate_period=_RATE_WINDOW_S,
        disable=not console.is_terminal,
    ) as progress:  # fmt: skip
        yield Bar(what, total, done, progress)

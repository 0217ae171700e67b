"""A start as the terminal shows it: one bar, or lines where stderr is no terminal."""

import sys
from typing import Self

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from robofleet.core.clock import S, stopwatch_ns
from robofleet.core.starting import Starting

_LINE_NS = 10 * S
_LONG_S = 10.0  # a start of which so much is left lasts
_BAR_COLUMNS = 50


def start_bar(starting: Starting) -> Group:
    line = Table.grid(padding=(0, 3, 0, 0))
    line.add_column(no_wrap=True)
    line.add_row(
        Text(f"starting {starting.short()}", "bold cyan"), ProgressBar(1.0, starting.share, width=_BAR_COLUMNS)
    )
    return Group(line, Text(starting.doing, "cyan"))


class StartLines:
    """Writes a line at once, one where the phase changes, and one every ten seconds."""

    def __init__(self, *, long_ones: bool = False) -> None:
        """``long_ones``: only where a start lasts."""
        self._long_ones = long_ones
        self._phase, self._next_ns = "", 0

    def __call__(self, starting: Starting, phase: str = "starting") -> None:
        now_ns = stopwatch_ns()
        if self._long_ones and starting.left_s < _LONG_S:
            return
        if phase != self._phase or now_ns >= self._next_ns:
            self._phase, self._next_ns = phase, now_ns + _LINE_NS
            print(f"starting {starting.words()}", file=sys.stderr, flush=True)


class StartView:
    """Shows the start of a script's run; nothing of it stays in a terminal."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._lines = StartLines(long_ones=True)

    def __call__(self, starting: Starting) -> None:
        if self._live is None:
            self._lines(starting)
        else:
            self._live.update(start_bar(starting), refresh=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

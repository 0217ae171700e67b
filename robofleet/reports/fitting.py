"""Tables for terminals of any width: what does not fit is left out, the least important first, and that is said."""

from collections.abc import Callable, Sequence

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

Make = Callable[[Sequence[str]], Table]  # is given the columns that are left out


class Fitting:
    """A table that leaves columns out until no cell has to be cut or broken.

    ``make`` returns the table without some columns; ``least_first`` are those that may be left out, in this order. A
    column that may be broken into lines says in ``min_width`` how far; the others are ``no_wrap``.
    """

    def __init__(self, make: Make, least_first: Sequence[str]) -> None:
        self._make, self._least_first = make, least_first

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table, and a line about what is left out."""
        for many in range(len(self._least_first) + 1):
            out = self._least_first[:many]
            if self._needs(out, console, options) <= options.max_width:
                break
        yield self._make(out)
        if out:
            yield Text(f"{', '.join(out)}: not shown, the terminal has {options.max_width} columns", "italic dim")

    def _needs(self, out: Sequence[str], console: Console, options: ConsoleOptions) -> int:
        """Return the columns of a terminal that the table needs."""
        table = self._make(out)
        for column in table.columns:
            if not column.no_wrap:
                column.max_width = column.min_width
        return Measurement.get(console, options.update(width=_ANY, max_width=_ANY), table).maximum


_ANY = 10_000  # columns: a table that is measured has the room that it wants

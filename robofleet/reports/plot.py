"""What a plot of a report is."""

from collections.abc import Callable
from typing import NamedTuple

from matplotlib.figure import Figure

from robofleet.reports.canvas import RunView

Legend = list[tuple[str, str]]  # label, colour

_LEGEND = 16  # labels


class Plot(NamedTuple):
    """A plot and what to look for in it."""

    title: str
    draw: Callable[[RunView], Figure | None]  # None: what it would show was not measured
    caption: str
    legend: Callable[[RunView], Legend] = lambda _: []
    missing: str = ""  # why it was not measured
    long: bool = True  # it must not shrink to a narrow screen


def few(legend: Legend) -> Legend:
    """Return a legend that can be read: of very many robots first, middle and last, whose colours lead over."""
    many = len(legend) > _LEGEND
    return [legend[0], ("…", legend[len(legend) // 2][1]), legend[-1]] if many else legend

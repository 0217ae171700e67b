"""What the plots of a run have in common: their size, the axis of time, one colour a robot, lines that fit a screen."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from robofleet.config.tree import Bounds, Config
from robofleet.core.arrays import Array, Flags
from robofleet.core.figures import FAINT, INK, QUIET, robot_colours
from robofleet.recording.measures import line
from robofleet.recording.run import Run
from robofleet.reports.timeline import Timeline
from robofleet.safety.supervisor import Phase

WIDTH = 7.6  # of a plot [inch]
_LEFT, _RIGHT, _TOP, _BOTTOM = 0.68, 0.14, 0.1, 0.42  # margins [inch]: equal, so that times stand below each other
_TITLE_INCH = 0.3  # above axes that stand side by side
_LABEL_INCH = 0.52  # from the axis to its label
_PIXEL_COLUMNS = 700  # that a line is thinned to
_MOST_VECTOR_POINTS = 10_000  # of a plot: more are drawn as pixels

_PHASES = {
    Phase.IDLE: "#efefef",
    Phase.ARMED: "#d9e6f2",
    Phase.RUNNING: "#d8ebdb",
    Phase.HOLD: "#f7e3b5",
    Phase.FAULT: "#f0c4b8",
    Phase.POSITIONING: "#bfe3dd",
    Phase.PARKING: "#dcdcec",
    Phase.ESTOP: "#e59a88",
}
ALARM = "#b3261e"
CLOCK_TIME = "clock time since the start, s"  # the axis of all plots over time: it goes on in a hold


@dataclass(frozen=True)
class RunView:
    """What there is to draw."""

    run: Run
    summary: dict[str, Any]

    @cached_property
    def timeline(self) -> Timeline:
        return Timeline(self.run, self.summary["stops"])

    @property
    def config(self) -> Config:
        return self.run.config

    @property
    def bounds(self) -> Bounds:
        return self.config.run.bounds

    @property
    def colours(self) -> tuple[str, ...]:
        return robot_colours(len(self.run.robots))

    @property
    def span(self) -> tuple[float, float]:
        """From the run's first tick to its last [s]."""
        return 0.0, float(self.run.clock_time_s.max(initial=self.config.controller.tick_s))

    def counted(self, counts: Flags | None = None) -> Flags:
        """Which ticks count: a curve's own, or those of the run; all, where none does."""
        counts = self.run.counts if counts is None else counts
        return counts if counts.any() else np.ones_like(counts)


def sheet(height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure of so many inches and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height))
    return figure, _grid(figure, height, rows, columns)


def _grid(figure: FigureBase, height: float, rows: int, columns: int = 1) -> list[Axes]:
    grid = figure.subplots(rows, columns, squeeze=False, sharex="col" if rows > 1 else False)
    right = 1 - _RIGHT / WIDTH
    top = 1 - (_TOP if columns == 1 else _TITLE_INCH) / height
    figure.subplots_adjust(_LEFT / WIDTH, _BOTTOM / height, right, top, wspace=0.22, hspace=0.12)
    return list(grid.flat)


def strips(view: RunView, labels: Sequence[str], height: float = 1.9) -> tuple[Figure, list[Axes]]:
    """Return axes over the run's time, one below the other, with what interrupted the run behind them."""
    whole = height * len(labels) + 0.3
    figure = Figure(figsize=(WIDTH, whole))
    return figure, over_time(figure, whole, view, labels)


def over_time(figure: FigureBase, height: float, view: RunView, labels: Sequence[str]) -> list[Axes]:
    """Return axes as those of ``strips``, in a figure of so many inches, or a part of one."""
    axes = _grid(figure, height, len(labels))
    for each, label in zip(axes, labels, strict=True):
        each.set_ylabel(label)
        each.yaxis.set_label_coords(-_LABEL_INCH / (WIDTH - _LEFT - _RIGHT), 0.5)
        interruptions(each, view.timeline)
    axes[-1].set(xlabel=CLOCK_TIME, xlim=view.span)
    return axes


def interruptions(axes: Axes, timeline: Timeline) -> None:
    """Shade what is no running, and mark every stop of a robot."""
    for phase in timeline.phases:
        if phase.phase != Phase.RUNNING and phase.until_s > 0:
            axes.axvspan(phase.t_s, phase.until_s, color=phase_colour(phase.phase), alpha=0.6, lw=0)
    for t in sorted({round(entry.t_s, 2) for entry in timeline.entries if entry.stop}):
        axes.axvline(t, color=ALARM, lw=0.7, ls=(0, (1, 2)))


def phase_colour(phase: int) -> str:
    return {int(known): colour for known, colour in _PHASES.items()}.get(phase, FAINT)


def settling(axes: Axes, view: RunView, counts: Flags | None = None) -> None:
    """Shade the time before the first tick that counts."""
    counts = view.run.counts if counts is None else counts
    until_s = view.run.clock_time_s[counts][0] if counts.any() else view.span[1]
    axes.axvspan(0.0, until_s, color="#f3f3f3", lw=0, zorder=0)


def lines(axes: Axes, t: Array, values: Array, span: tuple[float, float], colours: Sequence[str]) -> None:
    """Draw the columns of values (K, N) over time; of so many points that a page would be heavy, as pixels."""
    points = 0
    for column, colour in zip(values.T, colours, strict=True):
        x, y = line(t, column, span, _PIXEL_COLUMNS)
        points += len(x)
        axes.plot(x, y, color=colour, lw=0.9)
    if points > _MOST_VECTOR_POINTS:
        for drawn in axes.get_lines():
            drawn.set_rasterized(True)


def level(axes: Axes, value: float | None, label: str = "") -> None:
    """Draw a line across that says what it is; nothing where there is none."""
    if value is not None:
        axes.axhline(value, color=QUIET, lw=0.9, ls=(0, (5, 3)))
        axes.annotate(
            label, (1.0, value), (-2, 2), xycoords=("axes fraction", "data"), textcoords="offset points",
            ha="right", color=INK, fontsize=8, bbox={"fc": "white", "ec": "none", "alpha": 0.7, "pad": 0.5},
        )  # fmt: skip


def logarithmic(axes: Axes, lowest: float) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set_ylim(bottom=lowest)


def zoomed(axes: Axes, values: Array, *also: float | None) -> None:
    """Let the y axis show these values, zero and others that are there, and nothing far beyond."""
    finite = values[np.isfinite(values)]
    shown = [float(v) for v in (finite.min(initial=0.0), finite.max(initial=0.0), *also) if v is not None]
    low, high = min(shown), max(shown)
    room = 0.06 * (high - low or 1.0)
    axes.set_ylim(low - room * (low < 0), high + room)


Legend = list[tuple[str, str]]  # label, colour

_MOST_LABELS, _LABELS_A_ROW = 16, 6


class Plot(NamedTuple):
    """A plot and what to look for in it."""

    title: str
    draw: Callable[[RunView], Figure | None]  # None: what it would show was not measured
    caption: str
    legend: Callable[[RunView], Legend] = lambda _: []
    missing: str = ""  # why it was not measured
    long: bool = True  # it must not shrink to a narrow screen

    @property
    def file_name(self) -> str:
        """Its title, as a file is named."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def add_legend(figure: Figure, legend: Legend) -> None:
    """Write a legend above a figure."""
    dots = [Line2D([], [], ls="none", marker="o", color=colour, label=label) for label, colour in legend]
    left = figure.axes[0].get_position().x0
    figure.legend(
        handles=dots, loc="lower left", bbox_to_anchor=(left, 1.0), ncols=min(len(dots), _LABELS_A_ROW),
        borderaxespad=0.2, handletextpad=0.1, columnspacing=1.2, fontsize=8,
    )  # fmt: skip


def few(legend: Legend) -> Legend:
    """Return a legend that can be read: of very many robots first, middle and last, whose colours lead over."""
    many = len(legend) > _MOST_LABELS
    return [legend[0], ("…", legend[len(legend) // 2][1]), legend[-1]] if many else legend

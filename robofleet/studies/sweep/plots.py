"""The plots of a sweep: what breaks where, two settings together, one setting at a time."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, FAINT, INK, QUIET
from robofleet.reports.canvas import WIDTH
from robofleet.studies.sweep.factors import Factor, Measure
from robofleet.studies.sweep.table import Ending

_FAULT = COLOURS[1]
ENDINGS = (  # of runs, by Ending
    ("completed", COLOURS[2]),
    ("completed, a bound not checked", "#b9c2ca"),
    ("completed, a bound missed", "#e0a33e"),
    ("did not complete", _FAULT),
)
_ENDED = {Ending.BROKEN: "not completed", Ending.MISSED: "missed a bound", Ending.NOT_JUDGED: "not checked"}

_SHADES = LinearSegmentedColormap.from_list("shades", ["#eef4f9", "#8fb8d9", COLOURS[0], "#0d3a5c"])
_REDS = LinearSegmentedColormap.from_list("reds", ["#f4f4f4", "#eeb8aa", _FAULT, "#7d2615"])
MOST = 4  # figures that are drawn
_ROW, _BAR = 2.5, 0.21  # heights [inch]
_LONG_NAMES = 26  # letters of all level names of a panel that fit side by side
_LABELLED_CELLS = 64  # at most
_DARK_BRIGHTNESS = 0.6  # of a cell that is written on in white

_LEAST_SPAN = 0.1  # of a scale, as a share of the largest value or of the bound: smaller differences look alike

Endings = NDArray[np.int64]  # (R,) of every run: Ending


def breaking(factors: Sequence[Factor], endings: Endings) -> Figure:
    """Draw for each level of each factor how many of its runs ended in which way."""
    rows = sum(len(factor) for factor in factors)
    height = _BAR * rows + 0.34 * len(factors) + 0.5
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(len(factors), 1, squeeze=False, height_ratios=[len(factor) + 0.6 for factor in factors])
    for axes, factor in zip(panels.flat, factors, strict=True):
        counts = np.zeros((len(factor), len(Ending)), int)
        np.add.at(counts, (factor.run_levels, endings), 1)
        share = 100 * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        left = np.zeros(len(factor))
        for ending, (_, colour) in enumerate(ENDINGS):
            axes.barh(range(len(factor)), share[:, ending], 0.72, left, color=colour)
            left += share[:, ending]
        for k, row in enumerate(counts):
            words = ", ".join(f"{row[ending]} {word}" for ending, word in _ENDED.items() if row[ending])
            axes.annotate(
                f"{words or 'all well'}, of {row.sum()}", (101.5, k), va="center", fontsize=8,
                annotation_clip=False, color=INK if words else QUIET,
            )  # fmt: skip
        axes.set(xlim=(0, 140), title=factor.key, xticks=[])
        axes.set_yticks(range(len(factor)), factor.levels)
        axes.invert_yaxis()
        axes.grid(visible=False)
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
    return figure


def together(across: Factor, up: Factor, measures: Sequence[Measure], endings: Endings) -> Figure:
    """Draw the share of runs that broke, where some did, and each figure's median over two factors."""
    broke = np.where(endings == Ending.BROKEN, 100.0, 0.0)
    shown = [*measures]
    if broke.any():
        shown = [Measure("did not complete", "% of the runs", broke), *shown[: MOST - 1]]
    figure, panels = _panels(len(shown), max(_ROW, 0.42 * len(up) + 0.9))
    for axes, measure in zip(panels, shown, strict=True):
        _cells(axes, across, up, measure, red=measure.values is broke)
    return figure


def alone(factor: Factor, measures: Sequence[Measure], endings: Endings) -> Figure:
    """Draw every figure over the levels of one factor: a box from quartile to quartile, and each run as a point."""
    figure, panels = _panels(len(measures), _ROW)
    for axes, measure in zip(panels, measures, strict=True):
        _boxes(axes, factor, measure, endings)
    return figure


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return axes side by side, two in a row."""
    rows = math.ceil(count / 2)
    figure = Figure(figsize=(WIDTH, height * rows), layout="constrained")
    panels = list(figure.subplots(rows, 2, squeeze=False).flat)
    for axes in panels[count:]:
        axes.remove()
    return figure, panels[:count]


def _cells(axes: Axes, across: Factor, up: Factor, measure: Measure, *, red: bool) -> None:
    medians = np.full((len(up), len(across)), np.nan)
    for i, k in itertools.product(range(len(up)), range(len(across))):
        values = measure.values[(up.run_levels == i) & (across.run_levels == k)]
        if np.isfinite(values).any():
            medians[i, k] = values.mean() if red else np.nanmedian(values)
    low, high = (0.0, 100.0) if red else scale(medians, measure.limit)
    image = axes.pcolormesh(
        medians, cmap=_REDS if red else _SHADES, vmin=low, vmax=high, edgecolors="white", linewidth=1.5
    )
    if medians.size <= _LABELLED_CELLS:
        for (i, k), value in np.ndenumerate(medians):
            if np.isfinite(value):
                dark = _brightness(image.to_rgba(value)) < _DARK_BRIGHTNESS
                axes.annotate(
                    _number(value, medians), (k + 0.5, i + 0.5), ha="center", va="center", fontsize=8,
                    color="white" if dark else INK,
                )  # fmt: skip
    bar = axes.figure.colorbar(image, ax=axes, pad=0.02, aspect=24)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
    axes.set(title=measure.title, xlabel=across.name, ylabel=up.name)
    _named(axes, across, np.arange(len(across), dtype=np.float64) + 0.5)
    axes.set_yticks(np.arange(len(up)) + 0.5, up.levels)
    axes.grid(visible=False)
    axes.set_facecolor(FAINT)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)


def _boxes(axes: Axes, factor: Factor, measure: Measure, endings: Endings) -> None:
    values = [measure.values[(factor.run_levels == k) & np.isfinite(measure.values)] for k in range(len(factor))]
    places = np.arange(len(factor), dtype=np.float64)
    axes.boxplot(
        values, positions=places, widths=0.55, showfliers=False, patch_artist=True, manage_ticks=False,
        boxprops={"facecolor": "#dbe8f2", "edgecolor": COLOURS[0], "linewidth": 0.9},
        medianprops={"color": COLOURS[0], "linewidth": 1.8},
        whiskerprops={"color": COLOURS[0], "linewidth": 0.9}, capprops={"color": COLOURS[0], "linewidth": 0.9},
    )  # fmt: skip
    spread = 0.16 * np.sin(12.9898 * np.arange(len(endings)))  # beside each other, the same every time
    for ending, (_, colour) in enumerate(ENDINGS):
        drawn = (endings == ending) & np.isfinite(measure.values)
        quiet = ending == Ending.MET
        axes.plot(
            factor.run_levels[drawn] + spread[drawn], measure.values[drawn], "o", ms=2.6 if quiet else 4, mew=0,
            color=INK if quiet else colour, alpha=0.45 if quiet else 1, rasterized=len(endings) > 2000,
        )  # fmt: skip
    if measure.limit is not None and _near(measure.limit, measure.values):
        axes.axhline(measure.limit, color=QUIET, lw=0.9, ls=(0, (5, 3)))
        axes.annotate(
            "bound", (1.0, measure.limit), (-2, 2), xycoords=("axes fraction", "data"), textcoords="offset points",
            ha="right", fontsize=8, color=INK,
        )  # fmt: skip
    least, most = scale(np.array(axes.get_ylim()), measure.limit)
    axes.set(title=measure.title, xlabel=factor.name, xlim=(-0.6, len(factor) - 0.4), ylim=(least, most))
    _named(axes, factor, places)
    axes.grid(visible=False, axis="x")
    axes.tick_params(axis="x", length=0)


def _named(axes: Axes, factor: Factor, places: Array) -> None:
    """Write the levels below an axis, turned where they are too long to stand side by side."""
    long = sum(len(level) + 2 for level in factor.levels) > _LONG_NAMES
    axes.set_xticks(places, factor.levels, rotation=35 if long else 0, ha="right" if long else "center")


def scale(values: Array, limit: float | None) -> tuple[float, float]:
    """Return the ends of a scale for values: their own, or wider, so that differences of no weight look alike."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    least = max(_LEAST_SPAN * max(abs(low), abs(high), abs(limit or 0.0)), 1e-12)
    missing = max(0.0, least - (high - low)) / 2
    return low - missing, high + missing


def _near(limit: float, values: Array) -> bool:
    """Return whether a bound can be shown without making the rest small."""
    low, high = np.nanmin(values), np.nanmax(values)
    room = 0.75 * (high - low)
    return bool(low - room <= limit <= high + room)


def _brightness(colour: Any) -> float:
    """Return how bright the eye sees a colour (r, g, b, ...), from 0 to 1."""
    return float(np.dot(colour[:3], (0.299, 0.587, 0.114)))


def _number(value: float, among: Array) -> str:
    """Return a number with as many digits as tell it from the others."""
    largest = np.nanmax(abs(among))
    return f"{value:.{0 if largest >= 100 else 1 if largest >= 10 else 2}f}"

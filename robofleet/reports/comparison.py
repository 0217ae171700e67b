"""Two runs side by side: what changed, figure by figure and plot by plot."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.behaviours.described import JUDGED_FIGURES
from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, STYLE
from robofleet.recording.gauge import Curve
from robofleet.recording.measures import pose_error_mm
from robofleet.recording.run_clock import time_words
from robofleet.reports.bounds import JUDGED, Judged, part
from robofleet.reports.canvas import CLOCK_TIME, RunView, lines, logarithmic, sheet
from robofleet.reports.group_plots import wide
from robofleet.reports.overview import floor, trail
from robofleet.reports.own_figures import own_figures
from robofleet.reports.pages import Marked, Page
from robofleet.reports.stops import fleet_stops

Summary = dict[str, Any]

_SAME_WITHIN = 0.01  # a relative difference of a figure that is no difference
_AS_BEFORE = "the same"
_SHOWN_KEYS = 60
_COLOURS = COLOURS[:2]
_MEANS_JUDGED = [figure.key for figure in JUDGED_FIGURES if figure.statistic != "per_robot_mean"]  # by a bound

_ALSO = (
    Judged("heading error, rms", "deg", part("pose_error", "heading_rms_deg")),
    Judged("tags found", "of all", part("tracker", "measured_fraction"), at_least=True),
)
_NOT_JUDGED = (  # a difference is neither good nor bad, or the machine's and its load's
    Judged("wheels at their limit", "of all ticks", part("saturated_fraction")),
    Judged("changed by the barrier", "of all ticks", part("filtered_fraction")),
    Judged("computing a tick, p50", "us", part("tick", "compute_us", "p50")),
    Judged("computing a tick, p99", "us", part("tick", "compute_us", "p99")),
    Judged("tick late by, p99", "us", part("tick", "lateness_us", "p99")),
    Judged("tracking an image, p50", "ms", part("tracker", "frame_ms", "p50")),
)


class Side(NamedTuple):
    """One of the two runs."""

    name: str
    view: RunView

    @property
    def summary(self) -> Summary:
        return self.view.summary


def write(first: Side, second: Side, file: Path) -> None:
    """Write the page about two runs; OSError if it cannot be."""
    sides = first, second
    title = f"{first.name} and {second.name}"
    page = Page(title, "Two runs side by side: the second is judged against the first")
    rows = list(_rows(*sides))
    counts = [sum(row[-1].good is good for row in rows) for good in (True, False)]
    same = sum(row[-1].text == _AS_BEFORE for row in rows)
    detail = "\n".join(f"{side.name}: {_ended(side.summary)}" for side in sides)
    page.verdict(f"{counts[0]} figures better, {counts[1]} worse, {same} the same", good=None, detail=detail)
    page.section("Figures")
    page.table(("figure", first.name, second.name, "difference", ""), rows)
    _keys(page, *sides)
    page.section("Plots", "Each run from its own start.")
    legend = [(side.name, colour) for side, colour in zip(sides, _COLOURS, strict=True)]
    with mpl.rc_context(STYLE):
        if all(len(side.view.run.clock_time_s) for side in sides):
            page.figure(_paths(sides), "The dashed line is the path of the first run.", title="Paths", legend=legend)
        for overlay in overlays(sides):
            if (figure := _overlaid(sides, overlay)) is not None:
                page.figure(figure, overlay.caption, title=overlay.title, legend=legend, long=True)
    page.write(file)


def _ended(summary: Summary) -> str:
    cause = f" ({summary['cause']})" if summary["cause"] else ""
    many = len(fleet_stops(summary["stops"]))
    stops = f", {many} stop{'s' * (many > 1)}" if many else ""
    times = time_words(summary["duration_s"], summary["clock_duration_s"])
    return f"{summary['outcome']}{cause}, {times}, {summary['mode']}, seed {summary['seed']}{stops}"


def _rows(first: Side, second: Side) -> Iterator[tuple[str, float | None, float | None, str, Marked]]:
    for figure in (*JUDGED.values(), *_ALSO, *_own(first.summary, second.summary), *_NOT_JUDGED):
        first_value, other = figure.value_of(first.summary), figure.value_of(second.summary)
        label = figure.title
        if figure.own and first_value is None and other is None:
            continue
        if first_value is None or other is None:
            yield label, first_value, other, "", Marked("not measured in both", None)
        else:
            judged = figure in JUDGED.values() or figure in _ALSO or "error" in figure.label
            verdict = _verdict(first_value, other, more=figure.at_least) if judged else Marked("", None)
            yield label, first_value, other, f"{other - first_value:+.3g}", verdict


def _own(first: Summary, second: Summary) -> Iterator[Judged]:
    """Yield the groups' own figures beside those that bounds judge; of an error less is better."""
    groups = first["groups"] | second["groups"]
    for name, group in groups.items():
        suffix = f" of {name}" if len(groups) > 1 else ""
        for figure in own_figures(group):
            for words, what in (("mean", "mean"), ("largest", "largest")) if figure.each else (("", "mean"),):
                if words != "mean" or figure.key not in _MEANS_JUDGED:
                    label = ", ".join(filter(None, (f"{figure.label}{suffix}", words)))
                    yield Judged(label, figure.unit, _found(name, figure.key, what), own=True)


def _found(name: str, key: str, what: str) -> Callable[[Summary], float | None]:
    """Return what finds a group's own figure in a summary."""

    def value(summary: Summary) -> float | None:
        figures = own_figures(summary["groups"][name]) if name in summary["groups"] else ()
        found: float | None = next((getattr(figure, what) for figure in figures if figure.key == key), None)
        return found

    return value


def _verdict(before: float, other: float, *, more: bool) -> Marked:
    """Say whether the other one is better; ``more`` is, or less."""
    if abs(other - before) <= _SAME_WITHIN * max(abs(before), abs(other)):
        return Marked(_AS_BEFORE, None)
    better = (other > before) == more
    by = f" by {100 * abs(other - before) / abs(before):.0f} %" if before else ""
    return Marked(f"{'better' if better else 'worse'}{by}", better)


def _keys(page: Page, first: Side, second: Side) -> None:
    first_keys, other = (_flat(side.view.config.model_dump(mode="json")) for side in (first, second))
    missing = object()
    differing = [key for key in first_keys | other if first_keys.get(key, missing) != other.get(key, missing)]
    page.section("Configuration", "" if differing else "Both runs have the same configuration, key by key.")
    if differing:
        page.table(
            ("key", first.name, second.name),
            [(key, first_keys.get(key), other.get(key)) for key in differing[:_SHOWN_KEYS]],
        )
    if len(differing) > _SHOWN_KEYS:
        page.note(f"And {len(differing) - _SHOWN_KEYS} more keys.")


def _flat(tree: Any, path: str = "") -> dict[str, Any]:
    if isinstance(tree, dict | list) and tree:
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        return {k: v for key, value in items for k, v in _flat(value, f"{path}.{key}" if path else str(key)).items()}
    return {path: tree}


def _paths(sides: tuple[Side, Side]) -> Figure:
    figure, axes = floor(sides[0].view)
    for side, colour, width in zip(sides, _COLOURS, (3.0, 1.0), strict=True):
        for points in side.view.run.points().swapaxes(0, 1):
            axes.plot(*trail(points).T, color=colour, lw=width)
    return figure


class OverlaidPlot(NamedTuple):
    """A line for each of two runs."""

    title: str
    label: str
    columns: tuple[Array | None, Array | None]  # (K,)
    caption: str


def overlays(sides: tuple[Side, Side]) -> Iterator[OverlaidPlot]:
    """Yield what the runs' groups have, then the filter's errors."""
    first, second = (
        {(p.group.name, c.key): c for p in side.view.run.parts for c in p.curves if c.live} for side in sides
    )
    several = any(len(side.view.run.parts) > 1 for side in sides)
    for (name, key), curve in (first | second).items():
        suffix = f" of {name}" if several else ""
        off = curve.asked is not None
        yield OverlaidPlot(
            f"{curve.title}{suffix}", f"off by, {curve.unit}" if off else curve.unit or curve.label,
            (_shown(first.get((name, key))), _shown(second.get((name, key)))),
            "The one that is furthest from what was asked." if off else f"Mean, at every tick: {curve.meaning}.",
        )  # fmt: skip
    yield OverlaidPlot(
        "Pose error", "mm", (_mean(pose_error_mm(sides[0].view.run)), _mean(pose_error_mm(sides[1].view.run))),
        "Mean of the robots, the filter against the truth.",
    )  # fmt: skip


def _shown(curve: Curve | None) -> Array | None:
    if curve is None or not curve.values.shape[1]:
        return None
    if curve.asked is None:
        return _mean(curve.values)
    return np.asarray(np.fmax.reduce(np.abs(curve.values - curve.asked), axis=1))


def _mean(values: Array | None) -> Array | None:
    if values is None:
        return None
    known = np.isfinite(values)
    with np.errstate(invalid="ignore"):  # a tick of which nothing is known is a gap
        return np.asarray(np.where(known, values, 0.0).sum(axis=1) / known.sum(axis=1))


def _overlaid(sides: tuple[Side, Side], overlay: OverlaidPlot) -> Figure | None:
    known = [column[np.isfinite(column)] if column is not None else np.empty(0) for column in overlay.columns]
    every = np.concatenate(known)
    if not every.size:
        return None
    figure, (axes,) = sheet(2.4)
    span = 0.0, max(side.view.span[1] for side in sides)
    lowest = wide(every, every)
    for side, column, colour in zip(sides, overlay.columns, _COLOURS, strict=True):
        if column is not None and len(column):
            shown = column if lowest is None else np.maximum(column, lowest)
            lines(axes, side.view.run.clock_time_s, shown[:, None], span, [colour])
    if lowest is not None:
        logarithmic(axes, lowest)
    axes.set(xlabel=CLOCK_TIME, ylabel=overlay.label, xlim=span)
    return figure

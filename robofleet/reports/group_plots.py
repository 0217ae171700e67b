"""The plots of a group's own figures and measures, whatever its behaviour is."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robofleet.behaviours.described import JUDGED_FIGURES
from robofleet.behaviours.interface import with_unit
from robofleet.core.arrays import Array
from robofleet.core.figures import robot_colours
from robofleet.recording.gauge import Curve
from robofleet.recording.run import GroupColumns
from robofleet.reports.canvas import Legend, Plot, RunView, few, level, lines, logarithmic, settling, strips, zoomed
from robofleet.reports.paper import papers_mean

_WIDE_RATIO = 30.0  # to its median: a figure that is so much larger at times has a logarithmic axis
_ESTIMATED = "estimated_"  # a figure that is so called is for the run itself: the report has the measure
_BOUNDS = {  # by the curves' keys: which bound stands in the plot, and what it is of
    with_unit(figure.name, "mm"): (figure.bound, figure.level) for figure in JUDGED_FIGURES
}
NO_TRUTH = "true poses are known of simulated robots only."


def of_group(part: GroupColumns, *, alone: bool) -> list[Plot]:
    """Return a plot for each figure and each measure; ``alone``: no other group has figures."""
    return [
        Plot(
            curve.title if alone else f"{curve.title} of {part.group.name}", partial(_draw, part, curve),
            _caption(curve), partial(_legend, part, curve), _missing(part, curve),
        )
        for curve in shown(part)
    ]  # fmt: skip


def shown(part: GroupColumns) -> list[Curve]:
    """Return the curves that are drawn."""
    better = {f"{_ESTIMATED}{curve.name}" for curve in part.curves if not curve.is_figure}
    return [curve for curve in part.curves if curve.live and curve.name not in better]


def colours(view: RunView, part: GroupColumns, curve: Curve) -> list[str]:
    """Return the colour of each column: its robot's own, where it is about one."""
    own, other = view.colours[part.rows], robot_colours(len(curve.of))
    return [other[k] if row is None else own[row] for k, row in enumerate(curve.rows)]


def wide(values: Array, counted: Array) -> float | None:
    """Return from where a logarithmic axis shows values; None where a linear one is better."""
    known = values[np.isfinite(values)]
    settled = counted[np.isfinite(counted)]
    if not settled.size or known.min() < 0.0 or (middle := float(np.median(settled))) <= 0.0:
        return None
    return float(10.0 ** np.floor(np.log10(middle / 10.0))) if known.max() > _WIDE_RATIO * middle else None


def _draw(part: GroupColumns, curve: Curve, view: RunView) -> Figure | None:
    if not np.isfinite(curve.values).any():
        return None
    if curve.asked is None:
        figure, (axes,) = strips(view, [curve.label], 2.4)
        draw_curve(axes, view, part, curve)
        return figure
    bound, words = _bound(view, curve)
    figure, (whole, off) = strips(view, [curve.label, f"off the target, {curve.unit}"])
    lines(whole, view.run.clock_time_s, curve.values, view.span, colours(view, part, curve))
    level(whole, curve.asked, f"target: {curve.asked:g} {curve.unit}")
    deviation = curve.values - curve.asked
    settling(off, view, curve.counts)
    lines(off, view.run.clock_time_s, deviation, view.span, colours(view, part, curve))
    zoomed(off, deviation[view.counted(curve.counts)], bound, bound and -bound)
    level(off, bound, words)
    level(off, bound and -bound)
    return figure


def draw_curve(axes: Axes, view: RunView, part: GroupColumns, curve: Curve) -> None:
    bound, words = _bound(view, curve)
    settling(axes, view, curve.counts)
    _lines(axes, view, part, curve, bound)
    level(axes, bound, words)
    level(axes, papers_mean(view.config, curve.key), "the paper's mean, on hardware")


def _bound(view: RunView, curve: Curve) -> tuple[float | None, str]:
    """Return the bound that judges a curve, and which that is in words."""
    key, words = _BOUNDS.get(curve.key, ("", ""))
    return getattr(view.bounds, key, None), words


def _lines(axes: Axes, view: RunView, part: GroupColumns, curve: Curve, bound: float | None) -> None:
    """Draw a curve: of a figure that was told all of it, of a measure what counts."""
    counted = curve.values[view.counted(curve.counts)]
    lowest = wide(curve.values, counted) if curve.is_figure else None
    values = curve.values if lowest is None else np.maximum(curve.values, lowest)
    lines(axes, view.run.clock_time_s, values, view.span, colours(view, part, curve))
    if lowest is not None:
        logarithmic(axes, lowest)
    else:
        zoomed(axes, counted, bound)


def _missing(part: GroupColumns, curve: Curve) -> str:
    if not curve.of:
        return "Not measured: it needs more robots."
    return "Not measured." if curve.is_figure or part.past.known.all() else f"Not measured: {NO_TRUTH}"


def _caption(curve: Curve) -> str:
    meaning = f"{curve.meaning[:1].upper()}{curve.meaning[1:]}. " if curve.meaning else ""
    if curve.asked is not None:
        return (
            f"{meaning}Above: all of it. Below: the difference from its target, scaled to what counts. The grey part "
            "does not count."
        )
    if curve.is_figure:
        return f"{meaning}Reported by the behaviour at each tick. The grey part does not count."
    return f"{meaning}Measured after the run. The axis is scaled to what counts; the grey part may lie outside."


def _legend(part: GroupColumns, curve: Curve, view: RunView) -> Legend:
    known = np.atleast_1d(np.isfinite(curve.values).any(axis=0))
    return few([(owner, c) for owner, c, seen in zip(curve.of, colours(view, part, curve), known, strict=True) if seen])

"""The plots of a run's timing: how old images are, how long ticks take."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from robofleet.core.figures import COLOURS, QUIET
from robofleet.recording.measures import compute_us, delays_ms, lateness_us
from robofleet.recording.run import Array
from robofleet.reports.canvas import RunView, sheet

_BINS = 60


def delays(view: RunView) -> list[tuple[str, str]]:
    """Return the legend of the delays."""
    names = "poses sent", "taken by a tick", "at a wheel"
    shown = zip(names, delays_ms(view.series.run), COLOURS, strict=False)
    return [
        (f"{name}: {np.median(ms):.1f} ms, p99 {np.percentile(ms, 99):.1f} ms", c) for name, ms, c in shown if len(ms)
    ]


def latency(view: RunView) -> Figure | None:
    """Draw how long after its mid-exposure an image was a pose, in a tick, at a wheel."""
    delays = delays_ms(view.series.run)
    if not len(delays[2]):
        return None
    figure, (axes,) = sheet(2.3)
    longest = max(float(values.max(initial=0.0)) for values in delays)
    edges = np.linspace(0.0, 1.05 * longest, _BINS + 1)
    for values, colour in zip(delays, COLOURS, strict=False):
        if len(values):
            share = 100 * np.histogram(values, edges)[0] / len(values)
            axes.stairs(share, edges, color=colour, fill=True, alpha=0.35)
            axes.stairs(share, edges, color=colour)
    axes.set(xlabel="time since mid-exposure, ms", ylabel="share, %", xlim=(0, edges[-1]))
    if (limit := view.bounds.exposure_to_wheel_p99_ms) is not None:
        axes.axvline(limit, color=QUIET, lw=0.9, ls=(0, (5, 3)), label="bound")
    return figure


def ticks(view: RunView) -> Figure | None:
    """Draw how long the ticks computed, and how late they were."""
    run = view.series.run
    figure, (compute, late) = sheet(2.5, 1, 2)
    _histogram(compute, compute_us(run, view.recording), "computing a tick, us")
    _histogram(late, lateness_us(run), "tick late by, us")
    compute.set_ylabel("ticks")
    return figure


def _histogram(axes: Axes, values: Array, label: str) -> None:
    """Draw a histogram over a logarithmic axis, ticks counted on another one."""
    axes.set(xlabel=label)
    if not (values > 0).any():
        axes.text(0.5, 0.5, "0 at every tick", transform=axes.transAxes, ha="center", color=QUIET)
        axes.set(xticks=[], yticks=[])
        return
    values = np.maximum(values, 1.0)
    axes.hist(values, np.geomspace(1.0, max(2.0, 1.2 * values.max()), _BINS).tolist(), color=COLOURS[0])
    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_major_locator(LogLocator(numticks=5))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    p50, p99 = np.percentile(values, (50, 99))
    axes.set_title(f"p50 {p50:,.0f}, p99 {p99:,.0f}, largest {values.max():,.0f}", fontsize=8)

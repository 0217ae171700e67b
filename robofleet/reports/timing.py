"""The plots of a run's timing: how old images are, how long ticks take."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from robofleet.core.clock import MS, US
from robofleet.core.figures import COLOURS, QUIET
from robofleet.recording import measures
from robofleet.recording.distribution import Distribution
from robofleet.reports.canvas import RunView, sheet

_BINS = 60


def delays(view: RunView) -> list[tuple[str, str]]:
    """Return the legend of the delays."""
    names = "poses sent", "taken by a tick", "at a wheel"
    shown = zip(names, measures.delays(view.series.run), COLOURS, strict=False)
    percentiles = [(name, delay.percentiles((50, 99)) / MS, colour) for name, delay, colour in shown if len(delay)]
    return [(f"{name}: {p50:.1f} ms, p99 {p99:.1f} ms", colour) for name, (p50, p99), colour in percentiles]


def latency(view: RunView) -> Figure | None:
    """Draw how long after its mid-exposure an image was a pose, in a tick, at a wheel."""
    delays = measures.delays(view.series.run)
    if not len(delays.wheel):
        return None
    figure, (axes,) = sheet(2.3)
    edges = np.linspace(0.0, 1.05 * max(0, *(delay.largest for delay in delays)) / MS, _BINS + 1)
    for delay, colour in zip(delays, COLOURS, strict=False):
        if len(delay):
            share = 100 * np.histogram(delay.values / MS, edges, weights=delay.counts)[0] / len(delay)
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
    _histogram(compute, measures.compute(run), "computing a tick, us")
    _histogram(late, measures.lateness(run), "tick late by, us")
    compute.set_ylabel("ticks")
    return figure


def _histogram(axes: Axes, durations: Distribution, label: str) -> None:
    """Draw a histogram over a logarithmic axis, ticks counted on another one."""
    axes.set(xlabel=label)
    if durations.largest <= 0:
        axes.text(0.5, 0.5, "0 at every tick", transform=axes.transAxes, ha="center", color=QUIET)
        axes.set(xticks=[], yticks=[])
        return
    us, largest = np.maximum(durations.values / US, 1.0), max(durations.largest / US, 1.0)
    edges = np.geomspace(1.0, max(2.0, 1.2 * largest), _BINS).tolist()
    axes.hist(us, edges, weights=durations.counts, color=COLOURS[0])
    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_major_locator(LogLocator(numticks=5))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    p50, p99 = np.maximum(durations.percentiles((50, 99)) / US, 1.0)
    axes.set_title(f"p50 {p50:,.0f}, p99 {p99:,.0f}, largest {largest:,.0f}", fontsize=8)

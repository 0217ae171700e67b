"""The plots of a run's report: each is a function and its entry in a section; the groups' own are ``group_plots.py``.

A function is given a run with at least one tick, but the first one of all; it returns None where what it would show
was not measured.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter

from robofleet.config import slices
from robofleet.core.arrays import Array
from robofleet.core.clock import MS, US
from robofleet.core.figures import COLOURS, QUIET
from robofleet.recording import measures
from robofleet.recording.reduced import Distribution
from robofleet.reports import paper_figures
from robofleet.reports.canvas import Plot, RunView, few, level, lines, phase_colour, settling, sheet, strips, zoomed
from robofleet.reports.group_plots import NO_TRUTH, of_group
from robofleet.reports.overview import happened, paths
from robofleet.reports.paper import is_papers


def _robots_lines(axes: Axes, view: RunView, values: Array) -> None:
    lines(axes, view.run.clock_time_s, values, view.span, view.colours)


def wheels(view: RunView) -> Figure | None:
    items = view.run.items
    drives = [slices.drive(robot) for robot in view.config.members]
    figure, (axes,) = strips(view, ["faster wheel, rad/s"])
    _robots_lines(axes, view, np.maximum(abs(items["left_rad_s"]), abs(items["right_rad_s"])))
    limit = min(drive.max_wheel_speed for drive in drives)
    axes.set_ylim(0.0, 1.08 * max(drive.max_wheel_speed for drive in drives))
    level(axes, limit, f"the slowest wheels' limit, {limit:g} rad/s")
    return figure


def references(view: RunView) -> Figure | None:
    """Draw the references' speeds |rho'|."""
    run, tick_s = view.run, view.config.controller.tick_s
    if np.isnan(run.references).all():
        return None
    figure, (axes,) = strips(view, ["|ρ′|, m/s"])
    speed = np.linalg.norm(np.diff(run.references, axis=0, prepend=run.references[:1]), axis=-1) / tick_s
    speed[:1] = np.nan
    speed[1:][np.diff(run.ticks["run_tick"]) != 1] = np.nan
    _robots_lines(axes, view, speed)
    fastest = min(slices.drive(robot).max_speed for robot in view.config.members)
    settling(axes, view)
    zoomed(axes, speed[view.counted()], fastest)
    level(axes, fastest, f"the slowest body's limit, {fastest:g} m/s")
    return figure


def poses(view: RunView) -> Figure | None:
    """Draw the filter's poses against the true ones over time."""
    off, turn = measures.pose_error_mm(view.run), measures.heading_error_deg(view.run)
    if off is None or turn is None:
        return None
    figure, (position, heading) = strips(view, ["position off, mm", "heading off, deg"])
    _robots_lines(position, view, off)
    zoomed(position, off, view.bounds.pose_error_rms_mm)
    level(position, view.bounds.pose_error_rms_mm, "bound of the rms")
    _robots_lines(heading, view, turn)
    return figure


def pose_distribution(view: RunView) -> Figure | None:
    """Draw which share of the ticks had a pose error below which size."""
    off, turn = measures.pose_error_mm(view.run), measures.heading_error_deg(view.run)
    if off is None or turn is None:
        return None
    figure, (position, heading) = sheet(2.4, 1, 2)
    share = np.linspace(0.0, 100.0, 201)
    for axes, values in ((position, off), (heading, np.abs(turn))):
        for column, colour in zip(values.T, view.colours, strict=True):
            if (known := column[np.isfinite(column)]).size:
                axes.plot(np.percentile(known, share), share, color=colour, lw=1.2)
        axes.set(ylim=(0, 100), xlim=(0, None))
    position.set(xlabel="position off, mm", ylabel="share of ticks, %")
    heading.set(xlabel="heading off, deg")
    return figure


def _robots(view: RunView) -> list[tuple[str, str]]:
    return few(list(zip(view.run.robots, view.colours, strict=True)))


def _referring(view: RunView) -> list[tuple[str, str]]:
    had = np.atleast_1d(np.isfinite(view.run.references).any(axis=(0, 2)))
    every = zip(view.run.robots, view.colours, had, strict=True)
    return few([(robot, colour) for robot, colour, present in every if present])


def _known(view: RunView) -> list[tuple[str, str]]:
    every = zip(view.run.robots, view.colours, view.run.known, strict=True)
    return few([(robot, colour) for robot, colour, known in every if known])


def _phases(view: RunView) -> list[tuple[str, str]]:
    return list({span.name: (span.name, phase_colour(span.phase)) for span in view.timeline.phases}.values())


_BINS = 60


def delays(view: RunView) -> list[tuple[str, str]]:
    names = "poses sent", "taken by a tick", "at a wheel"
    shown = zip(names, measures.delays(view.run), COLOURS, strict=False)
    percentiles = [(name, delay.percentiles((50, 99)) / MS, colour) for name, delay, colour in shown if len(delay)]
    return [(f"{name}: {p50:.1f} ms, p99 {p99:.1f} ms", colour) for name, (p50, p99), colour in percentiles]


def latency(view: RunView) -> Figure | None:
    """Draw how long after its mid-exposure an image was a pose, in a tick, at a wheel."""
    delays = measures.delays(view.run)
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
    run = view.run
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


_NO_TRUTH = f"Not measured: {NO_TRUTH}"

HAPPENED = {
    "What happened": (
        Plot(
            "On the time axis",
            happened,
            "The top row shows the phases. A cross is a stop of a robot. A bar is something that lasted: an injected "
            "fault, missed ticks, the barrier changing a command. A stroke is a message of the tracker. Clock time "
            "goes on while the run is held. Dotted red lines and coloured bands mark the same times in all plots.",
            _phases,
        ),
        Plot(
            "Paths of the points",
            paths,
            "Trails of the points p. A ring is a start, a disc is a robot's body at the end, a red cross is a stop. "
            "Where trails overlap, the first robot's is the widest. Dashed lines and small dots are the behaviour's "
            "path and points, dotted lines are its references.",
            _robots,
            long=False,
        ),
    )
}
FLEET = {
    "Driving": (
        Plot(
            "Wheels", wheels,
            "The faster wheel of each robot, as commanded. At the limit the robot cannot follow its law.",
            _robots,
        ),
        Plot(
            "Reference speed", references,
            "How fast the references move. A robot cannot follow a reference that is faster than its body.",
            _referring, "Not measured: no behaviour has references.",
        ),
    ),
    "Poses": (
        Plot(
            "The filter against the truth", poses,
            "The distance between the filter's pose and the true pose at each tick. A peak is a moment without an "
            "image, or a slip that the filter did not expect.",
            _known, _NO_TRUTH,
        ),
        Plot(
            "Distribution", pose_distribution,
            "The share of ticks whose error is below a size. A steep curve far left is good. A long tail to the right "
            "means rare, large errors.",
            _known, _NO_TRUTH,
        ),
    ),
    "Timing": (
        Plot(
            "From the image to the wheel", latency,
            "The age of an image when its poses are sent, when a tick uses them, and when a wheel receives the "
            "command. Narrow and left is good. A tail to the right is a late message.",
            delays, "Not measured: no command reached a wheel.",
        ),
        Plot(
            "Ticks", ticks,
            "How long each tick computed, and how late it began. Both axes are logarithmic: one bad tick in thousands "
            "is visible. In lockstep no simulated time passes while a process computes, so no tick is late.",
        ),
    ),
}  # fmt: skip


def sections(view: RunView) -> dict[str, list[Plot]]:
    """Return all plots of a run, by section: what happened, each group's own, the whole fleet's."""
    alone = len(view.run.parts) == 1
    groups = {f"Group {part.group.name}": of_group(part, alone=alone) for part in view.run.parts}
    papers = list(paper_figures.plots(view)) if is_papers(view.config) else []
    plots = {**HAPPENED, **groups, "The paper's figures": papers, **FLEET}
    return {section: list(entries) for section, entries in plots.items() if entries}

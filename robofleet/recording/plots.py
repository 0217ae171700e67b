"""The plots of a run's report: each is a function and its entry in ``SECTIONS``.

A function is given a run with at least one tick, but the first one of all; it returns None where what it would show
was not measured.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robofleet.config import slices
from robofleet.recording.canvas import View, level, lines, logarithmic, phase_colour, settling, sheet, strips, zoomed
from robofleet.recording.overview import happened, paths
from robofleet.recording.run import Array
from robofleet.recording.tables import PAPER_CONTROL_ERROR_MM
from robofleet.recording.timing import delays, latency, ticks

_LEGEND = 16  # robots
LOWEST_MM = 1e-2  # of a logarithmic axis


def control_error(view: View) -> Figure | None:
    """Draw the control error."""
    figure, (axes,) = strips(view, ["control error, mm"], 2.6)
    settling(axes, view.config.run.settle_s)
    _robots_lines(axes, view, np.maximum(view.series.control_mm, LOWEST_MM))
    logarithmic(axes, LOWEST_MM)
    level(axes, view.bounds.control_error_mean_mm, "bound of the mean")
    level(axes, PAPER_CONTROL_ERROR_MM, "the paper's mean, on hardware")
    return figure


def _robots_lines(axes: Axes, view: View, values: Array) -> None:
    lines(axes, view.series.t, values, view.span, view.colours)


def spacing(view: View) -> Figure | None:
    """Draw the distances between neighbours, and how far they are from what was asked."""
    if len(view.series.robots) < 2:
        return None
    asked_mm = view.config.groups[0].spacing_m * 1e3
    figure, (whole, off) = strips(view, ["distance, mm", "from d, mm"])
    lines(whole, view.series.t, view.series.spacing_mm, view.span, view.colours[1:])
    level(whole, asked_mm, f"d = {asked_mm:g} mm")
    deviation, settle_s = view.series.spacing_mm - asked_mm, view.config.run.spacing_settle_s
    settling(off, settle_s)
    lines(off, view.series.t, deviation, view.span, view.colours[1:])
    limit = view.bounds.spacing_max_deviation_mm
    zoomed(off, deviation[view.counted(settle_s)], limit, limit and -limit)
    level(off, limit, "bound")
    level(off, limit and -limit)
    return figure


def speeds(view: View) -> Figure | None:
    """Draw the references' speeds |rho'|, and each robot's faster wheel."""
    run, tick_s = view.series.run, view.config.controller.tick_s
    drives = [slices.drive(robot) for robot in view.config.platoon]
    figure, (reference, wheels) = strips(view, ["|ρ′|, m/s", "faster wheel, rad/s"])
    at = np.stack([run.items["reference_x_m"], run.items["reference_y_m"]], axis=-1)
    speed = np.linalg.norm(np.diff(at, axis=0, prepend=at[:1]), axis=-1) / tick_s
    speed[:1] = np.nan
    speed[1:][np.diff(run.ticks["run_tick"]) != 1] = np.nan
    _robots_lines(reference, view, speed)
    fastest = min(drive.max_speed for drive in drives)
    zoomed(reference, speed[view.counted(view.config.run.settle_s)], fastest) if len(speed) > 1 else None
    level(reference, fastest, f"the slowest body's limit, {fastest:g} m/s")
    _robots_lines(wheels, view, np.maximum(abs(run.items["left_rad_s"]), abs(run.items["right_rad_s"])))
    limit = min(drive.max_wheel_speed for drive in drives)
    wheels.set_ylim(0.0, 1.08 * max(drive.max_wheel_speed for drive in drives))
    level(wheels, limit, f"the slowest wheels' limit, {limit:g} rad/s")
    return figure


def true_errors(view: View) -> Figure | None:
    """Draw the distances from the path, and from where each point should be now."""
    bounds = view.bounds
    errors = [
        (label, values, bound, name)
        for label, values, bound, name in (
            ("off the path, mm", view.series.path_mm, bounds.path_error_mean_mm, "bound of the mean"),
            ("timed error, mm", view.series.timed_mm, bounds.timed_error_mean_mm, "bound of the leader's mean"),
        )
        if values is not None
    ]
    if not errors:
        return None
    figure, axes = strips(view, [label for label, *_ in errors])
    for each, (_, values, bound, name) in zip(axes, errors, strict=True):
        settling(each, view.config.run.spacing_settle_s)
        _robots_lines(each, view, values)
        zoomed(each, values[view.counted(view.config.run.spacing_settle_s)], bound)
        level(each, bound, name)
    return figure


def poses(view: View) -> Figure | None:
    """Draw the filter's poses against the true ones over time."""
    off, turn = view.series.pose_mm, view.series.heading_deg
    if off is None or turn is None:
        return None
    figure, (position, heading) = strips(view, ["position off, mm", "heading off, deg"])
    _robots_lines(position, view, off)
    zoomed(position, off, view.bounds.pose_error_rms_mm)
    level(position, view.bounds.pose_error_rms_mm, "bound of the rms")
    _robots_lines(heading, view, turn)
    return figure


def pose_distribution(view: View) -> Figure | None:
    """Draw which share of the ticks had a pose error below which size."""
    off, turn = view.series.pose_mm, view.series.heading_deg
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


class Plot(NamedTuple):
    """A plot and what to look for in it."""

    title: str
    draw: Callable[[View], Figure | None]
    caption: str
    legend: Callable[[View], list[tuple[str, str]]] = lambda _: []
    missing: str = ""  # why it was not measured
    long: bool = True  # it must not shrink to a narrow screen


def _robots(view: View) -> list[tuple[str, str]]:
    return _few(list(zip(view.series.robots, view.colours, strict=True)))


def _known(view: View) -> list[tuple[str, str]]:
    """Return the robots whose truth is known."""
    every = zip(view.series.robots, view.colours, view.series.run.known, strict=True)
    return _few([(robot, colour) for robot, colour, known in every if known])


def _few(legend: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return a legend that can be read: of very many robots first, middle and last, whose colours lead over."""
    many = len(legend) > _LEGEND
    return [legend[0], ("…", legend[len(legend) // 2][1]), legend[-1]] if many else legend


def _phases(view: View) -> list[tuple[str, str]]:
    return list({span.name: (span.name, phase_colour(span.phase)) for span in view.timeline.phases}.values())


def _pairs(view: View) -> list[tuple[str, str]]:
    ids = view.series.robots
    return _few([(f"{one} to {other}", c) for one, other, c in zip(ids, ids[1:], view.colours[1:], strict=False)])


_NO_TRUTH = "Not measured: true poses are known of simulated robots only."

SECTIONS: dict[str, tuple[Plot, ...]] = {
    "What happened": (
        Plot(
            "On the time axis", happened,
            "Phases on top. A cross is a stop of a robot; a bar is something that lasted: a fault that was injected, "
            "ticks that were missed, the barrier changing a command; a stroke is news of the tracker. Dotted red lines "
            "and coloured bands stand at the same times in every plot below.",
            _phases,
        ),
        Plot(
            "Paths of the points", paths,
            "The dashed line is the path, a ring a start, a disc a robot's body at the end. The trails lie over each "
            "other, the leader's the widest: a platoon that follows looks like one striped band. Red crosses: stops.",
            _robots, long=False,
        ),
    ),
    "Following": (
        Plot(
            "Control error", control_error,
            "How far each point will be from its reference after the horizon, before the controller's correction, on "
            "its own estimate. It falls steeply at the start and then stays low and level; a robot that does not do as "
            "told rises above the others. In the grey part it is not counted. It is the reference's distance from "
            "x + T u, and from x + T (u + w) where a disturbance w is estimated.",
            _robots,
        ),
        Plot(
            "Spacing", spacing,
            "Distance of each point from its predecessor's: above all of it, below the difference from d, large enough "
            "to see what counts. Lines should close in on d and stay; a swing that grows from robot to robot would "
            "mean that the platoon amplifies.",
            _pairs, "Not measured: one robot has no neighbour.",
        ),
        Plot(
            "Reference speed and wheels", speeds,
            "Above, how fast the references move along the path, which asks for this speed. Below, the faster wheel of "
            "each robot as commanded: where it touches the limit the robot cannot follow.",
            _robots,
        ),
        Plot(
            "True errors", true_errors,
            "From the true poses that are known. Distance from the path; below, from where the point should be now. "
            "The axes show the part that counts: the start may lie above them. A robot that stands still keeps a small "
            "control error, but not these.",
            _known, _NO_TRUTH,
        ),
    ),
    "Poses": (
        Plot(
            "The filter against the truth", poses,
            "How far the controller's idea of each robot is from where it really was at the tick. Peaks are moments "
            "without an image, or with a slip that the filter did not expect.",
            _known, _NO_TRUTH,
        ),
        Plot(
            "Distribution", pose_distribution,
            "Which share of the ticks had an error below a size: steep and far left is good, a long tail to the right "
            "means rare, large errors.",
            _known, _NO_TRUTH,
        ),
    ),
    "Timing": (
        Plot(
            "From the image to the wheel", latency,
            "How old an image is when its poses are sent, when a tick takes them, and when a wheel is given the "
            "command. Narrow and left is good; a tail to the right is a late message.",
            delays, "Not measured: no command reached a wheel.",
        ),
        Plot(
            "Ticks", ticks,
            "How long each tick computed, and how late it began; both axes are logarithmic, so that one bad tick in "
            "thousands can be seen. In lockstep no time passes while a process computes: no tick is late.",
        ),
    ),
}  # fmt: skip

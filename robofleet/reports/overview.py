"""The two pictures that say most of a run: where every point was on the arena, and what happened when."""

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from matplotlib.patheffects import withStroke

from robofleet.behaviours.interface import Dots, Shape
from robofleet.config import obstacles
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.figures import INK, QUIET, robot_colours
from robofleet.recording import notes
from robofleet.recording.run import Run
from robofleet.reports.canvas import ALARM, CLOCK_TIME, WIDTH, RunView, phase_colour, sheet
from robofleet.reports.timeline import CONTROLLER, FAULTS, TRACKER, Entry

_ARENA_MARGIN_M = 0.1
_TRAIL_STEP_M = 0.006  # a trail has no points that are closer
_NAME_SHARE = 0.3  # of the axis that a fault's name takes
_ROW_INCH = 0.24
_OBSTACLE_GREY = "#d6d6d6"
_MOST_ROWS = 12  # of faults, and of robots that have a row whatever happened to them


def paths(view: RunView) -> Figure:
    """Draw every point's trail over the arena, the bodies at the end, and where a robot was stopped."""
    figure, axes = floor(view)
    draw_paths(axes, view)
    return figure


def draw_paths(axes: Axes, view: RunView) -> None:
    """Draw them over a floor."""
    points = view.run.points()
    ranks = [1 - k / max(len(group.robots) - 1, 1) for group in view.run.groups for k in range(len(group.robots))]
    references = view.run.references
    for row, colour in enumerate(view.colours):
        walked = trail(points[:, row])
        axes.plot(*trail(references[:, row]).T, color=colour, lw=0.6, ls=(0, (1, 3)), zorder=2.4)
        axes.plot(*walked.T, color=colour, lw=1.2 + 4.5 * ranks[row])  # each shows beside the next one's
        axes.plot(*walked[0], "o", ms=4, mfc="white", mec=colour)
    _bodies(axes, view)
    for entry in view.timeline.entries:
        if entry.stop and entry.who in view.run.robots:
            at = min(int(np.searchsorted(view.run.clock_time_s, entry.t_s)), len(points) - 1)
            axes.plot(*points[at, view.run.robots.index(entry.who)], "x", color=ALARM, ms=7, mew=1.8, zorder=6)


def floor(view: RunView) -> tuple[Figure, Axes]:
    """Draw the arena with its obstacles, and what the groups' behaviours have on its floor."""
    figure = Figure(figsize=(WIDTH, floor_inch(view.config)))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    draw_floor(axes, view.config, floor_shapes(view.run))
    return figure, axes


def floor_shapes(run: Run) -> list[Shape]:
    """Return what the groups' behaviours and their scripts have on the floor."""
    return [shape for group in run.groups for shape in (*group.shapes, *notes.marks(run.recording, group.name))]


def floor_inch(config: Config) -> float:
    """Return how high an arena is that is as wide as a plot [inch]."""
    width, height = config.arena.size_m
    return WIDTH * (height + 2 * _ARENA_MARGIN_M) / (width + 2 * _ARENA_MARGIN_M)


def draw_floor(axes: Axes, config: Config, shapes: Iterable[Shape]) -> None:
    width, height = config.arena.size_m
    x, y = width / 2 + _ARENA_MARGIN_M, height / 2 + _ARENA_MARGIN_M
    axes.set(xlim=(-x, x), ylim=(-y, y), aspect="equal")
    axes.axis("off")
    axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, fc="none", ec=QUIET, lw=1.0))
    _solids(axes, config)
    robots = [robot.id for robot in config.members]
    colours = dict(zip(robots, robot_colours(len(robots)), strict=True))
    for shape in shapes:
        _shape(axes, shape, colours)
    below = -height / 2 - _ARENA_MARGIN_M / 2
    axes.plot([-width / 2, -width / 2 + 0.5], [below] * 2, color=QUIET, lw=2)
    axes.text(-width / 2 + 0.54, below, "0.5 m", va="center", color=INK, fontsize=8)


def _solids(axes: Axes, config: Config) -> None:
    for solid in obstacles.every(config.arena):
        axes.add_patch(
            Polygon(solid.outline, fc="none" if solid.floor else _OBSTACLE_GREY, ec=QUIET, lw=1.0, zorder=1.5)
        )
        if not solid.floor:
            name = axes.annotate(
                solid.name, solid.outline.mean(axis=0), color=INK, ha="center", va="center", fontsize=7
            )
            name.set_path_effects([withStroke(linewidth=2.0, foreground="white")])


def _shape(axes: Axes, shape: Shape, robots: dict[str, str]) -> None:
    """Draw a shape; ``robots``: the colours of those whose own lines are named after them."""
    if isinstance(shape, Dots):
        for row, (x, y) in enumerate(shape.points):
            axes.plot(x, y, "o", ms=3, color=robot_colours(len(shape.points))[row], zorder=2.5)
        return
    points = np.concatenate([shape.points, shape.points[:1]]) if shape.closed else shape.points
    colour = robots.get(shape.name, INK)
    axes.plot(*points.T, color=colour, lw=0.8, ls=(0, (4, 4)), zorder=2.5)
    for k in {max(1, len(points) // 4), 3 * len(points) // 4} if shape.directed and len(points) > 1 else ():
        look = {"arrowstyle": "-|>", "color": colour, "lw": 0.8}
        axes.annotate("", points[k], points[k - 1], arrowprops=look, zorder=2.5)


def _bodies(axes: Axes, view: RunView) -> None:
    poses = view.run.poses()
    for row, (robot, colour) in enumerate(zip(view.config.members, view.colours, strict=True)):
        draw_body(axes, robot, poses[-1, row], colour)
    for robot, pose in zip(view.config.bystanders, view.run.standing(), strict=True):
        if np.isfinite(pose).all():
            draw_body(axes, robot, pose, QUIET)


def draw_body(axes: Axes, robot: Robot, pose: Array, colour: str, *, named: bool = True) -> None:
    x, y, psi = pose
    radius = robot.vehicle.body_radius_m
    axes.add_patch(Circle((x, y), radius, fc=colour, ec=colour, alpha=0.35, zorder=3))
    nose = x + radius * np.cos(psi), y + radius * np.sin(psi)
    axes.plot([x, nose[0]], [y, nose[1]], color=colour, lw=2, zorder=4)
    if not named:
        return
    name = axes.annotate(robot.id, (x, y), color=INK, ha="center", va="center", fontsize=8, fontweight="bold", zorder=5)
    name.set_path_effects([withStroke(linewidth=2.0, foreground="white")])  # trails cross it


def trail(points: Array) -> Array:
    """Return points (K, 2) without those that are closer to the last one than a pixel."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        return np.full((1, 2), np.nan)
    walked = np.cumsum(np.hypot(*np.diff(points, axis=0, prepend=points[:1]).T))
    _, kept = np.unique((walked / _TRAIL_STEP_M).astype(np.int64), return_index=True)
    return points[[*kept, -1]]


def happened(view: RunView) -> Figure:
    """Draw the phases, and a row for every fault that was injected and for everybody to whom something happened."""
    timeline, robots = view.timeline, view.run.robots
    faults = [entry for entry in timeline.entries if entry.who == FAULTS][:_MOST_ROWS]
    concerned = {entry.who for entry in timeline.entries}
    rows = [name for name in (CONTROLLER, TRACKER, *robots) if name in concerned or name in robots[:_MOST_ROWS]]
    figure, (axes,) = sheet(_ROW_INCH * (len(faults) + len(rows) + 1) + 0.6)
    labels = ["phase", *["fault"] * len(faults), *rows]
    axes.set(xlim=(timeline.shown_s, max(timeline.end_s, timeline.shown_s + 0.1)), ylim=(len(labels) - 0.5, -0.5))
    axes.set(xlabel=CLOCK_TIME, yticks=range(len(labels)), yticklabels=labels)
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    _phases(axes, view)
    for row, entry in enumerate(faults, 1):
        _fault(axes, entry, row)
    colours = dict(zip(robots, view.colours, strict=True))
    for entry in timeline.entries:
        if entry.who in rows:
            _entry(axes, entry, 1 + len(faults) + rows.index(entry.who), colours.get(entry.who, INK))
    return figure


def _fault(axes: Axes, entry: Entry, row: int) -> None:
    """Draw a fault and its name: where there is more room, before it or behind it, else on it."""
    low, high = axes.get_xlim()
    before, behind = entry.t_s - low, high - entry.until_s
    axes.broken_barh([(entry.t_s, entry.until_s - entry.t_s)], (row - 0.26, 0.52), color=ALARM, alpha=0.45)
    at, side, shift = (entry.t_s, "right", -4) if before > behind else (entry.until_s, "left", 4)
    if max(before, behind) < _NAME_SHARE * (high - low):
        at, side, shift = entry.t_s, "left", 4
    axes.annotate(
        entry.what, (at, row), (shift, 0), textcoords="offset points", ha=side, va="center", fontsize=8, color=INK
    )


def _phases(axes: Axes, view: RunView) -> None:
    timeline = view.timeline
    whole = max(timeline.end_s - timeline.shown_s, 0.1)
    for span in timeline.phases:
        begins_s = max(span.t_s, timeline.shown_s)
        axes.broken_barh([(span.t_s, span.until_s - span.t_s)], (-0.42, 0.84), color=phase_colour(span.phase))
        if (span.until_s - begins_s) / whole > 0.012 * len(span.name):  # there is room for the word
            axes.text((begins_s + span.until_s) / 2, 0, span.name, ha="center", va="center", fontsize=8, color=INK)


def _entry(axes: Axes, entry: Entry, row: int, colour: str) -> None:
    if entry.stop:
        axes.axvline(entry.t_s, color=ALARM, lw=0.7, ls=(0, (1, 2)), zorder=0)
        axes.plot(entry.t_s, row, "x", color=ALARM, ms=7, mew=1.8)
    elif entry.until_s > entry.t_s:
        axes.broken_barh([(entry.t_s, entry.until_s - entry.t_s)], (row - 0.26, 0.52), color=colour, alpha=0.55)
    else:
        axes.plot(entry.t_s, row, "|", color=colour, ms=9, mew=1.6)

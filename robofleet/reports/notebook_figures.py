"""The plots that a notebook shows: of a recorded run, and of robots on the floor now."""

from collections.abc import Iterator
from io import BytesIO
from itertools import islice

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.behaviours.described import COMMON_FIGURES
from robofleet.core.figures import STYLE, robot_colours
from robofleet.recording.gauge import Curve
from robofleet.recording.run import GroupColumns
from robofleet.reports.arena_card import ArenaView
from robofleet.reports.canvas import WIDTH, RunView, lines, over_time
from robofleet.reports.group_plots import draw_curve, shown
from robofleet.reports.overview import draw_body, draw_floor, draw_paths, floor_inch, floor_shapes, trail

_MOST_STRIPS, _STRIP_INCH = 3, 1.5
_COMMON = [figure.name for figure in COMMON_FIGURES]


class NotebookFigure(Figure):
    """A figure that a notebook shows, also where nobody has loaded ``matplotlib.pyplot``."""

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", dpi=120, facecolor="white")
        return buffer.getvalue()


def of_run(view: RunView) -> Figure:
    """Return the floor with every robot's path, and below it its group's errors over time."""
    curves = list(islice(_curves(view), _MOST_STRIPS))
    heights = floor_inch(view.config), _STRIP_INCH * max(len(curves), 1) + 0.3
    with mpl.rc_context(STYLE):
        figure = NotebookFigure(figsize=(WIDTH, sum(heights)))
        (above,), (below,) = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)
        axes = above.add_axes((0.0, 0.0, 1.0, 1.0))
        draw_floor(axes, view.config, floor_shapes(view.run))
        draw_paths(axes, view)
        if not curves:
            (axes,) = over_time(below, heights[1], view, ["faster wheel, rad/s"])
            items = view.run.items
            faster = np.maximum(abs(items["left_rad_s"]), abs(items["right_rad_s"]))
            lines(axes, view.run.clock_time_s, faster, view.span, view.colours)
        else:
            labels = [curve.label for _, curve in curves]
            for axes, (part, curve) in zip(over_time(below, heights[1], view, labels), curves, strict=True):
                draw_curve(axes, view, part, curve)
    return figure


def _curves(view: RunView) -> Iterator[tuple[GroupColumns, Curve]]:
    """Yield the groups' curves of which less is better, those first by which behaviours are compared."""
    curves = [
        (part, curve)
        for part in view.run.parts
        for curve in shown(part)
        if curve.asked is None and curve.unit != "s" and np.isfinite(curve.values).any()  # an age is no error
    ]
    return iter(sorted(curves, key=lambda own: _COMMON.index(own[1].name) if own[1].name in _COMMON else len(_COMMON)))


def of_floor(view: ArenaView) -> Figure:
    """Return robots on the floor, with their trails and references."""
    with mpl.rc_context(STYLE):
        figure = NotebookFigure(figsize=(WIDTH, floor_inch(view.config)))
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        draw_floor(axes, view.config, view.shapes)
        colours = robot_colours(len(view.poses))
        for row, (robot, colour) in enumerate(zip(view.config.members, colours, strict=True)):
            axes.plot(*trail(view.trails[:, row]).T, color=colour, lw=1.2)
            axes.plot(*view.references[row], "+", color=colour, ms=9, mew=1.5, zorder=5)
            draw_body(axes, robot, view.poses[row], colour)
    return figure

"""Draws an experiment's figures with matplotlib, as PNG and SVG: no window, no global state."""

from pathlib import Path
from textwrap import fill

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Sheet
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, INK, QUIET, STYLE
from robofleet.experiments.results import Curve, Figure, Panel, RunFigure
from robofleet.reports.canvas import add_legend

_LINES = {"solid": "-", "dashed": (0, (4, 3)), "dots": "none"}
_PANEL_WIDTH_INCH, _PANEL_HEIGHT_INCH = 5.0, 2.9
_LEGEND_INCH, _CAPTION_LETTERS = 0.25, 110
_DPI = 160
_DIED_AWAY_SHARE = 0.3  # of the peak
_LABEL_HEIGHT_SHARE = 0.065  # of the axes
_BLUES = LinearSegmentedColormap.from_list("blues", ["#ffffff", "#1b6ca8"])


def draw(figure: Figure | RunFigure, stem: Path) -> list[Path]:
    """Write ``stem``.png and ``stem``.svg; return both."""
    with mpl.rc_context(STYLE):
        sheet = _of_run(figure) if isinstance(figure, RunFigure) else _of_panels(figure)
        tight = "tight" if isinstance(figure, RunFigure) else None
        files = [stem.with_name(f"{stem.name}.{kind}") for kind in ("png", "svg")]
        sheet.savefig(files[0], dpi=_DPI, bbox_inches=tight)
        sheet.savefig(files[1], metadata={"Date": None}, bbox_inches=tight)
    return files


def _of_run(figure: RunFigure) -> Sheet:
    """Draw a plot of a run with its title and its legend above, its caption below."""
    plot, view = figure.plot, figure.view
    sheet = plot.draw(view)
    assert sheet is not None
    legend, height = plot.legend(view), sheet.get_figheight()
    if legend:
        add_legend(sheet, legend)
    above = (_LEGEND_INCH if legend else 0.0) / height
    left = sheet.axes[0].get_position().x0
    sheet.text(left, 1.0 + above, plot.title, va="bottom", fontsize=10, fontweight="bold", color=INK)
    sheet.text(left, -0.05 / height, fill(plot.caption, _CAPTION_LETTERS), va="top", fontsize=8, color=INK)
    return sheet


def _of_panels(figure: Figure) -> Sheet:
    count = len(figure.panels)
    columns = 3 if count == 3 else min(count, 2)
    rows = -(-count // columns)
    width = (1.0 if columns < 3 else 0.8) * _PANEL_WIDTH_INCH * columns
    height = _PANEL_HEIGHT_INCH * rows + 0.4
    if count == 1:
        width, height = 6.4, height + 1.2 * figure.panels[0].equal
    sheet = Sheet(figsize=(width, height), layout="constrained")
    sheet.suptitle(figure.title, x=0.01, ha="left", fontsize=10, fontweight="bold", color=INK)
    grid = sheet.subplots(rows, columns, squeeze=False)
    for axes, panel in zip(grid.flat, figure.panels, strict=False):
        _panel(axes, panel)
    for axes in grid.flat[count:]:
        axes.remove()
    return sheet


def _panel(axes: Axes, panel: Panel) -> None:
    axes.set(xlabel=panel.x_label, ylabel=panel.y_label, xscale=panel.scales[0], yscale=panel.scales[1])
    axes.set_title(panel.title)
    for axis, scale in zip((axes.xaxis, axes.yaxis), panel.scales, strict=True):
        if scale == "log":
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    if panel.field is not None:
        field = panel.field
        axes.grid(visible=False)
        axes.pcolormesh(field.x, field.y, field.values, cmap=_BLUES, vmin=0.0, vmax=1.6, shading="nearest")
    colours = iter(COLOURS * len(panel.curves))
    for curve in panel.curves:
        colour = QUIET if curve.style == "dashed" else next(colours)
        marker = "o" if curve.style == "dots" else ""
        line = _LINES[curve.style]
        width = 1.0 if curve.style == "dashed" else 1.4
        axes.plot(
            curve.x, curve.y, color=colour, linestyle=line, linewidth=width, marker=marker, ms=3, label=curve.label
        )
    axes.margins(x=0.0)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="center", ncols=1)
    elif panel.y_limits is not None:
        axes.set_ylim(*panel.y_limits)
    if not panel.equal:
        _label(axes, panel.curves)


def _label(axes: Axes, curves: tuple[Curve, ...]) -> None:
    """Write each label right of the axes, in its curve's colour, at the height of the curve's end or its peak."""
    low, high = axes.get_ylim()
    linear = axes.get_yscale() == "linear"
    heights = []
    for line, curve in zip(axes.get_lines(), curves, strict=True):
        if curve.label:
            at = float(np.clip(_height(curve.y) if linear else curve.y[-1], low, high))
            share = (at - low) / (high - low) if linear else np.log(at / low) / np.log(high / low)
            heights.append((float(share), curve.label, line.get_color()))
    heights.sort(key=lambda item: round(item[0], 2))  # equal ones in the order of the curves
    for share, (_, label, colour) in zip(_spread([share for share, *_ in heights]), heights, strict=True):
        axes.text(
            1.015, share, label, transform=axes.transAxes, color=colour, va="center", fontsize=8, fontweight="bold"
        )


def _height(y: Array) -> float:
    """Return y's end, or its peak where it has died away by then; of two nearly equal peaks the positive."""
    if abs(y[-1]) > _DIED_AWAY_SHARE * np.abs(y).max():
        return float(y[-1])
    return float(y.max() if y.max() > -0.95 * y.min() else y.min())


def _spread(shares: list[float]) -> list[float]:
    """Return ascending heights, moved apart where they are too close, inside [0, 1] if there is room."""
    for k in range(1, len(shares)):
        shares[k] = max(shares[k], shares[k - 1] + _LABEL_HEIGHT_SHARE)
    top = 1.0
    for k in range(len(shares) - 1, -1, -1):
        shares[k] = min(shares[k], top)
        top = shares[k] - _LABEL_HEIGHT_SHARE
    return shares

"""The page about a camera's pose: its uncertainty over the floor, and each mark's error."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robofleet.calibration.extrinsics.consensus import Agreement
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.region import COLUMNS, ROWS
from robofleet.calibration.report import BLUES, Report
from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, INK, STYLE

_PLOT_WIDTH = 7.0  # [inch]
_ARROW_SHARE = 0.12  # of the longest arrow, over the floor's width


class Found(NamedTuple):
    """A camera's place that can be used."""

    camera: Path
    model: CameraModel  # with it
    agreement: Agreement
    marks: Marks
    points: Array  # (ROWS * COLUMNS, 3) of the floor that matters [m; world]
    sigma_mm: Array  # (G,) at these; NaN: out of sight
    notes: tuple[str, ...]  # marks that were left out, and what else to know
    kept: Path | None = None  # where the calibration before went

    @property
    def figures(self) -> dict[str, float | None]:
        assert self.model.arena is not None
        return self.model.arena.figures


def write_page(file: Path, found: Found) -> None:
    """Write the page about a camera's place."""
    model, agreement, marks, points, figures = found.model, found.agreement, found.marks, found.points, found.figures
    report = Report(f"Where {found.camera.stem} hangs")
    report.verdict(
        f"Expected error on the arena: {figures['predicted_rms_mm']:.2f} mm rms, {figures['predicted_max_mm']:.2f} mm "
        f"at most, from {figures['marks_used']:.0f} marks.",
        good=True,
    )
    if found.notes:
        report.verdict("\n".join(found.notes), good=False)
    with mpl.rc_context(STYLE):
        report.section("Expected error", "One standard deviation, both coordinates together, where robots wear tags.")
        report.figure(_heat_map(points, found.sigma_mm, marks, agreement), "White: out of the camera's sight.")
        report.section("Marks", "Each mark is compared with a pose that was fitted to all the others.")
        report.figure(_arrows(points, marks, agreement), "From where a mark was surveyed to where it is seen.")
    _table(report, marks, agreement)
    report.section("The camera's place")
    _place(report, model)
    assert model.arena is not None
    report.origin(model.arena)
    report.write(file)


def _axes(points: Array) -> tuple[Figure, Axes]:
    x, y, _ = np.ptp(points, axis=0)
    height = min(1.5 * _PLOT_WIDTH, _PLOT_WIDTH * (y + 0.2 * x) / (1.2 * x)) if x > 0 else _PLOT_WIDTH
    figure = Figure(figsize=(_PLOT_WIDTH, max(2.5, height)), layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    return figure, axes


def _heat_map(points: Array, sigma_mm: Array, marks: Marks, agreement: Agreement) -> Figure:
    figure, axes = _axes(points)
    axes.grid(visible=False)
    x, y = (np.unique(points[:, k]) for k in (0, 1))
    values = np.ma.masked_invalid(sigma_mm.reshape(ROWS, COLUMNS))
    image = axes.pcolormesh(x, y, values, cmap=BLUES, vmin=0.0, shading="nearest", rasterized=True)
    lines = axes.contour(x, y, values, 5, colors=INK, linewidths=0.6)
    axes.clabel(lines, fmt="%.2f")
    _dots(axes, marks, agreement)
    figure.colorbar(image, ax=axes, label="mm", shrink=0.8)
    return figure


def _arrows(points: Array, marks: Marks, agreement: Agreement) -> Figure:
    figure, axes = _axes(points)
    known = np.isfinite(agreement.error[:, 0])
    used = known & agreement.inside
    longest = np.hypot(*agreement.error[used].T).max() if used.any() else 1e-3
    scale = _ARROW_SHARE * np.ptp(points[:, 0]) / longest
    for which, colour in ((used, COLOURS[0]), (known & ~agreement.inside, COLOURS[1])):
        # One that was left out may be far off: its arrow is cut, its number is in the table.
        error = agreement.error[which]
        cut = np.minimum(1.0, 3.0 * longest / np.maximum(np.hypot(*error.T), 1e-12))[:, None]
        x, y = marks.points[which, :2].T
        style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.004}
        axes.quiver(x, y, *(scale * cut * error).T, color=colour, **style)
    _dots(axes, marks, agreement)
    axes.margins(0.15)
    axes.set_title(f"the longest blue arrow is {1e3 * longest:.2f} mm")
    return figure


def _dots(axes: Axes, marks: Marks, agreement: Agreement) -> None:
    for name, (x, y, _), used in zip(marks.names, marks.points, agreement.inside, strict=True):
        axes.plot(x, y, "o", ms=4, color=INK if used else COLOURS[1])
        axes.annotate(name, (x, y), (4, 4), textcoords="offset points", color=INK if used else COLOURS[1], fontsize=8)


def _table(report: Report, marks: Marks, agreement: Agreement) -> None:
    headings = iter(np.degrees(agreement.placement.heading_error))
    sigma = 1e3 * np.sqrt(np.trace(agreement.covariance, axis1=1, axis2=2))
    rows = []
    for i, used in enumerate(agreement.inside):
        x, y = (1e3 * agreement.error[i]).tolist()
        heading = float(next(headings)) if used else math.nan
        cells = (x, y, math.hypot(x, y), float(sigma[i]), heading)
        shown = [None if math.isnan(cell) else cell for cell in cells]
        rows.append((marks.names[i], *marks.points[i].tolist(), *shown, "" if used else "left out"))
    where, off = ("x, m", "y, m", "height, m"), ("off in x, mm", "in y, mm", "both, mm", "expected, mm")
    report.table(("mark", *where, *off, "heading off, deg", ""), rows)


def _place(report: Report, model: CameraModel) -> None:
    assert model.arena is not None and model.T_world_camera is not None
    sigma = np.sqrt(np.diagonal(np.array(model.arena.covariance)))
    x, y, z = model.T_world_camera.position_m
    report.table(
        ("", "value", "standard deviation"),
        [
            ("position x, m", x, f"{1e3 * sigma[3]:.2f} mm"),
            ("position y, m", y, f"{1e3 * sigma[4]:.2f} mm"),
            ("position z, m", z, f"{1e3 * sigma[5]:.2f} mm"),
            *(
                (f"rotation about {axis}, rad", value, f"{math.degrees(s):.4f} degrees, about the world's {axis}")
                for axis, value, s in zip("xyz", model.T_world_camera.rotation_rad, sigma[:3], strict=True)
            ),
        ],
    )

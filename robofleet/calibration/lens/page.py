"""The page about a lens: coverage of the image, residuals, and the uncertainty on the floor."""

from collections.abc import Sequence

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from robofleet.calibration.lens import floor
from robofleet.calibration.lens.board import BoardView
from robofleet.calibration.lens.gathering import Gathering
from robofleet.calibration.lens.intrinsics import Measured
from robofleet.calibration.lens.views import Lean, cell_counts, tilt
from robofleet.calibration.report import Report, in_words
from robofleet.core.figures import COLOURS, QUIET, STYLE
from robofleet.reports.pages import Marked, Picture

_HEAT = LinearSegmentedColormap.from_list("heat", ["#ffffff", COLOURS[0], "#0b2f4a"])
_LEANS = dict(zip(Lean, (QUIET, *COLOURS[:4]), strict=True))
_ARROW_CELLS = (16, 9)
_CURVE_POINTS = 60
_THUMBNAIL_WIDTH_PX = 240
_CORNER_BGR = (90, 60, 230)


def page(measured: Measured, gathering: Gathering, faults: Sequence[str]) -> Report:
    report = Report("Camera lens")
    warnings = measured.warnings()
    if not faults:
        report.verdict(
            f"The views determine the lens: places are known to {measured.arena_mm:.2f} mm rms over the arena.",
            good=True,
        )
    if faults or warnings:
        report.verdict("\n".join((*faults, *warnings)), good=False)
    with mpl.rc_context(STYLE):
        report.section("Figures")
        report.figures(measured.figures(measured.held_out()))
        _lens(report, measured)
        report.section("Where the board was")
        report.figure(coverage_figure(measured), "Corners of the views that were used, by the edge that was away.")
        report.section("On the floor")
        report.figure(floor_figure(measured), _floor_caption(measured), long=True)
        report.section("Residuals")
        report.figure(residual_figure(measured), "Left: each corner's residual. Right: means over cells, magnified.")
        _views(report, measured, gathering)
    return report


def distortion_figure(measured: Measured) -> Figure:
    """Draw the distortion along the image's longest radius, and how certain it is."""
    lens, (width, height) = measured.fit.lens, measured.conditions.size
    focal, centre = lens.values[:2], lens.values[2:4]
    corners = np.array([(x, y) for x in (0.0, width - 1.0) for y in (0.0, height - 1.0)])
    way = max((corners - centre).tolist(), key=lambda corner: float(np.hypot(*corner)))
    pixels = centre + np.linspace(0.0, 1.0, _CURVE_POINTS)[1:, None] * way
    slopes = lens.slopes(pixels)
    known = np.isfinite(slopes).all(axis=1)  # a lens that folds has no rays there
    pixels, slopes = pixels[known], slopes[known]
    steep = np.linalg.norm(slopes, axis=1, keepdims=True)
    straight = focal * (slopes / steep * np.arctan(steep) if lens.kind == "fisheye" else slopes)
    radius = np.linalg.norm(pixels - centre, axis=1)
    _, by_lens, _ = lens.project(np.column_stack([slopes, np.ones(len(slopes))]), np.zeros(6))
    variance = np.einsum("gip,pq,giq->g", by_lens, measured.fit.covariance, by_lens) if len(slopes) else np.zeros(0)
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    curve, certain = figure.subplots(1, 2)
    curve.plot(radius, radius - np.linalg.norm(straight, axis=1), color=COLOURS[0])
    curve.set(xlabel="radius, px", ylabel="farther out, px")
    certain.plot(radius, np.sqrt(np.maximum(variance, 0.0)), color=COLOURS[1])
    certain.set(xlabel="radius, px", ylabel="standard deviation, px", ylim=(0.0, None))
    return figure


def coverage_figure(measured: Measured) -> Figure:
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.subplots()
    leans = [tilt(pose)[0] for pose in measured.fit.poses]
    for lean in Lean:
        seen = [view.pixels for view, own in zip(measured.fit.views, leans, strict=True) if own is lean]
        if seen:
            name = "flat" if lean is Lean.FLAT else f"{lean.value} edge away"
            points = np.concatenate(seen)
            axes.plot(*points.T, ".", color=_LEANS[lean], ms=3, label=f"{name}: {len(seen)}")
    _image_frame(axes, measured)
    figure.legend(loc="outside lower center", markerscale=3, ncols=3)
    return figure


def floor_figure(measured: Measured) -> Figure:
    """Draw the uncertainty over the image, before and after the pose is fitted to floor tags."""
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    titles = ("with the camera's place known, mm", "after its place is fitted to floor tags, mm")
    for axes, title, refitted in zip(figure.subplots(1, 2), titles, (False, True), strict=True):
        sigma = measured.floor.sigma_mm(measured.fit.covariance, refitted=refitted)
        _image_frame(axes, measured)
        width, height = measured.conditions.size
        image = axes.imshow(
            sigma.reshape(floor.ROWS, floor.COLUMNS),
            extent=(-0.5, width - 0.5, height - 0.5, -0.5),
            cmap=_HEAT, vmin=0.0, interpolation="bilinear",
        )  # fmt: skip
        axes.set_title(title)
        axes.grid(visible=False)
        figure.colorbar(image, ax=axes, shrink=0.85).outline.set_visible(False)
    return figure


def residual_figure(measured: Measured) -> Figure:
    """Draw all residuals, and where in the image they point the same way."""
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    cloud, field = figure.subplots(1, 2, width_ratios=(1, 2))
    residuals = np.concatenate(measured.fit.residuals)
    cloud.plot(*residuals.T, ".", color=COLOURS[0], ms=2, alpha=0.5)
    reach = 1.05 * float(np.percentile(np.abs(residuals), 99.9))
    cloud.set(xlabel="u, px", ylabel="v, px", aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
    _image_frame(field, measured)
    at, mean = _means(measured, residuals)
    longest = max(float(np.abs(mean).max(initial=0.0)), 1e-9)
    scale = longest / (0.8 * measured.conditions.size[0] / _ARROW_CELLS[0])
    field.quiver(*at.T, *mean.T, angles="xy", scale_units="xy", scale=scale, color=COLOURS[1], width=0.004)
    field.set_title(f"longest arrow: {longest:.3f} px")
    return figure


def _means(measured: Measured, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return cells' middles and mean residuals (K, 2) [px], of cells with enough corners."""
    pixels = np.concatenate([view.pixels for view in measured.fit.views])
    width, height = measured.conditions.size
    cell = np.array([width / _ARROW_CELLS[0], height / _ARROW_CELLS[1]])
    cells = ((pixels + 0.5) // cell).astype(int)
    found = [(key, mask) for key in np.unique(cells, axis=0) if (mask := (cells == key).all(axis=1)).sum() >= 5]
    at = np.array([(key + 0.5) * cell - 0.5 for key, _ in found]).reshape(-1, 2)
    return at, np.array([residuals[mask].mean(axis=0) for _, mask in found]).reshape(-1, 2)


def _image_frame(axes: Axes, measured: Measured) -> None:
    width, height = measured.conditions.size
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal", xlabel="u, px", ylabel="v, px")


def _floor_caption(measured: Measured) -> str:
    ceiling = measured.conditions.ceiling
    return (
        f"Standard deviation of a tag's place at {ceiling.tag_height_m:g} m, seen from {ceiling.height_m:g} m, "
        "from the lens's covariance. Left: an error of the lens as it is. Right: what remains when the "
        "camera's pose is fitted to eight floor tags near the image's rim, as robofleet calibrate arena does."
    )


def _lens(report: Report, measured: Measured) -> None:
    lens, fit = measured.fit.lens, measured.fit
    report.section(
        "Lens",
        f"{lens.kind}; standard deviations from the Jacobian and the corners' robust noise ({fit.noise_px:.3f} px), "
        "and from leaving out each view in turn (jackknife).",
    )
    sigmas = (np.sqrt(np.diag(covariance)) for covariance in (fit.covariance, fit.jackknife))
    rows = [
        (in_words(name), f"{value:.6g}", float(noise), float(left_out))
        for name, value, noise, left_out in zip(lens.names, lens.values, *sigmas, strict=True)
    ]
    report.table(("parameter", "value", "standard deviation", "the same, by leaving out views"), rows)
    straight = "a ray's angle times the focal length" if lens.kind == "fisheye" else "a lens without distortion"
    report.figure(
        distortion_figure(measured),
        f"From the principal point to the image's farthest corner. Left: how much farther out a ray is seen than by "
        f"{straight}. Right: one standard deviation of where it is seen.",
    )


def _thumbnail(view: BoardView, text: str, *, good: bool | None) -> Picture:
    scale = _THUMBNAIL_WIDTH_PX / view.image.shape[1]
    small = cv2.resize(view.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    drawn = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    for u, v in (scale * (view.pixels + 0.5)).astype(int).tolist():
        cv2.circle(drawn, (u, v), 1, _CORNER_BGR, -1)
    _, jpeg = cv2.imencode(".jpg", drawn, [cv2.IMWRITE_JPEG_QUALITY, 75])
    return Picture(jpeg.tobytes(), Marked(text, good))


def _views(report: Report, measured: Measured, gathering: Gathering) -> None:
    fit = measured.fit
    report.section("Views", "Influence: how far places move over the arena when the view is left out, rms.")
    rows: list[tuple[object, ...]] = []
    for view, pose, miss, change in zip(fit.views, fit.poses, fit.typical_px, fit.leaving_out, strict=True):
        lean, angle = tilt(pose)
        cells = int((cell_counts(measured.conditions.size, view.pixels) > 0).sum())
        where = f"{angle:.0f} deg" if lean is Lean.FLAT else f"{angle:.0f} deg, {lean.value} edge away"
        influence_mm = measured.floor.shift_mm(change)
        rows.append((view.name, len(view.ids), cells, f"{pose[5]:.2f}", where, float(miss), influence_mm))
    report.table(("image", "corners", "cells", "distance, m", "tilt", "typical miss, px", "influence, mm"), rows)
    used = zip(fit.views, fit.typical_px, strict=True)
    left_out = [
        _thumbnail(o.view, f"{o.view.name}: left out, {o.typical_px:.2f} px", good=False) for o in measured.outliers
    ]
    report.pictures([*(_thumbnail(view, f"{view.name}: {miss:.2f} px", good=None) for view, miss in used), *left_out])
    if measured.outliers:
        report.section("Left out", "These views do not fit the others: blurred, moved, bent, or another board.")
        report.table(
            ("image", "corners", "typical miss, px"),
            [(o.view.name, len(o.view.ids), o.typical_px) for o in measured.outliers],
        )
    report.section("Images", ", ".join(f"{count} {offer.value}" for offer, count in gathering.counts.items()) + ".")

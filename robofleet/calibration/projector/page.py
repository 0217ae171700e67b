"""The page about a projector: its predicted error over the floor, and where each tag was seen."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.calibration.extrinsics.region import COLUMNS, ROWS
from robofleet.calibration.projector.measured import Found
from robofleet.calibration.report import BLUES, Report
from robofleet.core.figures import COLOURS, INK, STYLE

_SIZE = 7.0, 5.0  # [inch]
_ARROW_SHARE = 0.08  # of the longest arrow, over the arena's width


def write_page(file: Path, name: str, found: Found) -> None:
    """Write the page about a projector."""
    figures = found.figures
    report = Report(f"Where the light of {name} falls")
    report.verdict(
        f"Expected error on the arena: {figures['predicted_rms_mm']:.2f} mm rms, {figures['predicted_max_mm']:.2f} mm "
        f"at most, from {figures['tags_used']:.0f} tags.",
        good=True,
    )
    if found.notes:
        report.verdict("\n".join(found.notes), good=False)
    with mpl.rc_context(STYLE):
        report.section("Expected error", "One standard deviation, both coordinates together, on the floor.")
        report.figure(_heat_map(found), "White: not lit. The outline is the picture's.")
        report.section("Tags", "Each tag of the pattern, from where the projector lights it to where it was seen.")
        report.figure(_arrows(found), "")
    assert found.model.calibrated is not None
    report.origin(found.model.calibrated)
    report.write(file)


def _heat_map(found: Found) -> Figure:
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots()
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.grid(visible=False)
    x, y = (np.unique(found.points[:, k]) for k in (0, 1))
    values = np.ma.masked_invalid(1e3 * found.sigma_m.reshape(ROWS, COLUMNS))
    image = axes.pcolormesh(x, y, values, cmap=BLUES, vmin=0.0, shading="nearest", rasterized=True)
    figure.colorbar(image, ax=axes, label="mm", shrink=0.8)
    corners = found.fit.projector.corners
    axes.plot(*np.vstack([corners, corners[:1]]).T, color=INK, lw=0.8)
    return figure


def _arrows(found: Found) -> Figure:
    figure = Figure(figsize=_SIZE, layout="constrained")
    axes = figure.subplots()
    used, error = found.fit.used, found.fit.error
    longest = float(np.hypot(*error[used].T).max())
    scale = _ARROW_SHARE * float(np.ptp(found.points[:, 0])) / longest
    axes.quiver(
        *(found.seen - error)[used].T, *(scale * error[used]).T, angles="xy", scale_units="xy", scale=1.0, width=0.003,
        color=COLOURS[0],
    )  # fmt: skip
    axes.plot(*found.seen[~used].T, "x", color=COLOURS[1], label="left out")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal", title=f"the longest arrow is {1e3 * longest:.2f} mm")
    return figure

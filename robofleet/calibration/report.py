"""The page about a calibration."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.colors import LinearSegmentedColormap

from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import Provenance
from robofleet.core.clock import utc_now
from robofleet.core.figures import COLOURS
from robofleet.reports.pages import Page

BLUES = LinearSegmentedColormap.from_list("blues", ["#cfe0f0", COLOURS[0]])  # of errors; white is where none is known
_WORDS = {  # of figures and parameters, as a calibration's file names them
    "views": "views that were used",
    "views_left_out": "views that were left out",
    "corners": "corners of the board in them",
    "corner_noise_px": "noise of a corner's coordinate, px",
    "reprojection_rms_px": "corners from where the lens shows them, rms, px",
    "held_out_rms_px": "corners of views that took no part, from where the lens shows them, rms, px",
    "held_out_rms_mm": "what took no part in the fit, from where it should be, on the floor, rms, mm",
    "held_out_lenses_mm": "lenses of parts of the views, from that of all, over the arena, rms, mm",
    "arena_rms_mm": "uncertainty of a place over the arena by the corners' noise, rms, mm",
    "arena_max_mm": "the same at the worst place, mm",
    "arena_leaving_out_rms_mm": "uncertainty of a place by leaving out each view in turn, rms, mm",
    "arena_pose_fixed_rms_mm": "uncertainty of a place if the camera's pose is not fitted through this lens, rms, mm",
    "camera_height_m": "height of the camera, m",
    "tag_height_m": "height of the robots' tags, m",
    "focal_sigma_percent": "uncertainty of the focal length, %",
    "marks_used": "marks that were used",
    "marks_left_out": "marks that were left out",
    "survey_sigma_mm": "standard deviation of the survey, one coordinate, mm",
    "pixel_sigma_px": "standard deviation of a mark's pixel, one coordinate, px",
    "residual_rms_mm": "marks from their survey, rms, mm",
    "held_out_expected_mm": "the same as it is expected, mm",
    "predicted_rms_mm": "expected error on the arena, rms, mm",
    "predicted_max_mm": "expected error at the worst place, mm",
    "tags_used": "tags of the pattern that were used",
    "tags_left_out": "tags of the pattern that were left out",
    "residual_ratio": "tags from where the projector lights them, over what is expected",
    "covered": "share of the arena that is lit",
    "edge_mm": "standard deviation of an edge on the floor, without the camera's blur, mm",
    "delay_ms": "time from a picture's drawing to its light, ms",
    "arena_in_sight": "share of the arena in sight",
    "f_x_px": "focal length along x, px",
    "f_y_px": "focal length along y, px",
    "c_x_px": "principal point, x, px",
    "c_y_px": "principal point, y, px",
    **{f"k{k}": f"radial distortion k{k}" for k in range(1, 7)},
    **{f"p{k}": f"tangential distortion p{k}" for k in (1, 2)},
    **{f"s{k}": f"thin prism s{k}" for k in range(1, 5)},
    **{f"tau_{axis}_rad": f"tilt of the sensor about {axis}, rad" for axis in "xy"},
}


def in_words(name: str) -> str:
    """Return what a figure or a parameter of a calibration is, with its unit."""
    return _WORDS.get(name, name)


class Report(Page):
    """A page of today."""

    def __init__(self, title: str) -> None:
        super().__init__(title, utc_now().isoformat(timespec="seconds"))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[object]], *, whole: bool = True) -> None:
        super().table(head, rows, whole=whole)

    def figures(self, figures: Mapping[str, float | None]) -> None:
        self.table(("figure", "value"), [(in_words(name), value) for name, value in figures.items()])

    def origin(self, where: Provenance) -> None:
        """Add a calibration's figures, and what it was measured in."""
        self.section("Figures")
        self.figures(where.figures)
        self.section("Measured in")
        self.table(("input", "hash"), list(where.inputs.items()))

    def write(self, file: Path) -> None:
        try:
            super().write(file)
        except OSError as error:
            raise CalibrationError(f"{file}: cannot be written: {error.strerror}") from error

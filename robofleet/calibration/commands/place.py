"""``calibrate.py arena`` and ``verify``: where the camera hangs."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration import frames
from robofleet.calibration.arena import calibrate_arena
from robofleet.calibration.commands.shared import ReportFile, report_file
from robofleet.calibration.store import CalibrationError
from robofleet.calibration.verify import verify as verify_camera

CameraFile = Annotated[Path, typer.Argument(metavar="CAMERA", help="The camera's file, of configs/cameras.")]
SurveyFile = Annotated[Path, typer.Argument(metavar="SURVEY", help="YAML with floor_tags and points, in metres.")]
Images = Annotated[list[Path] | None, typer.Argument(metavar="[IMAGES]...", help="Images, or folders of them.")]
Live = Annotated[Path | None, typer.Option(metavar="CONFIG", help="Take images with this configuration's camera.")]
FrameCount = Annotated[int, typer.Option("--frames", min=1, max=1000, help="Images to average, at most.")]
SurveyMm = Annotated[
    float | None, typer.Option(min=0.01, max=100.0, help="Standard deviation of the survey, one coordinate.")
]


def arena(
    camera: CameraFile,
    survey: SurveyFile,
    images: Images = None,
    live: Live = None,
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
    arena_m: Annotated[
        tuple[float, float] | None, typer.Option(help="Sides of the arena; default: --live's, else where marks lie.")
    ] = None,
    tag_height_m: Annotated[
        float | None, typer.Option(min=0.0, help="Of robots' tags; default: --live's, or 0.")
    ] = None,
    report: ReportFile = None,
) -> None:
    """Find where the camera hangs, from surveyed tags and points on the floor."""
    config = None if live is None else frames.live_config(live)
    if config is not None:
        arena_m = arena_m or config.arena.size_m
        tag_height_m = config.tracker.tag_height_m if tag_height_m is None else tag_height_m
    taken = frames.taken(images or (), config, count)
    page = report_file(report, "arena")
    result = calibrate_arena(camera, survey, taken, page, survey_mm, arena_m, tag_height_m or 0.0)
    for note in result.notes:
        print(note)
    rms, most = result.figures["predicted_rms_mm"], result.figures["predicted_max_mm"]
    print(f"expected error on the arena: {rms:.2f} mm rms, {most:.2f} mm at most")
    print(f"{camera}: written" + (f"; the one before it is {result.kept}" if result.kept else ""))
    print(f"report: {page}")


def verify(
    camera: CameraFile,
    survey: SurveyFile,
    images: Images = None,
    live: Live = None,
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
) -> None:
    """Say whether the camera still hangs where it was calibrated; writes nothing."""
    taken = frames.taken(images or (), None if live is None else frames.live_config(live), count)
    verdict = verify_camera(camera, survey, taken, survey_mm)
    if not verdict.good:
        raise CalibrationError(verdict.sentences)
    for sentence in verdict.sentences:
        print(sentence)

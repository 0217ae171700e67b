"""``robofleet calibrate arena`` and ``verify``: where the camera hangs."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration import frames
from robofleet.calibration.arena import calibrate_arena
from robofleet.calibration.commands.shared import (
    CameraName,
    ConfigsFolder,
    Live,
    Overrides,
    ReportFile,
    known_camera,
    report_file,
)
from robofleet.calibration.commands.shared import live as live_camera
from robofleet.calibration.sizes import size
from robofleet.calibration.store import CalibrationError
from robofleet.calibration.verify import verify as verify_camera

SurveyFile = Annotated[Path, typer.Argument(metavar="SURVEY", help="YAML with floor_tags and points, in metres.")]
Images = Annotated[list[Path] | None, typer.Argument(metavar="[IMAGES]...", help="Images, or folders of them.")]
FrameCount = Annotated[int, typer.Option("--frames", min=1, max=1000, help="Images to average, at most.")]
SurveyMm = Annotated[
    float | None, typer.Option(min=0.01, max=100.0, help="Standard deviation of the survey, one coordinate.")
]


def arena(
    camera: CameraName,
    survey: SurveyFile,
    images: Images = None,
    live: Live = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
    arena_m: Annotated[
        str,
        typer.Option(
            metavar="LONGxSHORT", help="Sides of the arena, as 3.5x2.3; default: --live's, else the area of the marks."
        ),
    ] = "",
    tag_height_m: Annotated[
        float | None, typer.Option(min=0.0, help="Height of the robots' tags; default: --live's, or 0.")
    ] = None,
    configs: ConfigsFolder = None,
    report: ReportFile = None,
) -> None:
    """Find where the camera hangs, from surveyed tags and points on the floor.

    $ robofleet calibrate arena ceiling survey.yaml --live configs/lab.yaml

    $ robofleet calibrate arena ceiling survey.yaml floor.png --arena-m 3.5x2.3

    The camera's file is written again, with its place; `robofleet sheet floor` prints tags for the floor.
    """
    file, config = known_camera(camera, configs, live), live_camera(live, overrides)
    sides = size(arena_m, "--arena-m") if arena_m else None
    if config is not None:
        sides = sides or config.arena.size_m
        tag_height_m = config.tracker.tag_height_m if tag_height_m is None else tag_height_m
    taken = frames.taken(images or (), config, count)
    page = report_file(report, "arena")
    result = calibrate_arena(file, survey, taken, page, survey_mm, sides, tag_height_m or 0.0)
    for note in result.notes:
        print(note)
    rms, most = result.figures["predicted_rms_mm"], result.figures["predicted_max_mm"]
    print(f"expected error on the arena: {rms:.2f} mm rms, {most:.2f} mm at most")
    print(f"{file}: written" + (f"; the one before it is {result.kept}" if result.kept else ""))
    print(f"report: {page}")


def verify(
    camera: CameraName,
    survey: SurveyFile,
    images: Images = None,
    live: Live = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
    configs: ConfigsFolder = None,
) -> None:
    """Say whether the camera still hangs where it was calibrated; writes nothing.

    $ robofleet calibrate verify ceiling survey.yaml --live configs/lab.yaml
    """
    file = known_camera(camera, configs, live)
    taken = frames.taken(images or (), live_camera(live, overrides), count)
    verdict = verify_camera(file, survey, taken, survey_mm)
    if not verdict.good:
        raise CalibrationError(verdict.sentences)
    for sentence in verdict.sentences:
        print(sentence)

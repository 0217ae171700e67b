"""``robofleet calibrate arena`` and ``verify``: where the camera hangs."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration import frames
from robofleet.calibration.commands import shared
from robofleet.calibration.extrinsics.arena import Wanted, calibrate_arena, calibrate_together
from robofleet.calibration.extrinsics.verify import verify as verify_camera
from robofleet.calibration.store import CalibrationError
from robofleet.config.tree import Config

SurveyFile = Annotated[
    Path, typer.Argument(metavar="SURVEY", help="File (YAML) with the positions of floor_tags and points, in metres.")
]
Images = Annotated[
    list[Path] | None, typer.Argument(metavar="IMAGES...", help="Images, or folders of images; not with --live.")
]
FrameCount = Annotated[
    int, typer.Option("--frames", metavar="N", min=1, max=1000, help="Largest number of images to average.")
]
SurveyMm = Annotated[
    float | None,
    typer.Option(metavar="MM", min=0.01, max=100.0, help="Standard deviation of the survey's coordinates, in mm."),
]


def arena(
    camera: shared.CameraName,
    survey: SurveyFile,
    images: Images = None,
    live: shared.Live = None,
    overrides: shared.Overrides = [],  # noqa: B006 - typer copies it
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
    arena_m: Annotated[
        str,
        typer.Option(
            metavar="LONGxSHORT",
            help="Sides of the arena in m, for example 3.5x2.3. Default: from --live, else the surveyed area.",
        ),
    ] = "",
    tag_height_m: Annotated[
        float | None,
        typer.Option(metavar="M", min=0.0, help="Height of the robots' tags, in m. Default: from --live, else 0."),
    ] = None,
    configs: shared.ConfigsFolder = None,
    report: shared.ReportFile = None,
) -> None:
    """Measure where a camera hangs, from tags on the floor.

    The positions of tags and points on the floor come from a survey. `robofleet sheet floor` draws the tags.

    $ robofleet calibrate arena ceiling survey.yaml --live configs/lab.yaml

    $ robofleet calibrate arena ceiling survey.yaml floor.png --arena-m 3.5x2.3

    $ robofleet calibrate arena left,right survey.yaml --live configs/two-cameras.yaml

    The result is written into the camera's file. Several cameras, separated by commas, are measured together, by one
    survey and by the tags that two of them see.
    """
    files = [shared.known_camera(name, configs, live) for name in camera.split(",")]
    if twice := [
        file.stem for k, file in enumerate(files) if file.resolve() in [earlier.resolve() for earlier in files[:k]]
    ]:
        raise CalibrationError(f"{camera}: {twice[0]} is written twice: name each camera once")
    config = shared.live(live, overrides)
    sides = shared.size(arena_m, "--arena-m") if arena_m else None
    if config is not None:
        sides = sides or config.arena.size_m
        tag_height_m = config.tracker.tag_height_m if tag_height_m is None else tag_height_m
    page = shared.report_file(report, "arena")
    taken = _taken(files, images or [], config, count)
    wanted = Wanted(survey, survey_mm, sides, tag_height_m or 0.0)
    if len(files) == 1:
        results = [calibrate_arena(files[0], taken[0], page, wanted)]
    else:
        results = calibrate_together(files, taken, page, wanted)
    for file, result in zip(files, results, strict=True):
        for note in result.notes:
            print(note)
        rms, most = result.figures["predicted_rms_mm"], result.figures["predicted_max_mm"]
        print(f"expected error on the arena: {rms:.2f} mm rms, {most:.2f} mm at most")
        print(f"{file}: written" + (f"; the one before it is {result.kept}" if result.kept else ""))
        own = page if len(files) == 1 else page.with_name(f"{page.stem}-{file.stem}{page.suffix}")
        print(f"report: {own}")


def _taken(files: list[Path], images: list[Path], config: Config | None, count: int) -> list[list[frames.Named]]:
    if config is not None:
        if len(files) > 1 and not config.cameras:
            raise CalibrationError(
                f"--live: the configuration has one `camera`, and {len(files)} are to be placed: give one with "
                "`cameras`, or place each by itself"
            )
        return [frames.taken(images, frames.camera_of(config, file.stem), count) for file in files]
    if len(files) == 1:
        return [frames.taken(images, None, count)]
    if len(images) != len(files):
        raise CalibrationError(f"{len(images)} images or folders of {len(files)} cameras: name one for each, in order")
    return [frames.taken([image], None, count) for image in images]


def verify(
    camera: shared.CameraName,
    survey: SurveyFile,
    images: Images = None,
    live: shared.Live = None,
    overrides: shared.Overrides = [],  # noqa: B006 - typer copies it
    count: FrameCount = 20,
    survey_mm: SurveyMm = None,
    configs: shared.ConfigsFolder = None,
) -> None:
    """Check whether a camera still hangs where it was measured.

    It writes no file.

    $ robofleet calibrate verify ceiling survey.yaml --live configs/lab.yaml
    """
    file = shared.known_camera(camera, configs, live)
    (taken,) = _taken([file], images or [], shared.live(live, overrides), count)
    verdict = verify_camera(file, survey, taken, survey_mm)
    if not verdict.good:
        raise CalibrationError(verdict.sentences)
    for sentence in verdict.sentences:
        print(sentence)

"""``robofleet calibrate intrinsics``."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import typer
from rich.console import Console

from robofleet.calibration.commands.shared import (
    CameraName,
    ConfigsFolder,
    Live,
    Overrides,
    ReportFile,
    camera_file,
    count,
    report_file,
    size,
)
from robofleet.calibration.commands.shared import live as live_camera
from robofleet.calibration.frames import open_camera
from robofleet.calibration.lens.board import Board
from robofleet.calibration.lens.floor import Ceiling
from robofleet.calibration.lens.gathering import Gathering, gather
from robofleet.calibration.lens.intrinsics import COEFFICIENTS, Conditions, Measured, measure
from robofleet.calibration.lens.live import Screen, capture, lens_config
from robofleet.calibration.lens.page import page
from robofleet.calibration.store import CalibrationError, load, save
from robofleet.config.calibrated import CameraModel
from robofleet.tracking.camera import Lens as Kind

_USUAL: dict[Kind, int] = {"pinhole": 5, "fisheye": 4}  # coefficients


def intrinsics(
    camera: CameraName,
    source: Annotated[
        Path | None, typer.Argument(metavar="[IMAGES]", help="Folder of images, or a video, of the board.")
    ] = None,
    live: Live = None,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    squares: Annotated[str, typer.Option(metavar="COLUMNSxROWS", help="Of the board.")] = "11x8",
    square_mm: Annotated[float, typer.Option(help="Side of a square of the board.")] = 40.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker in it.")] = 30.0,
    dictionary: Annotated[str, typer.Option(help="The markers'.")] = "DICT_5X5_250",
    lens: Annotated[Literal["pinhole", "fisheye"], typer.Option(help="OpenCV's model of the lens.")] = "pinhole",
    coefficients: Annotated[
        int | None, typer.Option(help="Number of a pinhole's distortion coefficients: 4, 5, 8, 12 or 14.")
    ] = None,
    height_m: Annotated[float, typer.Option(help="Height of the camera above the floor, for figures in mm.")] = 2.5,
    tag_height_m: Annotated[float, typer.Option(help="Height of the robots' tags above the floor.")] = 0.08,
    arena_m: Annotated[
        str,
        typer.Option(metavar="LONGxSHORT", help="Sides of the arena, as 3.5x2.3; default: all seen within 45 degrees."),
    ] = "",
    device: Annotated[
        str, typer.Option("--device", help="The device, as camera.source names it; --live finds it out.")
    ] = "",
    configs: ConfigsFolder = None,
    report: ReportFile = None,
) -> None:
    """Measure a lens from views of a ChArUco board (robofleet sheet prints it).

    $ robofleet calibrate intrinsics ceiling photos/ --squares 9x6

    $ robofleet calibrate intrinsics ceiling --live configs/lab.yaml --squares 9x6

    The camera's file is written: configs/cameras/ceiling.yaml.
    """
    file = camera_file(camera, configs, live)
    if (source is None) == (live is None):
        raise CalibrationError("name a folder or a video, or a configuration with --live")
    config = live_camera(live, overrides, lens_config)
    board = Board(count(squares, "--squares"), square_mm / 1e3, marker_mm / 1e3, dictionary)
    arena = size(arena_m, "--arena-m") if arena_m else None
    if not 0.0 <= tag_height_m < height_m < 1000.0:
        raise CalibrationError("--tag-height-m must lie between the floor and the camera's --height-m")
    ceiling, coefficient_count = Ceiling(height_m, tag_height_m, arena), _coefficients(lens, coefficients)

    def conditions(pixels: tuple[int, int]) -> Conditions:
        return Conditions(board, lens, coefficient_count, pixels, ceiling)

    shown = report_file(report, "intrinsics")
    if config is not None:
        source_camera = open_camera(config)
        gathering, identity = Gathering(board, film=True), source_camera.identity
        try:
            with Screen(Console(stderr=True)) as screen:
                capture(source_camera, gathering, conditions, screen)
        finally:
            source_camera.close()
            _keep(gathering, shown.parent / "views")
    else:
        assert source is not None
        gathering, identity = gather(source, board), ""
    gathering.refuse()
    measured = measure(gathering.views, conditions(gathering.size))
    faults = measured.faults()
    page(measured, gathering, faults).write(shown)
    if faults:
        raise CalibrationError([*faults, *measured.warnings(), f"nothing was written; report: {shown}"])
    _write(file, measured, device or identity)
    print(f"report: {shown}")


def _keep(gathering: Gathering, folder: Path) -> None:
    """Write the views of a capture, so that it can be measured again."""
    if not gathering.views:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CalibrationError(f"{folder}: {error.strerror}: the views could not be kept") from error
    for view in gathering.views:
        file = folder / f"{view.name.replace(' ', '-')}.png"
        if not cv2.imwrite(str(file), view.image):
            raise CalibrationError(f"{file}: cannot be written: the views could not be kept")
    print(f"views: {folder}")


def _write(file: Path, measured: Measured, camera: str) -> None:
    model = measured.model(camera, measured.held_out())
    earlier = _earlier(file)
    if earlier is not None and earlier.height == model.height:
        model = model.model_copy(update={"line_time_s": earlier.line_time_s})  # not the lens's: it was not measured
    kept = save(file, model)
    for warning in measured.warnings():
        print(warning)
    print(f"places are known to {measured.arena_mm:.2f} mm rms over the arena, as far as the lens goes")
    print(f"written: {file}" + (f"; the one before: {kept}" if kept else ""))
    if earlier is not None and earlier.T_world_camera is not None:
        print("the camera's place belonged to the earlier lens and was dropped: run robofleet calibrate arena again")


def _earlier(file: Path) -> CameraModel | None:
    try:
        return load(file, CameraModel)
    except CalibrationError:
        return None


def _coefficients(lens: Kind, requested: int | None) -> int:
    allowed = COEFFICIENTS[lens]
    if requested is not None and requested not in allowed:
        raise CalibrationError(f"--coefficients: a {lens} lens has {', '.join(map(str, allowed))}, not {requested}")
    return requested or _USUAL[lens]

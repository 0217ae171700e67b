"""``robofleet calibrate intrinsics``."""

from pathlib import Path
from typing import Annotated, Literal

import cv2
import typer
from rich.console import Console

from robofleet.calibration.commands import shared
from robofleet.calibration.frames import open_camera
from robofleet.calibration.lens.board import Board
from robofleet.calibration.lens.floor import Ceiling
from robofleet.calibration.lens.gathering import Gathering, gather
from robofleet.calibration.lens.imaging import measure_imaging
from robofleet.calibration.lens.intrinsics import COEFFICIENTS, Conditions, Measured, measure
from robofleet.calibration.lens.live import capture, lens_config, screen
from robofleet.calibration.lens.page import page
from robofleet.calibration.store import CalibrationError, load, save
from robofleet.config.calibrated import CameraModel, ImagingSettings
from robofleet.tracking.camera import Lens as Kind

_USUAL: dict[Kind, int] = {"pinhole": 5, "fisheye": 4}  # coefficients


def intrinsics(
    camera: shared.CameraName,
    source: Annotated[
        Path | None, typer.Argument(metavar="IMAGES", help="Images of the board: a folder, or a video.")
    ] = None,
    live: shared.Live = None,
    overrides: shared.Overrides = [],  # noqa: B006 - typer copies it
    squares: Annotated[str, typer.Option(metavar="COLUMNSxROWS", help="Squares of the board.")] = "11x8",
    square_mm: Annotated[float, typer.Option(metavar="MM", help="Side of a square of the board, in mm.")] = 40.0,
    marker_mm: Annotated[float, typer.Option(metavar="MM", help="Side of a marker in a square, in mm.")] = 30.0,
    dictionary: Annotated[
        str, typer.Option(metavar="NAME", help="OpenCV's dictionary of the markers.")
    ] = "DICT_5X5_250",
    lens: Annotated[
        Literal["pinhole", "fisheye"], typer.Option(metavar="pinhole|fisheye", help="OpenCV's model of the lens.")
    ] = "pinhole",
    coefficients: Annotated[
        int | None,
        typer.Option(metavar="N", help="Number of a pinhole's distortion coefficients: 4, 5, 8, 12 or 14. Default: 5."),
    ] = None,
    height_m: Annotated[float, typer.Option(metavar="M", help="Height of the camera above the floor, in m.")] = 2.5,
    tag_height_m: Annotated[
        float, typer.Option(metavar="M", help="Height of the robots' tags above the floor, in m.")
    ] = 0.08,
    arena_m: Annotated[
        str,
        typer.Option(
            metavar="LONGxSHORT",
            help="Sides of the arena in m, for example 3.5x2.3. Default: all that is seen within 45 degrees.",
        ),
    ] = "",
    device: Annotated[
        str, typer.Option("--device", metavar="NAME", help="The device, as in camera.source; not needed with --live.")
    ] = "",
    configs: shared.ConfigsFolder = None,
    report: shared.ReportFile = None,
) -> None:
    """Measure a camera's lens from images of a board.

    `robofleet sheet board` draws the board.

    $ robofleet calibrate intrinsics ceiling photos/ --squares 9x6

    $ robofleet calibrate intrinsics ceiling --live configs/lab.yaml --squares 9x6

    The result is the camera's file, here configs/cameras/ceiling.yaml.
    """
    file = shared.camera_file(camera, configs, live)
    if (source is None) == (live is None):
        raise CalibrationError("name a folder or a video, or a configuration with --live")
    config = shared.live(live, overrides, lens_config)
    board = Board(shared.count(squares, "--squares"), square_mm / 1e3, marker_mm / 1e3, dictionary)
    arena = shared.size(arena_m, "--arena-m") if arena_m else None
    if not 0.0 <= tag_height_m < height_m < 1000.0:
        raise CalibrationError("--tag-height-m must lie between the floor and the camera's --height-m")
    ceiling, coefficient_count = Ceiling(height_m, tag_height_m, arena), _coefficients(lens, coefficients)

    def conditions(pixels: tuple[int, int]) -> Conditions:
        return Conditions(board, lens, coefficient_count, pixels, ceiling)

    shown = shared.report_file(report, "intrinsics")
    if config is not None:
        source_camera = open_camera(config)
        gathering, identity = Gathering(board, film=True), source_camera.identity
        try:
            with screen(Console(stderr=True)) as show:
                capture(source_camera, gathering, conditions, show)
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
    imaging = measure_imaging(measured.fit.lens, measured.fit.views, measured.fit.poses, measured.conditions.board)
    model = model.model_copy(update={"imaging": imaging})
    kept = save(file, model)
    for warning in measured.warnings():
        print(warning)
    print(f"places are known to {measured.arena_mm:.2f} mm rms over the arena, as far as the lens goes")
    print(_shown(imaging))
    print(f"written: {file}" + (f"; the one before: {kept}" if kept else ""))
    if earlier is not None and earlier.T_world_camera is not None:
        print("the camera's place belonged to the earlier lens and was dropped: run robofleet calibrate arena again")


def _shown(imaging: ImagingSettings | None) -> str:
    """Return in words how the camera shows edges."""
    if imaging is None:
        return "blur, tone curve and noise were not measured: bring the board nearer, so that its squares are larger"
    noise = "" if imaging.read_noise_gray is None else f", noise {imaging.read_noise_gray:.1f} grey levels in the dark"
    return (
        f"blur {imaging.blur_px:.2f} px in the middle, {imaging.blur_edge_px:.2f} px in the corners; "
        f"tone curve {imaging.tone:+.2f} (0: linear){noise}"
    )


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

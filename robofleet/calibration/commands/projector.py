"""``robofleet calibrate projector``: where a projector's light falls."""

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration.commands import shared
from robofleet.calibration.frames import live_config, open_camera
from robofleet.calibration.projector import measured
from robofleet.calibration.projector.page import write_page
from robofleet.calibration.projector.photographs import Photographer, SimulatedDisplay
from robofleet.calibration.store import CalibrationError, save
from robofleet.config.faults import did_you_mean
from robofleet.config.projectors import ProjectorModel, ProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, WallClock
from robofleet.projection.browser import BrowserDisplay
from robofleet.projection.disc import brightest_gray
from robofleet.projection.display import Display, DisplayError
from robofleet.projection.model import Projector
from robofleet.projection.patterns import Grid, read
from robofleet.tracking.sources import Camera

_WAIT_S = 60.0  # for a browser


def projector(
    config_file: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="Configuration with `projectors`, and cameras that are calibrated.")
    ],
    name: Annotated[
        str, typer.Option("--projector", metavar="NAME", help="Which projector. Default: each, one after the other.")
    ] = "",
    overrides: shared.Overrides = [],  # noqa: B006 - typer copies it
    kiosk: Annotated[
        bool, typer.Option("--kiosk", help="Open Chromium here, full-screen, where the projector is this computer's.")
    ] = False,
    wait_s: Annotated[
        float, typer.Option(metavar="S", min=0.0, max=3600.0, help="How long to wait for a browser.")
    ] = _WAIT_S,
    least_percent: Annotated[
        float, typer.Option(metavar="PERCENT", min=1.0, max=100.0, help="Smallest part of the arena that must be lit.")
    ] = 95.0,
    verify: Annotated[
        bool, typer.Option("--verify", help="Compare with the calibration that is there; write no calibration.")
    ] = False,
    report: shared.ReportFile = None,
) -> None:
    """Measure where a projector's light falls.

    It shows a pattern of tags, which the cameras photograph. Each camera must be calibrated to the floor.

    $ robofleet calibrate projector lab/platoon.yaml --kiosk

    $ robofleet calibrate projector lab/platoon.yaml --projector left --verify

    The result is written into projectors/NAME.yaml beside the configuration; the file before is kept.
    """
    config = live_config(config_file, overrides)
    chosen = _chosen(config, config_file, name, verify=verify)
    page = shared.report_file(report, "projector")
    known = {each.name: each.calibration for each in config.projectors}
    with ExitStack() as opened:
        cameras: dict[str, Camera] = {}
        for _, camera in config.camera_keys:
            view = config.model_copy(update={"camera": camera})
            cameras[camera.name] = opened.enter_context(closing(open_camera(view)))
        for each in chosen:
            found = _measured(config, each, cameras, known, least_percent / 100.0, kiosk=kiosk, wait_s=wait_s)
            for note in (*found.notes, *_brightness(config, each, found)):
                print(note)
            if verify:
                assert each.calibration is not None
                print(measured.verify(each.name, each.calibration, found))
                continue
            known[each.name] = found.model
            _write(config_file, each, found, page.with_stem(f"{page.stem}-{each.name}") if chosen[1:] else page)


def _brightness(config: Config, projector: ProjectorSettings, found: measured.Found) -> Iterator[str]:
    """Yield that the discs around the robots are too bright for a camera that keeps its exposure."""
    most = brightest_gray(found.figures["white_over_room"] or 0.0)
    fixed = [camera.name for _, camera in config.camera_keys if not camera.adjusts_exposure]
    if fixed and projector.disc_gray > most:
        yield (
            f"projector {projector.name}: tags in discs of disc_gray {projector.disc_gray:g} may be too bright for "
            f"{', '.join(fixed)}: lower it to {math.floor(100 * most) / 100:.2f}, shorten camera.exposure_s, or take "
            "camera.exposure_control: auto"
        )


def _write(config_file: Path, projector: ProjectorSettings, found: measured.Found, page: Path) -> None:
    write_page(page, projector.name, found)
    file = config_file.parent / "projectors" / f"{projector.name}.yaml"
    kept = save(file, found.model)
    rms, most = found.figures["predicted_rms_mm"], found.figures["predicted_max_mm"]
    print(f"expected error on the floor: {rms:.2f} mm rms, {most:.2f} mm at most")
    print(f"{file}: written" + (f"; the one before it is {kept}" if kept else ""))
    if projector.calibration is None:
        print(f"write `calibration: {projector.name}` to the projector {projector.name} in {config_file}")
    print(f"report: {page}")


def _chosen(config: Config, file: Path, name: str, *, verify: bool) -> list[ProjectorSettings]:
    by_name = {each.name: each for each in config.projectors}
    if not by_name:
        raise CalibrationError(f"{file}: it has no projector: write `projectors: [{{name: main, width: 1920, ...}}]`")
    if name and name not in by_name:
        raise CalibrationError(f"--projector: there is no projector '{name}': {did_you_mean(name, by_name)}")
    chosen = [by_name[name]] if name else list(config.projectors)
    faults = [
        f"{path}.model: where the camera hangs is not known: run robofleet calibrate arena"
        for path, camera in config.camera_keys
        if camera.model.T_world_camera is None
    ]
    faults += [
        f"projector {each.name}: it is not calibrated: run robofleet calibrate projector {file} without --verify"
        for each in chosen
        if verify and each.calibration is None
    ]
    if faults:
        raise CalibrationError(faults)
    return chosen


def _measured(
    config: Config,
    chosen: ProjectorSettings,
    cameras: Mapping[str, Camera],
    known: dict[str, ProjectorModel | None],
    least_covered: float,
    *,
    kiosk: bool,
    wait_s: float,
) -> measured.Found:
    clock, grid = WallClock(), Grid((chosen.width, chosen.height))
    models = {camera.name: camera.model for _, camera in config.camera_keys}
    try:
        with closing(_display(chosen, cameras, clock, wait_s=wait_s)) as display:
            if isinstance(display, BrowserDisplay):
                _open(display, chosen.name, kiosk=kiosk)
            photographer, pictures = Photographer(display, cameras, clock), grid.pictures()
            taken = {shown: photographer.take(picture) for shown, picture in pictures.items()}
            seen = {camera: {shown: means[camera] for shown, means in taken.items()} for camera in cameras}
            readings = {camera: read(grid, images) for camera, images in seen.items()}
            brightest = max(readings, key=lambda camera: readings[camera].lit)
            delay_s = photographer.delay_s(brightest, pictures, seen[brightest]) if readings[brightest].lit else 0.0
            display.show(pictures["black"])
    except DisplayError as away:
        raise CalibrationError(str(away)) from away
    inputs = {f"{camera}: {shown}": mean.tobytes() for shown, means in taken.items() for camera, mean in means.items()}
    others = [
        None if model is None else Projector.from_model(model) for other, model in known.items() if other != chosen.name
    ]
    return measured.measure(
        chosen.name, grid, models, readings, delay_s, config.arena.size_m, others, least_covered, inputs
    )


def _display(chosen: ProjectorSettings, cameras: Mapping[str, Camera], clock: Clock, *, wait_s: float) -> Display:
    if chosen.simulated is not None:
        return SimulatedDisplay(chosen.name, cameras, clock)
    return BrowserDisplay(chosen, clock, wait_s=wait_s)


def _open(display: BrowserDisplay, name: str, *, kiosk: bool) -> None:
    if kiosk:
        display.kiosk()
    else:
        print(f"open {display.address} full-screen on the computer of the projector {name}", flush=True)

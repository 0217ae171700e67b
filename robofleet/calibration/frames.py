"""Images to measure in: of a file, a folder, a video, or what a live camera sees now."""

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import CameraModel
from robofleet.config.faults import did_you_mean
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.arrays import Image
from robofleet.core.clock import WallClock
from robofleet.core.plugins import PluginError, load
from robofleet.tracking.cameras import recorded
from robofleet.tracking.sources import Camera, CameraContext, CameraError

Named = tuple[str, Image]  # what to call an image, and its greys (H, W)
MIRRORED = (
    "the images are mirrored: their markers are read only when left and right are exchanged; "
    "switch mirroring (a horizontal flip) off at the camera, or print the sheet again if it is the print"
)


def images(path: Path) -> Iterator[Named]:
    try:
        yield from recorded.images(path)
    except CameraError as error:
        raise CalibrationError(str(error)) from error


def taken(paths: Sequence[Path], config: Config | None, most: int) -> list[Named]:
    """Return images of files, or of a configuration's camera; none if neither is given."""
    if config is None:
        return list(islice(chain.from_iterable(map(images, paths)), most))
    if paths:
        raise CalibrationError("images and --live: give one of them")
    return from_camera(config, most)


def live_config(file: Path, overrides: Sequence[str] = ()) -> Config:
    """Read a configuration for its camera alone.

    Its place need not be known yet, and no controller is there to trigger it.
    """
    config = load_config(file, [*overrides, "tracker.source=truth"])
    free = [camera.model_copy(update={"trigger": "free"}) for _, camera in config.camera_keys]
    return config.model_copy(update={"camera": free[0], "cameras": tuple(free) if config.cameras else ()})


def camera_of(config: Config, name: str) -> Config:
    """Return a live configuration as one of its cameras has it; a single one may have any name."""
    named = {camera.name: camera for _, camera in config.camera_keys}
    if not config.cameras:
        return config
    if name not in named:
        raise CalibrationError(f"--live: there is no camera '{name}' in its `cameras`: {did_you_mean(name, named)}")
    return config.model_copy(update={"camera": named[name]})


def from_camera(config: Config, count: int) -> list[Named]:
    """Return the next images of a configuration's camera. Of a simulated one only the floor: no robot runs."""
    if config.camera.rendered and config.camera.model.T_world_camera is None:
        raise CalibrationError("camera.model: a simulated camera must hang somewhere: give it a T_world_camera")
    camera = open_camera(config)
    calibrated = config.camera.model.camera
    if calibrated and camera.identity != calibrated:
        camera.close()
        raise CalibrationError(
            f"this camera is {camera.identity!r}, the lens is that of {calibrated!r}: calibrate this one's lens"
        )
    try:
        return [(f"live image {i + 1}", camera.read().image.copy()) for i in range(count)]
    except EOFError:
        why = f"{config.camera.source}: the camera ended before {count} images: name a longer recording"
        raise CalibrationError(why) from None
    except (CameraError, OSError) as error:
        raise CalibrationError(f"{config.camera.source}: {error}") from error
    finally:
        camera.close()


def refuse_other_sizes(images: Sequence[Named], model: CameraModel) -> None:
    faults = [
        f"{name}: is {image.shape[1]} x {image.shape[0]} px, but the camera is calibrated for "
        f"{model.width} x {model.height}: take images of that size, or calibrate the lens for this one"
        for name, image in images
        if image.shape != (model.height, model.width)
    ]
    if faults:
        raise CalibrationError(faults)


def open_camera(config: Config) -> Camera:
    context = CameraContext.without_run(config, WallClock())
    try:
        camera: Camera = load("robofleet.cameras", config.camera.source)(context)
    except (PluginError, CameraError) as error:
        raise CalibrationError(f"camera.source: {error}") from error
    return camera

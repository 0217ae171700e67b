"""Cameras that cannot be: of sizes that nobody calibrated, that look up, to which tags are too small or too large."""

import math
import os
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from robofleet.config import units
from robofleet.config.calibrated import CameraModel, FloorTag
from robofleet.config.camera import CameraSettings
from robofleet.config.tree import Config
from robofleet.core.settings import FAMILIES

Complaint = tuple[str, str]  # dotted path, what is wrong and how to mend it

_COEFFICIENTS = {"pinhole": (0, 4, 5, 8, 12, 14), "fisheye": (4,)}

LEAST_CELL_PX = 1.5  # of a tag straight below the camera: fewer do not tell black from white


def complaints(config: Config) -> Iterator[Complaint]:
    """Yield what is wrong with each camera, and between them."""
    yield from _alike(config)
    for path, camera in config.camera_keys:
        yield from _light(path, camera)
        yield from _model(config, path, camera)
        model = camera.model
        sizes = ("width", camera.width, model.width), ("height", camera.height, model.height)
        for key, taken, calibrated in sizes:
            if taken != calibrated:
                message = f"{taken} px, but its model is calibrated for {calibrated}: mend one, or calibrate again"
                yield f"{path}.{key}", message
    for path, lying in _lying(config):
        yield from unknown_id(config, f"{path}.tag", lying.tag)
    yield from _small(config)
    for path, camera in config.camera_keys:
        yield from _tag_sizes(config, path, camera)


def _alike(config: Config) -> Iterator[Complaint]:
    """Cameras of one name, or of one device: the second would get no image, or the first one's."""
    names: dict[str, str] = {}
    devices: dict[tuple[str, str], str] = {}
    of_source = Counter(camera.source for _, camera in config.camera_keys)
    for path, camera in config.camera_keys:
        if (first := names.setdefault(camera.name, path)) != path:
            yield f"{path}.name", f"{camera.name} is {first}'s already: give each camera its own name"
        key, device = _device(camera)
        if key and not device and of_source[camera.source] > 1:
            yield f"{path}.{key}", "is missing: of several cameras of this source each names its own"
        elif key and (first := devices.setdefault((camera.source, os.path.realpath(device)), path)) != path:
            yield f"{path}.{key}", f"{device} is {first}'s already: name another device"


def _device(camera: CameraSettings) -> tuple[str, str]:
    """Return where a camera's device is named, and its name; nothing of a source that is not known here."""
    if camera.source == "v4l2":
        return "v4l2.device", camera.v4l2.device
    if camera.source == "basler":
        return "basler.serial", camera.basler.serial or ""
    if camera.source == "files" and camera.files is not None:
        return "files.path", camera.files.path
    return "", ""


def _model(config: Config, path: str, camera: CameraSettings) -> Iterator[Complaint]:
    model = camera.model
    fault = lens_fault(model)
    if fault:
        yield f"{path}.model.distortion", fault
    rolling, period = model.line_time_s * (model.height - 1), 1.0 / camera.rate_hz
    if rolling > period:
        message = f"all rows take {rolling:.3g} s, more than an image's {period:.3g} s: mend one"
        yield f"{path}.model.line_time_s", message
    if model.T_world_camera is None:
        if config.tracker.source == "camera":
            yield f"{path}.model", "where the camera hangs is not known: run robofleet calibrate arena"
        return
    x, y, z = model.T_world_camera.rotation_rad
    angle = math.hypot(x, y, z)
    share = (x * x + y * y) / (angle * angle) if angle else 0.0
    if 1.0 - share * (1.0 - math.cos(angle)) >= 0.0:  # the height of its z axis's tip
        yield f"{path}.model", "looks up from the floor: mend T_world_camera.rotation_rad"


def _light(path: str, camera: CameraSettings) -> Iterator[Complaint]:
    gain = camera.exposure.gain
    if gain is not None and gain[0] > gain[1]:
        yield f"{path}.exposure.gain", f"the least gain, {gain[0]:g}, is above the greatest, {gain[1]:g}: exchange them"
    for i, (before, after) in enumerate(pairwise(camera.simulated.daylight), 1):
        if after.at_s <= before.at_s:
            where = f"{path}.simulated.daylight.{i}.at_s"
            yield where, f"{after.at_s:g} s does not come after {before.at_s:g} s: put them in order"


def _lying(config: Config) -> Iterator[tuple[str, FloorTag]]:
    """Yield every tag that lies somewhere, with its path."""
    yield from ((f"tracker.floor_tags.{i}", tag) for i, tag in enumerate(config.tracker.floor_tags))
    for path, camera in config.camera_keys:
        yield from ((f"{path}.simulated.posters.{i}", tag) for i, tag in enumerate(camera.simulated.posters))


def _tag_sizes(config: Config, own: str, camera: CameraSettings) -> Iterator[Complaint]:
    """Tags that are above the camera, or fill its image: the patterns to compare with would fill the memory."""
    tracker, model = config.tracker, camera.model
    if model.T_world_camera is None:
        return
    eye_m, least_px = model.T_world_camera.position_m[2], min(model.width, model.height)
    family = FAMILIES[tracker.family]
    largest_m = least_px * (eye_m - tracker.tag_height_m) / max(model.focal_px) / family.whole
    if hint := units.meant(tracker.tag_side_m, largest_m, "tag_side_m"):
        yield "tracker.tag_side_m", f"a tag of {tracker.tag_side_m:g} m fills the image{hint}: mend it"
        return
    for path, side_m, height_m in _tags(config, own):
        if max(model.focal_px) * side_m * family.whole >= least_px * (eye_m - height_m):
            tag = f"a tag of {side_m:g} m at {height_m:g} m"
            yield path, f"{tag} fills the image of a camera that hangs at {eye_m:g} m: mend one"


def _tags(config: Config, own: str) -> Iterator[tuple[str, float, float]]:
    """Yield the tags that a camera sees: path, side and height [m] of each."""
    tracker = config.tracker
    yield "tracker.tag_height_m", tracker.tag_side_m, tracker.tag_height_m
    for i, robot in enumerate(config.robots):
        if robot.tag_height_m is not None:
            yield f"robots.{i}.tag_height_m", tracker.tag_side_m, robot.tag_height_m
    at = ("tracker.", own)
    yield from ((path, tag.side_m, tag.height_m) for path, tag in _lying(config) if path.startswith(at))


def _small(config: Config) -> Iterator[Complaint]:
    """Yield tags whose cells have too few pixels, each once: of the camera to which it looks smallest."""
    tracker, square = config.tracker, FAMILIES[config.tracker.family].square
    worst: dict[str, tuple[float, float, str]] = {}
    for own, camera in config.camera_keys if tracker.source == "camera" else ():
        if camera.model.T_world_camera is None:
            continue
        for path, side_m, height_m in _tags(config, own):
            below_m = camera.model.T_world_camera.position_m[2] - height_m
            cell_px = min(camera.model.focal_px) * side_m / square / max(below_m, 1e-9)
            worst[path] = min(worst.get(path, (math.inf, 0.0, "")), (cell_px, side_m, camera.name))
    for path, (cell_px, side_m, name) in worst.items():
        if 0.0 < cell_px < LEAST_CELL_PX:
            least_mm = math.ceil(1e3 * side_m * LEAST_CELL_PX / cell_px)
            whose = f" in the image of {name}" if config.cameras else ""
            yield (
                path.replace("tracker.tag_height_m", "tracker.tag_side_m"),
                f"a cell of a {tracker.family} tag of {side_m:g} m has {math.floor(100 * cell_px) / 100:g} px"
                f"{whose}, {LEAST_CELL_PX:g} are needed: print it {least_mm / 1e3:g} m large, hang the camera "
                "lower, or take a family with fewer cells",
            )


def unknown_id(config: Config, path: str, tag: int) -> Iterator[Complaint]:
    """Yield that the family has no such tag, where it has none."""
    family = config.tracker.family
    if tag > (last := FAMILIES[family].ids - 1):
        yield path, f"{tag}: the family {family} has the ids 0 to {last}: give it one of these"


def lens_fault(model: CameraModel) -> str | None:
    """Return what is wrong with a lens's coefficients, if anything."""
    allowed = _COEFFICIENTS[model.lens]
    if len(model.distortion) in allowed:
        return None
    counts = ", ".join(map(str, allowed[:-1])) + f" or {allowed[-1]}" if len(allowed) > 1 else str(allowed[0])
    return f"a {model.lens} lens has {counts} coefficients, not {len(model.distortion)}: calibrate again"

"""What lies between scene and tracker beside lens and noise: each effect changes an image in place, in this order."""

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.camera import Cable, Glare, SimulatedCameraSettings

Image = NDArray[np.uint8]
Effect = Callable[[Image, float], None]  # image (H, W), time since the first one [s]

_SHIFT = 4  # fractional bits of the drawing functions
_PATCH_PX = 90  # of the projector's pattern
_PATTERN_SPEED_PX = 120.0  # at which it moves [px/s]


def effects(settings: SimulatedCameraSettings, size: tuple[int, int], rng: np.random.Generator) -> list[Effect]:
    """Return the effects that are configured, for images of (width, height)."""
    chosen: list[Effect] = []
    if settings.projector_gray:
        chosen.append(_projector(settings.projector_gray, size, rng))
    chosen += [_glare(glare, size) for glare in settings.glare]
    chosen += [_cable(cable) for cable in settings.cables]
    if settings.jpeg_quality is not None:
        chosen.append(_jpeg(settings.jpeg_quality))
    return chosen


def _projector(gray: int, size: tuple[int, int], rng: np.random.Generator) -> Effect:
    """Bright patches that move over everything."""
    width, height = size
    coarse = (rng.random((height // _PATCH_PX + 2, 2 * width // _PATCH_PX + 2)) < 0.5).astype(np.uint8) * gray
    pattern = cv2.resize(coarse, (2 * width, height), interpolation=cv2.INTER_NEAREST)

    def add(image: Image, t: float) -> None:
        start = int(abs(math.remainder(t * _PATTERN_SPEED_PX, 2.0 * width)))
        cv2.add(image, np.ascontiguousarray(pattern[:, start : start + width]), dst=image)

    return add


def _glare(glare: Glare, size: tuple[int, int]) -> Effect:
    v, u = np.mgrid[: size[1], : size[0]]
    squared = (u - glare.at_px[0]) ** 2 + (v - glare.at_px[1]) ** 2
    light = np.minimum(glare.gray * np.exp(-squared / (2.0 * glare.radius_px**2)), 255.0).astype(np.uint8)

    def add(image: Image, _t: float) -> None:
        cv2.add(image, light, dst=image)

    return add


def _cable(cable: Cable) -> Effect:
    points = np.rint(np.array(cable.points_px) * (1 << _SHIFT)).astype(np.int32)

    def draw(image: Image, t: float) -> None:
        if t < cable.at_s:
            return
        cv2.polylines(image, [points], False, cable.gray, cable.width_px, cv2.LINE_AA, _SHIFT)

    return draw


def _jpeg(quality: int) -> Effect:
    def compress(image: Image, _t: float) -> None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image[:] = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    return compress

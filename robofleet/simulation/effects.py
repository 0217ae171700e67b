"""Effects on a rendered image beside lens and noise: each changes the image in place, in this order."""

import math
from collections.abc import Callable

import cv2
import numpy as np

from robofleet.config.camera import Cable, Glare, SimulatedCameraSettings
from robofleet.core.arrays import Image

Effect = Callable[[Image, float], None]  # image (H, W), time since the run began [s]

_PATCH_PX = 90  # of the projector's pattern
_PATTERN_SPEED_PX = 120.0  # at which it moves [px/s]


def effects(settings: SimulatedCameraSettings, size: tuple[int, int], rng: np.random.Generator) -> list[Effect]:
    chosen: list[Effect] = []
    if settings.projector_gray:
        chosen.append(_projector(settings.projector_gray, size, rng))
    chosen += [_glare(glare, size) for glare in settings.glare]
    chosen += [_cable(cable, size) for cable in settings.cables]
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


def _cable(cable: Cable, size: tuple[int, int]) -> Effect:
    """OpenCV draws anti-aliased lines about 1.5 pixels too wide."""
    v, u = np.mgrid[: size[1], : size[0]]
    points = np.array(cable.points_px)
    distance = np.full(size[::-1], np.inf)
    for (u_a, v_a), (u_ab, v_ab) in zip(points[:-1], np.diff(points, axis=0), strict=True):
        along = ((u - u_a) * u_ab + (v - v_a) * v_ab) / max(u_ab * u_ab + v_ab * v_ab, 1e-9)
        along = np.clip(along, 0.0, 1.0)
        distance = np.minimum(distance, np.hypot(u - u_a - along * u_ab, v - v_a - along * v_ab))
    hidden = np.clip(cable.width_px / 2.0 + 0.5 - distance, 0.0, 1.0)
    at = np.nonzero(hidden)
    cover = hidden[at]

    def draw(image: Image, t: float) -> None:
        if t >= cable.at_s:
            image[at] = np.rint(image[at] * (1.0 - cover) + cable.gray * cover).astype(np.uint8)

    return draw


def _jpeg(quality: int) -> Effect:
    def compress(image: Image, _t: float) -> None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image[:] = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    return compress

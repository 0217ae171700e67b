"""Effects on light, and on a rendered image beside lens and noise: each changes the image in place, in this order."""

import math
from collections.abc import Callable

import cv2
import numpy as np

from robofleet.config.camera import Cable, Glare, SimulatedCameraSettings
from robofleet.core.arrays import Array, Array32, Image

Effect = Callable[[Image, float], None]  # image (H, W), time since the run began [s]

_DENOISED_PX, _SHARPENED_PX = 1.5, 1.0  # standard deviations of the Gaussians of denoising and of sharpening
_PATCH_PX = 90  # of the projector's pattern
_SIGMAS = np.linspace(-6.0, 6.0, 601)
_BELOW = np.array([0.5 * math.erfc(-at / math.sqrt(2.0)) for at in _SIGMAS.tolist()])  # of a normal distribution
_PATTERN_SPEED_PX = 120.0  # at which it moves [px/s]


def effects(settings: SimulatedCameraSettings, size: tuple[int, int], rng: np.random.Generator) -> list[Effect]:
    chosen: list[Effect] = []
    if settings.projector_gray:
        chosen.append(_projector(settings.projector_gray, size, rng))
    chosen += [_glare(glare, size) for glare in settings.glare]
    chosen += [_cable(cable, size) for cable in settings.cables]
    if settings.bayer:
        chosen.append(_demosaiced)
    if settings.denoising_gray:
        chosen.append(_denoised(settings.denoising_gray))
    if settings.temporal_denoising:
        chosen.append(_averaged(settings.temporal_denoising))
    if settings.tone_curve != "linear":
        chosen.append(_toned(settings.tone_curve))
    if settings.sharpening:
        chosen.append(_sharpened(settings.sharpening))
    if settings.jpeg_quality is not None:
        chosen.append(_jpeg(settings.jpeg_quality))
    return chosen


def shade(settings: SimulatedCameraSettings, size: tuple[int, int]) -> Array32:
    """Return the share of the light (H, W) that vignetting and shadows leave."""
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float32)
    middle = (np.array(size) - 1.0) / 2.0
    gain: Array = 1.0 - settings.vignetting * ((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (middle @ middle)
    for shadow in settings.shadows:
        angle = math.radians(shadow.angle_deg)
        inside = (u - shadow.at_px[0]) * math.cos(angle) + (v - shadow.at_px[1]) * math.sin(angle)
        gain *= 1.0 - (1.0 - shadow.light) * np.interp(inside / shadow.softness_px, _SIGMAS, _BELOW)
    return np.asarray(gain, np.float32)


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


def _demosaiced(image: Image, _t: float) -> None:
    """Greys of a mosaic, each colour's holes filled bilinearly: the scene has no colour, so only sharpness is lost."""
    image[:] = cv2.cvtColor(image, cv2.COLOR_BayerRGGB2GRAY)


def _denoised(gray: float) -> Effect:
    def smooth(image: Image, _t: float) -> None:
        image[:] = cv2.bilateralFilter(image, 5, gray, _DENOISED_PX)

    return smooth


def _averaged(share: float) -> Effect:
    """What was shown before stays by a share."""
    shown: list[Image] = []

    def mix(image: Image, _t: float) -> None:
        if shown:
            cv2.addWeighted(image, 1.0 - share, shown.pop(), share, 0.0, dst=image)
        shown.append(image.copy())

    return mix


def _toned(curve: str) -> Effect:
    light = np.arange(256) / 255.0
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)  # IEC 61966-2-1
    table = np.rint(255.0 * (srgb if curve == "srgb" else light ** (1.0 / 2.2))).astype(np.uint8)

    def curved(image: Image, _t: float) -> None:
        cv2.LUT(image, table, dst=image)

    return curved


def _sharpened(strength: float) -> Effect:
    def sharpen(image: Image, _t: float) -> None:
        blurred = cv2.GaussianBlur(image, (0, 0), _SHARPENED_PX)
        cv2.addWeighted(image, 1.0 + strength, blurred, -strength, 0.0, dst=image)

    return sharpen


def _jpeg(quality: int) -> Effect:
    def compress(image: Image, _t: float) -> None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image[:] = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))

    return compress

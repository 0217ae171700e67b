"""What a camera makes of the light that its lens lets through, each from its definition: veil to JPEG.

Nothing here is shared with the tracker or the simulated camera. Light is in grey levels that are linear in it; at 255
the sensor clips. The order is a camera's: vignetting and veil, which are the lens's; noise at each photosite,
which under a Bayer mosaic sees one colour; demosaicing; spatial and temporal denoising; tone curve; sharpening; 8 bits;
JPEG. All surfaces are grey and the white balance is right, so colour comes from noise and from demosaicing alone.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

_GREY = (0.114, 0.587, 0.299)  # blue, green, red: BT.601's luma, which JPEG stores
_BAYER_SCALE = 64.0  # steps of the raw image, a grey level
_BAYER_ROOM = 200.0  # beside black, that noise is not cut off there [grey levels]


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Settings of one camera; the defaults change nothing."""

    shot_noise: float = 0.0  # standard deviation at grey 128, of the light's quanta [grey levels]
    read_noise: float = 0.0  # standard deviation at any grey [grey levels]
    vignetting: float = 0.0  # share of the light that the farthest corner lacks
    veil: float = 0.0  # peak of the glare: Gaussian bumps on a square lattice [grey levels]
    veil_sigma_px: float = 40.0
    veil_pitch_px: float = 170.0
    bayer: bool = False  # RGGB, demosaiced bilinearly
    bilateral: float = 0.0  # greys so far apart count little for each other in 5 x 5 pixels [grey levels]
    memory: float = 0.0  # share of the image before in what is shown
    tone: Literal["linear", "gamma", "srgb"] = "linear"  # gamma: of 2.2
    sharpening: float = 0.0  # of the difference to the image blurred by a Gaussian of 1 px, times added
    jpeg: int = 0  # quality; 0: not compressed


class Camera:
    """Makes images of light (H, W), one after the other."""

    def __init__(self, sensor: Sensor, size: tuple[int, int], rng: np.random.Generator) -> None:
        """Take the image's (width, height)."""
        self.sensor, self._rng = sensor, rng
        u, v = np.arange(size[0]), np.arange(size[1])
        self._gain = _vignette(u, v, sensor.vignetting)
        self._veil = np.float32(sensor.veil) * np.outer(_bumps(v, sensor), _bumps(u, sensor)).astype(np.float32)
        self._shown: Floats | None = None

    def image(self, light: Floats) -> NDArray[np.uint8]:
        """Return the next image (H, W)."""
        sensor = self.sensor
        grey = light * self._gain + self._veil
        if sensor.shot_noise or sensor.read_noise:
            variance = np.maximum(grey, 0.0) * np.float32(sensor.shot_noise**2 / 128.0)
            sigma = np.sqrt(variance + np.float32(sensor.read_noise**2))
            grey += sigma * self._rng.standard_normal(grey.shape, dtype=np.float32)
        grey = np.minimum(grey, 255.0)
        if sensor.bayer:
            grey = demosaiced(grey)
        if sensor.bilateral:
            grey = cv2.bilateralFilter(grey, 5, sensor.bilateral, 1.5)
        if sensor.memory and self._shown is not None:
            grey = grey + np.float32(sensor.memory) * (self._shown - grey)
        self._shown = grey
        grey = toned(grey, sensor.tone)
        if sensor.sharpening:
            grey = grey + np.float32(sensor.sharpening) * (grey - cv2.GaussianBlur(grey, (0, 0), 1.0))
        image = np.rint(grey.clip(0.0, 255.0)).astype(np.uint8)
        return compressed(image, sensor.jpeg) if sensor.jpeg else image


def toned(grey: Floats, tone: str) -> Floats:
    """Return levels of 0 to 255 as a tone curve shows them."""
    share = grey.clip(0.0, 255.0) / np.float32(255.0)
    if tone == "gamma":
        return np.float32(255.0) * share ** np.float32(1.0 / 2.2)
    if tone == "srgb":  # IEC 61966-2-1
        power = np.float32(1.055) * share ** np.float32(1.0 / 2.4) - np.float32(0.055)
        return np.float32(255.0) * np.where(share <= 0.0031308, np.float32(12.92) * share, power)
    return grey


def demosaiced(raw: Floats) -> Floats:
    """Return the luma of a mosaic, RGGB from the top left, each colour's holes filled bilinearly."""
    sixteen = np.rint((raw + _BAYER_ROOM) * _BAYER_SCALE).clip(0, 65535).astype(np.uint16)
    colours = cv2.cvtColor(sixteen, cv2.COLOR_BayerRGGB2BGR).astype(np.float32)
    return (colours @ np.array(_GREY, np.float32)) / np.float32(_BAYER_SCALE) - np.float32(_BAYER_ROOM)


def compressed(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    """Return a grey image after JPEG, 4:2:0 as webcams send it: the luma of that is what is left of grey."""
    settings = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    done, coded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), settings)
    assert done
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.uint8)


def _vignette(u: NDArray[np.int64], v: NDArray[np.int64], corner: float) -> Floats:
    """Return the gain (V, U): less by the square of the distance from the middle."""
    x, y = (2.0 * at / (len(at) - 1) - 1.0 for at in (u, v))
    aspect = len(v) / len(u)
    return (1.0 - corner * (x**2 + (aspect * y[:, None]) ** 2) / (1.0 + aspect**2)).astype(np.float32)


def _bumps(at: NDArray[np.int64], sensor: Sensor) -> NDArray[np.float64]:
    """Return Gaussian bumps of height 1 along a row, in the middle of each pitch."""
    way = np.mod(at, sensor.veil_pitch_px) - 0.5 * sensor.veil_pitch_px
    return np.exp(-0.5 * (way / sensor.veil_sigma_px) ** 2)

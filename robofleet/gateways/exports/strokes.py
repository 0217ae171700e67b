"""What films and pictures are drawn with: lines, words, colours."""

from functools import cache, lru_cache
from itertools import pairwise

import cv2
import numpy as np
from matplotlib import font_manager
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont

from robofleet.core.arrays import Array

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

WHITE: Colour = (255, 255, 255)
SHIFT = 4  # sub-pixel bits of OpenCV's drawing
_TRAIL_PIECES = 12  # of a trail, each paler and thinner than the next one


def line(image: Image, pixels: Array, colour: Colour, width: int, *, closed: bool = False) -> None:
    """Draw a line through pixels (n, 2)."""
    cv2.polylines(image, [_fixed_point(pixels)], closed, colour, width, cv2.LINE_AA, SHIFT)


def trail(image: Image, pixels: Array, colour: Colour, width: int, *, pale: float) -> None:
    """Draw a trail through pixels (n, 2), the newest last; the oldest is thin, and ``pale`` of it is white."""
    pieces = _TRAIL_PIECES if pale else width + 1  # of one colour each has another width
    edges = np.linspace(0, len(pixels) - 1, min(pieces, max(len(pixels), 2))).astype(int).tolist()
    points = _fixed_point(pixels)
    for piece, (start, end) in enumerate(pairwise(edges)):
        age = 1.0 - (piece + 1) / (len(edges) - 1)
        stroke = max(1, round(width * (1.0 - 0.7 * age)))
        cv2.polylines(
            image, [points[start : end + 1]], False, mixed(colour, WHITE, pale * age), stroke, cv2.LINE_AA, SHIFT
        )


def _fixed_point(pixels: Array) -> NDArray[np.int32]:
    return np.round(pixels * (1 << SHIFT)).astype(np.int32).reshape(-1, 1, 2)


def label(image: Image, words: Image, pixel: Array, colour: Colour, rim: int) -> None:
    """Write a text around a pixel (2,), with a white rim of so many pixels."""
    left, top = (round(float(at - length / 2)) for at, length in zip(pixel, words.shape[::-1], strict=True))
    if rim:
        halo = cv2.dilate(np.pad(words, rim), np.ones((2 * rim + 1, 2 * rim + 1), np.uint8))
        blend(image, np.asarray(halo, np.uint8), left - rim, top - rim, WHITE)
    blend(image, words, left, top, colour)


@cache
def _font(family: str, weight: str, height: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(font_manager.findfont(font_manager.FontProperties(family=family, weight=weight)), height)


@lru_cache(maxsize=32)
def text(words: str, height: int, *, bold: bool = False, fixed: bool = False) -> Image:
    """Return how dark each pixel of a text is."""
    font = _font("DejaVu Sans Mono" if fixed else "DejaVu Sans", "bold" if bold else "normal", height)
    left, top, right, bottom = font.getbbox(words)
    sheet = Pictures.new("L", (round(right - left) + 2, round(bottom - top) + 2))
    ImageDraw.Draw(sheet).text((1 - left, 1 - top), words, 255, font)
    return np.asarray(sheet)


def blend(image: Image, words: Image, x: int, y: int, colour: Colour) -> None:
    """Write a text with its upper left corner at (x, y), as far as it is in the image."""
    top, left = max(0, -y), max(0, -x)
    bottom, right = min(words.shape[0], image.shape[0] - y), min(words.shape[1], image.shape[1] - x)
    if top < bottom and left < right:
        dark = words[top:bottom, left:right, None] / 255.0
        region = image[y + top : y + bottom, x + left : x + right]
        region[:] = np.round(region * (1.0 - dark) + np.array(colour) * dark).astype(np.uint8)


def rgb(colour: str) -> Colour:
    red, green, blue = (round(255 * part) for part in to_rgb(colour))
    return red, green, blue


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    red, green, blue = (round((1 - share) * a + share * b) for a, b in zip(colour, other, strict=True))
    return red, green, blue

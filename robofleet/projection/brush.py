"""Draws in a projector's picture what is on the floor: grey, in its pixels, in metres of the floor."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image
from robofleet.projection.model import Projector

_STEP_M = 0.02  # of a line that lens and keystone bend
_SHIFT = 4  # sub-pixel bits of OpenCV's drawing
_ROUND = np.linspace(0.0, math.tau, 48, endpoint=False)
_CIRCLE = np.column_stack([np.cos(_ROUND), np.sin(_ROUND)])


class Brush:
    """Draws in pictures (H, W) of one projector."""

    def __init__(self, projector: Projector) -> None:
        self._projector = projector
        top, right, bottom, left = np.linalg.norm(
            np.diff(projector.corners, axis=0, append=projector.corners[:1]), axis=1
        )
        self._px_per_m = float(np.sum(projector.size) / (max(top, bottom) + max(left, right)))

    def line(self, picture: Image, points: Array, width_m: float, gray: int) -> None:
        """Draw a line through points (n, 2); what the projector does not light is left out."""
        legs = np.diff(points, axis=0)
        counts = np.maximum(np.ceil(np.hypot(*legs.T) / _STEP_M), 1).astype(int)
        way = [from_ + leg * np.arange(n)[:, None] / n for from_, leg, n in zip(points, legs, counts, strict=False)]
        pixels = self._pixels(np.concatenate([*way, points[-1:]]), 0.0)
        lit = np.isfinite(pixels[:, 0])
        pieces = np.split(pixels, np.flatnonzero(np.diff(lit)) + 1)
        width = max(1, round(width_m * self._px_per_m))
        shown = [_fixed(piece) for piece in pieces if np.isfinite(piece[0, 0])]
        cv2.polylines(picture, shown, False, gray, width, cv2.LINE_AA, _SHIFT)

    def ring(self, picture: Image, centre: Array, radius_m: float, width_m: float, gray: int) -> None:
        """Draw a ring around a point (2,); its line's middle has the radius."""
        around = centre + radius_m * _CIRCLE
        self.line(picture, np.vstack([around, around[:1]]), width_m, gray)

    def disc(self, picture: Image, centre: Array, radius_m: float, gray: int, height_m: float = 0.0) -> None:
        """Fill an upright cylinder around a point (2,), from the floor to a height: no ray to it has another grey."""
        around = centre + radius_m * _CIRCLE
        pixels = np.vstack([self._pixels(around, 0.0), self._pixels(around, height_m)])
        pixels = pixels[np.isfinite(pixels[:, 0])]
        if len(pixels):
            hull = np.asarray(cv2.convexHull(pixels.astype(np.float32)), np.float64)
            cv2.fillConvexPoly(picture, _fixed(hull), gray, cv2.LINE_AA, _SHIFT)

    def _pixels(self, points: Array, height_m: float) -> Array:
        return self._projector.pixels(np.column_stack([points, np.full(len(points), height_m)]))


def _fixed(pixels: Array) -> NDArray[np.int32]:
    return np.round(pixels * (1 << _SHIFT)).astype(np.int32).reshape(-1, 1, 2)

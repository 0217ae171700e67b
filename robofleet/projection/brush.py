"""Draws in a projector's picture what is on the floor: grey, in its pixels, in metres of the floor."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image
from robofleet.projection.model import Projector

_STEP_M = 0.02  # of a line that lens and keystone bend
_WIDEST_M = 100.0  # disc: it fills every picture
_INSIDE = 0.999  # of a picture, whose corners are lit for sure
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
        fine = np.concatenate([*way, points[-1:]])
        self._strokes(picture, self._pixels(fine, np.zeros(len(fine))), width_m, gray)

    def rings(self, picture: Image, centres: Array, radii_m: Array, width_m: float, gray: int) -> None:
        """Draw rings around points (n, 2); their lines' middles have the radii (n,)."""
        for ring in self._circles(centres, radii_m, np.zeros(len(centres))):
            self._strokes(picture, np.vstack([ring, ring[:1]]), width_m, gray)

    def discs(self, picture: Image, centres: Array, radii_m: Array, gray: int, heights_m: Array | None = None) -> None:
        """Fill upright cylinders around points (n, 2), from the floor to heights (n,): of all that stands in them."""
        radii_m = np.minimum(radii_m, _WIDEST_M)
        bases = self._circles(centres, radii_m, np.zeros(len(centres)))
        tops = bases if heights_m is None else self._circles(centres, radii_m, heights_m)
        for centre, radius, base, top in zip(centres, radii_m, bases, tops, strict=True):
            whole = bool(np.isfinite(base).all())
            both = np.concatenate([base if whole else self._lit_part(centre + radius * _CIRCLE), top])
            lit = both[np.isfinite(both[:, 0])]
            if len(lit):
                hull = np.asarray(cv2.convexHull(lit.astype(np.float32)), np.float64)
                cv2.fillConvexPoly(picture, _fixed(hull), gray, cv2.LINE_AA, _SHIFT)

    def fill(self, picture: Image, outline: Array, gray: int) -> None:
        """Fill a small convex outline (n, 2) on the floor, if all of it is lit."""
        pixels = self._pixels(outline, np.zeros(len(outline)))
        if np.isfinite(pixels).all():
            cv2.fillConvexPoly(picture, _fixed(pixels), gray, cv2.LINE_AA, _SHIFT)

    def _lit_part(self, outline: Array) -> Array:
        """Return the corners (n, 2) [px] of what is lit of a convex outline (K, 2) on the floor."""
        middle = self._projector.corners.mean(axis=0)
        lit = middle + _INSIDE * (self._projector.corners - middle)
        _, part = cv2.intersectConvexConvex(outline.astype(np.float32), lit.astype(np.float32))
        part = np.zeros((0, 2)) if part is None else part.reshape(-1, 2)
        return self._pixels(np.asarray(part, np.float64), np.zeros(len(part)))

    def _strokes(self, picture: Image, pixels: Array, width_m: float, gray: int) -> None:
        lit = np.isfinite(pixels[:, 0])
        pieces = [piece for piece in np.split(pixels, np.flatnonzero(np.diff(lit)) + 1) if np.isfinite(piece[0, 0])]
        width = max(1, round(width_m * self._px_per_m))
        cv2.polylines(picture, [_fixed(piece) for piece in pieces], False, gray, width, cv2.LINE_AA, _SHIFT)

    def _circles(self, centres: Array, radii_m: Array, heights_m: Array) -> Array:
        """Return the pixels (n, K, 2) of circles."""
        around = (centres[:, None] + radii_m[:, None, None] * _CIRCLE).reshape(-1, 2)
        return self._pixels(around, np.repeat(heights_m, len(_CIRCLE))).reshape(len(centres), len(_CIRCLE), 2)

    def _pixels(self, points: Array, heights_m: Array) -> Array:
        return self._projector.pixels(np.column_stack([points, heights_m]))


def _fixed(pixels: Array) -> NDArray[np.int32]:
    return np.round(pixels * (1 << _SHIFT)).astype(np.int32).reshape(-1, 1, 2)

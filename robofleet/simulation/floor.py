"""What lies in the arena: a cluttered floor, and the looks of printed tags."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from robofleet.core.arrays import Array, Image

BLACK, WHITE = 30.0, 215.0  # greys of print and paper in full light: assumed, and in the range of a laboratory
_OBSTACLE, _OBSTACLE_EDGE = 105, 75  # greys
_CELLS = 8  # along a print that is no tag
_PIXEL_M = 0.002  # side of a pixel of the drawn floor
WIDEST = 2.0  # that the floor is drawn out to [camera's heights]; its rim goes on for ever
_AROUND_M = 0.3  # drawn beyond what is in view: a camera may be knocked


class Floor:
    """Wood, scraps, tape, cables and prints that look like tags, over what a camera sees."""

    def __init__(
        self, seen: Array, eye: Array, side: float, blur_px: float, rng: np.random.Generator,
        obstacles: Sequence[Array] = (),
    ) -> None:  # fmt: skip
        """Take the points (2, ...) [m] that are seen, from ``eye`` (3,), the side of the prints [m], and the outlines
        (K, 2) [m] of what stands on the floor: it hides nothing but floor."""
        out = WIDEST * eye[2]
        low, high = (np.clip(end(seen, axis=(1, 2)), eye[:2] - out, eye[:2] + out) for end in (np.min, np.max))
        self._low = low - _AROUND_M
        w, h = np.ceil((high + _AROUND_M - self._low) / _PIXEL_M).astype(int) + 1
        size = np.array([w, h])
        wood = rng.integers(120, 150, (12, 20), dtype=np.uint8)
        floor = np.asarray(cv2.resize(wood, (w, h), interpolation=cv2.INTER_CUBIC), np.uint8)
        for _ in range(12):  # scraps, and patches of bright light
            patch = (rng.uniform(0, size).tolist(), rng.uniform(20, 140, 2).tolist(), rng.uniform(0, 180))
            cv2.ellipse(floor, patch, int(rng.choice([60, 90, 180, 245])), -1, cv2.LINE_AA)
        for _ in range(10):  # tape
            a, b = rng.integers(0, size, (2, 2))
            cv2.line(floor, a, b, int(rng.choice([50, 200])), int(rng.integers(2, 12)), cv2.LINE_AA)
        for _ in range(4):  # cables
            heading = rng.normal(0.0, 0.2, 120).cumsum()
            bends = rng.uniform(0, size) + 8.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1).cumsum(0)
            cv2.polylines(floor, [bends.astype(np.int32)], False, 45, 4, cv2.LINE_AA)
        for _ in range(12):
            cells = np.zeros((_CELLS, _CELLS), np.uint8)
            cells[1:-1, 1:-1] = rng.integers(0, 2, (_CELLS - 2, _CELLS - 2))
            _paste(floor, 30 + 180 * np.pad(cells, 1, constant_values=1), side, rng)
        for outline in obstacles:
            corners = np.rint((outline - self._low) / _PIXEL_M).astype(np.int32)
            cv2.fillPoly(floor, [corners], _OBSTACLE, cv2.LINE_AA)
            cv2.polylines(floor, [corners], True, _OBSTACLE_EDGE, 3, cv2.LINE_AA)
        self._grays = np.asarray(cv2.GaussianBlur(floor, (0, 0), blur_px * 1.5), np.uint8)  # a pixel is about 1.5

    def grays(self, points: Array) -> Array:
        """Return the greys (H, W) at points (2, H, W) of the floor [m]."""
        x, y = (((at - low) / _PIXEL_M).astype(np.float32) for at, low in zip(points, self._low, strict=True))
        grays = cv2.remap(self._grays, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(grays, np.float64)


def _paste(floor: Image, cells: Image, side: float, rng: np.random.Generator) -> None:
    """Lay a print of ``cells`` somewhere onto ``floor``."""
    scale, angle = side / (_CELLS * _PIXEL_M), rng.uniform(-math.pi, math.pi)
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    x, y = rng.uniform(0, floor.shape[::-1])
    onto = np.array([[c, -s, x], [s, c, y]])
    cv2.warpAffine(cells, onto, floor.shape[::-1], floor, cv2.INTER_NEAREST, cv2.BORDER_TRANSPARENT)

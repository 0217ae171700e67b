"""Draws tags' outlines, numbers and trails over images: a film, and one picture of what was found."""

import bisect
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.figures import INK, robot_colours
from robofleet.gateways.exports.strokes import WHITE, Image, blend, label, line, rgb, text, trail

_TRAIL_S, _TRAIL_POINTS = 8.0, 60
_HEADER = 0.04  # height of title and time above the image [widths]
_AHEAD = 1.1  # length of the line that shows a tag's heading, from its centre [sides]
_NAME_BELOW = 1.15  # of a tag's number, from its centre [sides]


class Overlay:
    """What was seen of tags so far, and images with it."""

    def __init__(self, tags: Sequence[int], size: tuple[int, int], title: str, most_wide: int) -> None:
        """Draw images of a size (width, height) [px], or a whole part of it, not wider than ``most_wide``."""
        self._part = -(-size[0] // most_wide)  # by whole numbers of pixels: some times as fast
        self.width, height = (side // self._part // 2 * 2 for side in size)
        self._header = 2 * round(_HEADER * self.width / 2)
        self.height = height + self._header
        self._stroke = max(1, round(self.width / 640))
        self._colours = {tag: rgb(c) for tag, c in zip(tags, robot_colours(len(tags)), strict=True)}
        self._names = {tag: text(str(tag), round(self.width / 60), bold=True) for tag in tags}
        self._title = text(title, round(self.width / 60), bold=True)
        self._t: dict[int, list[float]] = {tag: [] for tag in tags}
        self._centres: dict[int, list[Array]] = {tag: [] for tag in tags}

    def add(self, t_s: float, outlines: Mapping[int, Array]) -> None:
        """Take where tags are: corners (4, 2) [px], clockwise from the print's top left."""
        for tag, corners in outlines.items():
            self._t[tag].append(t_s)
            self._centres[tag].append(corners.mean(0))

    def drawn(self, t_s: float, image: Image, outlines: Mapping[int, Array], *, whole: bool = False) -> Image:
        """Return an image (H, W), RGB, with what was seen until then; ``whole``: with the whole paths, also later."""
        picture = np.full((self.height, self.width, 3), 255, np.uint8)
        on = picture[self._header :]
        shown = image[: self._part * on.shape[0], : self._part * self.width]
        if self._part > 1:
            shown = np.asarray(cv2.resize(shown, on.shape[1::-1], interpolation=cv2.INTER_AREA), np.uint8)
        cv2.cvtColor(shown, cv2.COLOR_GRAY2RGB, dst=on)
        self._head(picture, t_s)
        for tag, colour in self._colours.items() if whole else ():
            if len(self._centres[tag]) > 1:
                line(on, self._at(np.array(self._centres[tag])), colour, max(1, self._stroke // 2))
        for tag, colour in self._colours.items():
            times, centres = self._t[tag], self._centres[tag]
            last = bisect.bisect_right(times, t_s)
            first = bisect.bisect_left(times, t_s - _TRAIL_S)
            recent = centres[first:last][:: -max(1, (last - first) // _TRAIL_POINTS)][::-1]
            if len(recent) > 1:
                trail(on, self._at(np.array(recent)), colour, 3 * self._stroke, pale=0.0)
        for tag, corners in outlines.items():
            self._outline(on, tag, self._at(corners))
        return picture

    def _outline(self, on: Image, tag: int, corners: Array) -> None:
        colour, centre = self._colours[tag], corners.mean(0)
        right, down = (corners[1] + corners[2]) / 2 - centre, (corners[2] + corners[3]) / 2 - centre
        for shade, width in ((WHITE, 3 * self._stroke), (colour, 2 * self._stroke)):
            line(on, corners, shade, width, closed=True)
            line(on, np.stack([centre + right, centre + 2 * _AHEAD * right]), shade, width)
        across = _NAME_BELOW * float(np.hypot(*right) + np.hypot(*down))
        label(on, self._names[tag], centre + np.array([0.0, across]), colour, 2 * self._stroke)

    def _at(self, pixels: Array) -> Array:
        return np.asarray((pixels + 0.5) / self._part - 0.5)

    def _head(self, picture: Image, t_s: float) -> None:
        margin, middle = round(0.015 * self.width), self._header // 2
        clock = text(f"{t_s:.2f} s", round(self.width / 60), fixed=True)
        blend(picture, self._title, margin, middle - self._title.shape[0] // 2, rgb(INK))
        blend(picture, clock, self.width - margin - clock.shape[1], middle - clock.shape[0] // 2, rgb(INK))

"""Finds a fleet's AprilTags in an image, or in a region of it, with no memory of other images.

A tag lies flat at a known height. With the pattern upright as OpenCV prints it (``cv2.aruco.generateImageMarker``),
the print's right is its forward x, its top its left y. ``families.py`` finds and identifies the squares, with corners
good to half a pixel; the photometric fit places them, and says whether they look like what they read.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Complex, Image
from robofleet.tracking.tags.families import NO_SQUARES, Squares, finder
from robofleet.tracking.tags.photometric import ALIKE, Found, PhotometricFit, side_px
from robofleet.tracking.tags.targets import Target

_SIZE_RATIO = (0.8, 1.25)  # of a square on the plane, over the true one
_SKEW = 0.1  # its corners' largest distance from a true square's [sides]
_DARK = 110  # an image whose brightest parts are darker than this is brightened first [grey]
_BRIGHTENED = 200.0  # to this level [grey]
_CHANGED = 0.04  # of its brightest part, by which one part of a tile must change: a tag's contrast is 0.8
_PART = 4  # of a thumbnail, its width [px]
_SEARCHES, _ANYWAY = 3, 16  # visits in which what changed is searched; of all visits, one in which the whole tile is

# As detectMarkers orders them: the print's top left, top right, bottom right, bottom left.
CORNERS = np.array([-0.5 + 0.5j, 0.5 + 0.5j, 0.5 - 0.5j, -0.5 - 0.5j])


class Region(NamedTuple):
    """A rectangle of pixels; right and bottom are not part of it."""

    left: int
    top: int
    right: int
    bottom: int


class Findings(NamedTuple):
    """What a search gave. The same target may be found more than once."""

    tags: tuple[Found, ...]
    refused: int  # squares that read as a target and cannot be it: a wrong size, shape or look
    squares: Squares | None = None  # the same squares in the order in which to look at them again, if it matters


class TagSearch:
    """A way to find targets."""

    def squares(self, image: Image, region: Region | None = None, bright: float | None = None) -> Squares:
        """Return what may be a target in an image (H, W), or in a region of it; ``bright``: its brightest part."""
        raise NotImplementedError

    def place(self, image: Image, squares: Squares, known: Complex | None = None) -> Findings:
        """Return what squares of an image are; see ``detect``."""
        raise NotImplementedError

    def detect(self, image: Image, region: Region | None = None, known: Complex | None = None) -> Findings:
        """Return the targets in an image (H, W), or in a region of it; not those that stand where they are ``known``.

        known (N,): of all targets, NaN where it is not known [m].
        """
        return self.place(image, self.squares(image, region), known)


class TagDetector(TagSearch):
    """Finds targets; other ids of the family are not in its dictionary."""

    def __init__(self, fit: PhotometricFit, targets: Sequence[Target]) -> None:
        self._fit = fit
        self._sides = np.array([target.side for target in targets])
        sizes = [side_px(fit.geometry, target) for target in targets]
        self._perimeter_px = (0.5 * 4.0 * min(sizes), 2.0 * 4.0 * max(sizes))
        self._parameters = _parameters()
        self._finder = finder(fit.family, [target.tag for target in targets], self._parameters)

    def place(self, image: Image, squares: Squares, known: Complex | None = None) -> Findings:
        corners, found = squares
        if known is not None and len(found):
            middle = self._fit.geometry.to_plane(corners.mean(1), self._fit.heights[found])
            new = ~(np.abs(middle[:, 0] + 1j * middle[:, 1] - known[found]) < 0.5 * self._sides[found])
            corners, found = corners[new], found[new]
        if not len(found):
            return Findings((), 0)
        centre, psi, plausible = self._place(corners, found)
        may = found[plausible]
        if not len(may):
            return Findings((), len(found))
        fit = self._fit.fit(image, may, centre[plausible], psi[plausible])
        good = np.flatnonzero(fit.alike > ALIKE)
        tags = (fit.found(k, target) for k, target in zip(good.tolist(), may[good].tolist(), strict=True))
        return Findings(tuple(tags), len(found) - len(good))

    def squares(self, image: Image, region: Region | None = None, bright: float | None = None) -> Squares:
        left, top, right, bottom = region or Region(0, 0, image.shape[1], image.shape[0])
        part = image[top:bottom, left:right]
        corners, found = self._squares(part, float(thumbnail(part).max()) if bright is None else bright)
        return Squares(corners + np.array([left, top]), found)

    def _squares(self, image: Image, bright: float) -> Squares:
        if bright < _DARK:  # noise is brightened too, so it is smoothed first
            brightened = cv2.convertScaleAbs(cv2.blur(image, (3, 3)), alpha=_BRIGHTENED / max(bright, 1.0))
            image = np.asarray(brightened, np.uint8)
        longer = max(image.shape)
        # The rates are of the longer side. Contours count a diagonal step as one, and the image's corners show tags
        # smaller: half of the length remains.
        self._parameters.minMarkerPerimeterRate = self._perimeter_px[0] / longer
        self._parameters.maxMarkerPerimeterRate = self._perimeter_px[1] / longer
        return self._finder.find(image)

    def _place(
        self, pixels: NDArray[np.float64], index: NDArray[np.int64]
    ) -> tuple[Complex, NDArray[np.float64], NDArray[np.bool_]]:
        """Return centre and heading of the squares (M, 4, 2) by least squares, and whether they may be tags."""
        x_y = self._fit.geometry.to_plane(pixels.reshape(-1, 2), np.repeat(self._fit.heights[index], 4))
        corners = (x_y[:, 0] + 1j * x_y[:, 1]).reshape(-1, 4)
        centre = corners.mean(1)
        arms = (corners - centre[:, None]) / self._sides[index, None]
        turn = arms @ CORNERS.conj() / 2.0  # 2 is the sum of |CORNERS|^2
        size = np.abs(turn)
        skew = np.abs(arms - turn[:, None] * CORNERS).max(1)
        return centre, np.angle(turn), (size > _SIZE_RATIO[0]) & (size < _SIZE_RATIO[1]) & (skew < _SKEW)


class _Searched(NamedTuple):
    """A tile."""

    shown: Image  # its thumbnail, each part as it was when it was searched last
    squares: Squares  # that were found then
    part: Region  # that changed last
    visits: int  # since it changed


class Sweep:
    """Searches an image tile by tile, another one each time; of a tile that shows what it showed, nothing.

    What it shows is compared by the means of its parts, four pixels wide, with the newest of their searches: a tag that
    comes or goes, or a light, changes them by more than noise does, and what creeps does in the end. Around what
    changed, the tile is searched, and some times more; now and then all of it: noise may have hidden what is there.
    """

    def __init__(self, detector: TagSearch, tiles: Sequence[Region], overlap: float) -> None:
        """Take tiles that overlap by more than a tag [px]."""
        self._detector, self._tiles, self._overlap = detector, tuple(tiles), math.ceil(overlap)
        self._searched: list[_Searched | None] = [None] * len(self._tiles)

    def __len__(self) -> int:
        return len(self._tiles)

    def search(self, image: Image, turn: int, known: Complex) -> Findings:
        """Return the targets in the tile whose turn it is; not those that stand where they are ``known``."""
        round_, k = divmod(turn, len(self._tiles))
        left, top, right, bottom = tile = self._tiles[k]
        shown = thumbnail(image[top:bottom, left:right])
        bright = float(shown.max())
        before = self._searched[k] or _Searched(np.zeros_like(shown), NO_SQUARES, tile, 0)
        every = self._searched[k] is None or (round_ + k) % _ANYWAY == 0
        part, visits = self._changed(shown, before.shown, bright, tile), 0
        if part is None:
            part, visits = before.part, before.visits + 1
        elif before.visits < _SEARCHES and not every:
            part = _around(part, before.part)
        squares, compared = before.squares, before.shown
        if every or visits < _SEARCHES:
            searched = tile if every else part
            squares = _renewed(squares, self._detector.squares(image, searched, bright), searched)
            compared = shown if every else _pasted(before.shown, shown, searched, tile)
        found = self._detector.place(image, squares, known)
        self._searched[k] = _Searched(compared, squares if found.squares is None else found.squares, part, visits)
        return found

    def _changed(self, shown: Image, before: Image, bright: float, tile: Region) -> Region | None:
        """Return the part of a tile around what changed since ``before``, so large that any tag of it is whole."""
        difference = cv2.absdiff(shown, before)
        u, v, width, height = cv2.boundingRect(cv2.threshold(difference, _CHANGED * bright, 1, cv2.THRESH_BINARY)[1])
        if not width:
            return None
        left, top = tile.left + _PART * u - self._overlap, tile.top + _PART * v - self._overlap
        wide, high = _PART * width + 2 * self._overlap, _PART * height + 2 * self._overlap
        return Region(
            max(tile.left, left), max(tile.top, top), min(tile.right, left + wide), min(tile.bottom, top + high)
        )


def _around(first: Region, other: Region) -> Region:
    return Region(*map(min, first[:2], other[:2]), *map(max, first[2:], other[2:]))


def _renewed(before: Squares, now: Squares, part: Region) -> Squares:
    """Return squares of which those that are wholly in a part are the ones that it shows ``now``."""
    beyond = ((before.corners < part[:2]) | (before.corners > part[2:])).any((1, 2))
    return Squares(np.concatenate([now.corners, before.corners[beyond]]), np.append(now.which, before.which[beyond]))


def _pasted(before: Image, shown: Image, part: Region, tile: Region) -> Image:
    """Return a tile's thumbnail in which a part is as it is ``shown``."""
    columns = slice((part.left - tile.left) // _PART, (part.right - tile.left) // _PART + 1)
    rows = slice((part.top - tile.top) // _PART, (part.bottom - tile.top) // _PART + 1)
    pasted = before.copy()
    pasted[rows, columns] = shown[rows, columns]
    return pasted


def thumbnail(image: Image) -> Image:
    """Return the means of an image's parts, four pixels wide."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(half, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)


def tiles(size: tuple[int, int], count: tuple[int, int], overlap: float) -> list[Region]:
    """Return regions, so many across and down, that cover an image (width, height) and overlap by pixels."""
    (across, down), half = count, math.ceil(overlap / 2.0)
    lefts, tops = np.linspace(0, size[0], across + 1), np.linspace(0, size[1], down + 1)
    return [
        Region(
            max(0, int(lefts[i]) - half),
            max(0, int(tops[j]) - half),
            min(size[0], int(lefts[i + 1]) + half),
            min(size[1], int(tops[j + 1]) + half),
        )
        for j in range(down)
        for i in range(across)
    ]


def _parameters() -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15.0
    # All the bits that the family can correct: what is corrected wrongly does not look like its tag.
    parameters.errorCorrectionRate = 1.0
    return parameters

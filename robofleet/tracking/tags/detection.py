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
from robofleet.tracking.tags.families import Squares, finder
from robofleet.tracking.tags.photometric import ALIKE, Found, PhotometricFit, side_px
from robofleet.tracking.tags.targets import Target

_SIZE_RATIO = (0.8, 1.25)  # of a square on the plane, over the true one
_SKEW = 0.1  # its corners' largest distance from a true square's [sides]
_DARK = 110  # an image whose brightest parts are darker than this is brightened first [grey]
_BRIGHTENED = 200.0  # to this level [grey]
_CHANGED = 0.04  # of its brightest part, by which one part of a tile must change: a tag's contrast is 0.8
_SEARCHES, _ANYWAY = 3, 16  # visits in which a tile that changed is searched; of all visits, one in which any is

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
        if not len(found):
            return Findings((), 0)
        centre, psi, plausible = self._place(corners, found)
        if known is not None:
            new = ~(np.abs(centre - known[found]) < 0.5 * self._sides[found])
            found, centre, psi, plausible = found[new], centre[new], psi[new], plausible[new]
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

    shown: Image  # its thumbnail when it was searched last
    squares: Squares  # that were found then
    visits: int  # since it changed


class Sweep:
    """Searches an image tile by tile, another one each time. A tile that shows what it showed is not searched again.

    What it shows is compared by the means of its parts, four pixels wide, with the newest of its searches: a tag that
    comes or goes, or a light, changes them by more than noise does, and what creeps does in the end. A change is
    followed by some searches more, and now and then there is one without any: noise may have hidden what is there.
    """

    def __init__(self, detector: TagSearch, tiles: Sequence[Region]) -> None:
        self._detector, self._tiles = detector, tuple(tiles)
        self._searched: list[_Searched | None] = [None] * len(self._tiles)

    def __len__(self) -> int:
        return len(self._tiles)

    def search(self, image: Image, turn: int, known: Complex) -> Findings:
        """Return the targets in the tile whose turn it is; not those that stand where they are ``known``."""
        k = turn % len(self._tiles)
        left, top, right, bottom = region = self._tiles[k]
        shown = thumbnail(image[top:bottom, left:right])
        bright = float(shown.max())
        before = self._searched[k]
        same = before is not None and cv2.norm(shown, before.shown, cv2.NORM_INF) <= _CHANGED * bright
        visits = before.visits + 1 if before is not None and same else 0
        if before is None or visits < _SEARCHES or visits % _ANYWAY == 0:
            squares = self._detector.squares(image, region, bright)
        else:
            shown, squares = before.shown, before.squares
        found = self._detector.place(image, squares, known)
        self._searched[k] = _Searched(shown, squares if found.squares is None else found.squares, visits)
        return found


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


def wrapped(psi: float) -> float:
    """Return an angle in [-pi, pi] [rad]."""
    return math.remainder(psi, math.tau)


def _parameters() -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15.0
    # All the bits that the family can correct: what is corrected wrongly does not look like its tag.
    parameters.errorCorrectionRate = 1.0
    return parameters

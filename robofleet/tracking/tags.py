"""Finds a fleet's AprilTags (36h11) in an image, or in a region of it, with no memory of other images.

A tag lies flat at a known height. With the pattern upright as OpenCV prints it (``cv2.aruco.generateImageMarker``),
the print's right is its forward x, its top its left y. OpenCV finds and identifies the squares, with corners good to
half a pixel; the photometric fit places them, and says whether they look like what they read.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.tracking.photometric import CELLS, FAMILY, PhotometricFit, side_px
from robofleet.tracking.targets import Target

Image = NDArray[np.uint8]
Complex = NDArray[np.complex128]

_ALIKE = 0.9  # least correlation of a print with its pattern: a tag has 0.99, one with 4 cells wrong 0.88
_SIZE = (0.8, 1.25)  # of a square on the plane, over the true one
_SKEW = 0.1  # its corners' largest distance from a true square's [sides]
_DARK = 110  # an image whose brightest parts are darker than this is brightened first [grey]
_BRIGHT = 200.0  # so far [grey]

# As detectMarkers orders them: the print's top left, top right, bottom right, bottom left.
_CORNERS = np.array([-0.5 + 0.5j, 0.5 + 0.5j, 0.5 - 0.5j, -0.5 - 0.5j])


class Region(NamedTuple):
    """A rectangle of pixels; right and bottom are not part of it."""

    left: int
    top: int
    right: int
    bottom: int


class Found(NamedTuple):
    """A tag in an image: planar pose of its centre in the world frame."""

    target: int  # its index
    centre: complex  # [m]
    psi: float  # [rad; CCW +]


class Findings(NamedTuple):
    """What a search gave. The same target may be found more than once."""

    tags: tuple[Found, ...]
    refused: int  # squares that read as a target and cannot be it: a wrong size, shape or look


class TagDetector:
    """Finds targets; other ids of the family are not in its dictionary."""

    def __init__(self, fit: PhotometricFit, targets: Sequence[Target]) -> None:
        self._fit = fit
        self._sides = np.array([target.side for target in targets])
        sizes = [side_px(fit.geometry, target) for target in targets]
        self._perimeter_px = (0.5 * 4.0 * min(sizes), 2.0 * 4.0 * max(sizes))
        family = cv2.aruco.getPredefinedDictionary(FAMILY)
        ids = [target.tag for target in targets]
        fleet = cv2.aruco.Dictionary(family.bytesList[ids], CELLS - 2, family.maxCorrectionBits)
        self._parameters = _parameters()
        self._detector = cv2.aruco.ArucoDetector(fleet, self._parameters)

    def detect(self, image: Image, region: Region | None = None, known: Complex | None = None) -> Findings:
        """Return the targets in an image (H, W), or in a region of it; not those that stand where they are ``known``.

        known (N,): of all targets, NaN where it is not known [m].
        """
        left, top, right, bottom = region or Region(0, 0, image.shape[1], image.shape[0])
        corners, found = self._squares(image[top:bottom, left:right])
        if not len(found):
            return Findings((), 0)
        centre, psi, plausible = self._place(corners + np.array([left, top]), found)
        if known is not None:
            new = ~(np.abs(centre - known[found]) < 0.5 * self._sides[found])
            found, centre, psi, plausible = found[new], centre[new], psi[new], plausible[new]
        fit = self._fit.fit(image, found, centre, psi)
        good = plausible & (fit.alike > _ALIKE)
        rows = zip(found[good].tolist(), fit.centre[good].tolist(), fit.psi[good].tolist(), strict=True)
        return Findings(tuple(Found(*row) for row in rows), len(found) - int(good.sum()))

    def _squares(self, image: Image) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return corners (M, 4, 2) [px] and targets (M,) of what reads as a target."""
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        bright = float(cv2.resize(half, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).max())
        if bright < _DARK:  # noise is brightened too, so it is smoothed first
            brightened = cv2.convertScaleAbs(cv2.blur(image, (3, 3)), alpha=_BRIGHT / max(bright, 1.0))
            image = np.asarray(brightened, np.uint8)
        longer = max(image.shape)
        # The rates are of the longer side. Contours count a diagonal step as one, and the image's corners show tags
        # smaller: half of the length remains.
        self._parameters.minMarkerPerimeterRate = self._perimeter_px[0] / longer
        self._parameters.maxMarkerPerimeterRate = self._perimeter_px[1] / longer
        self._detector.setDetectorParameters(self._parameters)
        corners, found, _ = self._detector.detectMarkers(image)
        if found is None or len(found) == 0:
            return np.empty((0, 4, 2)), np.empty(0, np.int64)
        return np.concatenate(corners, axis=0).astype(np.float64), found[:, 0].astype(np.int64)

    def _place(
        self, pixels: NDArray[np.float64], index: NDArray[np.int64]
    ) -> tuple[Complex, NDArray[np.float64], NDArray[np.bool_]]:
        """Return centre and heading of the squares (M, 4, 2) by least squares, and whether they may be tags."""
        x_y = self._fit.geometry.to_plane(pixels.reshape(-1, 2), np.repeat(self._fit.heights[index], 4))
        corners = (x_y[:, 0] + 1j * x_y[:, 1]).reshape(-1, 4)
        centre = corners.mean(1)
        arms = (corners - centre[:, None]) / self._sides[index, None]
        turn = arms @ _CORNERS.conj() / 2.0  # 2 is the sum of |_CORNERS|^2
        size = np.abs(turn)
        skew = np.abs(arms - turn[:, None] * _CORNERS).max(1)
        return centre, np.angle(turn), (size > _SIZE[0]) & (size < _SIZE[1]) & (skew < _SKEW)


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
    """Return the settings of OpenCV's detector: one threshold."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15.0
    # All the bits that the family can correct: what is corrected wrongly does not look like its tag.
    parameters.errorCorrectionRate = 1.0
    return parameters

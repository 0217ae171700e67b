"""Where tags are in an image, to a hundredth of a pixel, whatever is known of the camera.

OpenCV finds and reads the squares, with corners good to half a pixel. Then the whole print is laid over the greys: the
homography that correlates best (``cv2.findTransformECC``) is right to 0.01 px, and needs no camera model. Prints that
do not look like their tag are dropped.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image
from robofleet.core.settings import FAMILIES, FamilyName
from robofleet.tracking.tags.families import finder, pattern

_WHITE_MARGIN = 0.5  # of the white around it that is compared, too [cells]
_CELL_PIXELS = 16  # of the drawn print
_BLUR_PX = 0.6  # standard deviation expected of lens and pixel; a wrong one does not bias
_ALIKE = 0.93  # least correlation with the print: a tag has 0.99, one with 3 cells wrong 0.91
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-7)
_SMOOTHED = 2 / 3  # of the noise's standard deviation that linear interpolation leaves, between pixels anywhere


class Seen(NamedTuple):
    """One print in one image [px]."""

    corners: Array  # (4, 2) of the square, clockwise from the print's top left
    centre: Array  # (2,)
    ahead: Array  # (2,) of the square's right edge, in the middle
    sigma: float  # standard deviation of a coordinate, by what of the greys the print does not explain


class TagFinder:
    """Finds every tag of a family in an image."""

    def __init__(self, family: FamilyName, ids: Sequence[int] | None = None) -> None:
        """Look for these tags alone; None: for all of the family."""
        self._name, self._family = family, FAMILIES[family]
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
        self._ids = tuple(range(self._family.ids) if ids is None else ids)
        self._finder = finder(family, self._ids, parameters)

    def find(self, image: Image) -> dict[int, list[Seen]]:
        """Return the prints of each id in an image (H, W)."""
        squares = self._finder.find(image)
        found: dict[int, list[Seen]] = {}
        for corners, which in zip(squares.corners, squares.which.tolist(), strict=True):
            tag = self._ids[which]
            seen = self._laid_over(image, tag, corners)
            if seen is not None:
                found.setdefault(tag, []).append(seen)
        return found

    def _laid_over(self, image: Image, tag: int, corners: Array) -> Seen | None:
        """Return the print that has its corners near (4, 2) [px]; None if none there looks like the tag."""
        side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
        cell = max(2.0, side / self._family.square)
        template, middle = self._template(tag, cell)
        rim = cell * self._family.square / 2.0
        beyond = cell * (2.0 + (self._family.cells - self._family.square) / 2.0)
        drawn = middle + rim * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        # The patch keeps the warp's numbers small, which are single precision.
        left, top = (int(corner) for corner in np.maximum(corners.min(0) - beyond, 0.0))
        right, bottom = (int(corner) for corner in corners.max(0) + beyond + 1.0)
        patch = image[top:bottom, left:right].astype(np.float32)
        onto = (corners - [left, top]).astype(np.float32)
        warp = cv2.getPerspectiveTransform(drawn.astype(np.float32), onto).astype(np.float32)
        everywhere = np.ones(patch.shape, np.uint8)
        try:
            alike, laid = cv2.findTransformECC(template, patch, warp, cv2.MOTION_HOMOGRAPHY, _CRITERIA, everywhere, 1)
        except cv2.error:  # it did not converge
            return None
        points = np.concatenate([drawn, [[middle, middle], [middle + rim, middle]]])[None]
        *square, centre, ahead = cv2.perspectiveTransform(points, np.asarray(laid, np.float64))[0] + [left, top]
        near = math.dist(centre, corners.mean(0)) < cell  # perspective and lens move the middle by less
        return (
            Seen(np.array(square), centre, ahead, _sigma_px(template, patch, np.asarray(laid, np.float32)))
            if alike > _ALIKE and near
            else None
        )

    def _template(self, tag: int, cell: float) -> tuple[NDArray[np.float32], float]:
        """Return the print as a camera shows it with ``cell`` pixels a cell, and its middle's coordinate."""
        white = np.pad(pattern(tag, self._name), 1, constant_values=True)
        drawn = np.kron(255.0 * white, np.ones((_CELL_PIXELS, _CELL_PIXELS))).astype(np.float32)
        scale = _CELL_PIXELS / cell
        blurred = cv2.GaussianBlur(drawn, (0, 0), _BLUR_PX * scale)
        size = math.ceil((self._family.cells + 2.0 * _WHITE_MARGIN) * cell)
        middle = (size - 1) / 2.0
        shift = (len(drawn) - 1) / 2.0 - scale * middle
        at = np.array([[scale, 0.0, shift], [0.0, scale, shift]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(blurred, at, (size, size), flags=flags), np.float32), middle


def _sigma_px(template: NDArray[np.float32], patch: NDArray[np.float32], laid: NDArray[np.float32]) -> float:
    """Return how well a print's place is known: the greys that it leaves over, against its edges."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(patch, laid, template.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    print_ = template - template.mean()
    gain = float((print_ * seen).sum() / (print_ * print_).sum())
    rest = seen - seen.mean() - gain * print_
    down, across = np.gradient(print_)
    edges = gain * math.sqrt(float((down * down + across * across).sum()) / 2.0)
    return float(rest.std()) / _SMOOTHED / edges

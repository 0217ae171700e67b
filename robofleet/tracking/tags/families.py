"""The patterns of tag families, and the search for squares that read as their tags.

A family is a row of ``FAMILIES``, and what its tags look like: of those that OpenCV knows, OpenCV's patterns; of others
a table of codes in ``tables``, and which cell shows which bit. All are upright as OpenCV prints them: half a turn from
the images that AprilRobotics publishes.
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image
from robofleet.core.settings import FAMILIES, Family

_CONTRAST = 5.0  # least, of the cells that all tags have in common [grey levels]
_SAME_SQUARE = 0.5  # squares closer than this are one [sides]


class Squares(NamedTuple):
    """What reads as tags."""

    corners: Array  # (M, 4, 2) of the squares, clockwise from the print's top left [px]
    which: NDArray[np.int64]  # (M,) of the tags that are looked for


NO_SQUARES = Squares(np.empty((0, 4, 2)), np.empty(0, np.int64))


def finder(family: str, ids: Sequence[int], parameters: cv2.aruco.DetectorParameters) -> "_BitsInside | _BitsAround":
    """Return what finds squares that read as these tags; its caller may change the parameters later."""
    inside = FAMILIES[family].square == FAMILIES[family].cells
    return (_BitsInside if inside else _BitsAround)(family, ids, parameters)


def dark_squares(image: Image, family: Family) -> Image:
    """Return an image, or its negative, in which the squares of a family are dark in light."""
    return np.asarray(cv2.bitwise_not(image), np.uint8) if family.white else image


def pattern(tag: int, family: str) -> NDArray[np.bool_]:
    """Return a tag's cells (C, C), true where white, row 0 at the top."""
    return np.asarray(patterns(family)[tag])


@functools.cache
def patterns(family: str) -> NDArray[np.bool_]:
    """Return the cells (N, C, C) of all tags of a family; see ``pattern``."""
    cells = FAMILIES[family].cells
    table = Path(__file__).with_name("tables") / f"{family}.txt"
    if table.exists():
        return _standard_41(np.array([int(code, 16) for code in _words(table)], np.uint64))
    tags = _dictionary(family)
    return np.stack([tags.generateImageMarker(tag, cells) > 0 for tag in range(FAMILIES[family].ids)])


@functools.cache
def same(family: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells (C + 2, C + 2) of a print and of the paper around it that are white, and black, in all tags."""
    shown = np.pad(patterns(family), ((0, 0), (1, 1), (1, 1)), constant_values=True)
    return np.asarray(shown.all(0)), np.asarray(~shown.any(0))


def _words(table: Path) -> list[str]:
    lines = table.read_text(encoding="ascii").splitlines()
    return [word for line in lines if not line.startswith("#") for word in line.split()]


def _standard_41(codes: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Return the cells (N, 9, 9) of codes (N,).

    The middle is the last bit. The others are, from the first one on, four times ten bits, each ten a quarter turn
    further: eight of the outermost row, and the left two of the innermost 3 x 3's upper row.
    """
    bits = (codes[:, None] >> np.arange(40, -1, -1, dtype=np.uint64)) & np.uint64(1) > 0
    cells = np.zeros((len(codes), 9, 9), np.bool_)
    cells[:, 2:7, 2:7] = True
    cells[:, 3:6, 3:6] = False
    for quarter in range(4):
        cells[:, 0, :8], cells[:, 3, 3:5] = bits[:, 10 * quarter :][:, :8], bits[:, 10 * quarter + 8 :][:, :2]
        cells = np.rot90(cells, axes=(1, 2))
    cells[:, 4, 4] = bits[:, 40]
    return np.ascontiguousarray(np.rot90(cells, 2, axes=(1, 2)))


def _dictionary(family: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))


class _BitsInside:
    """Lets OpenCV find and read squares that have all bits inside."""

    def __init__(self, family: str, ids: Sequence[int], parameters: cv2.aruco.DetectorParameters) -> None:
        every = _dictionary(family)
        fleet = cv2.aruco.Dictionary(every.bytesList[list(ids)], every.markerSize, every.maxCorrectionBits)
        self._parameters = parameters
        self._detector = cv2.aruco.ArucoDetector(fleet, parameters)

    def find(self, image: Image) -> Squares:
        self._detector.setDetectorParameters(self._parameters)
        corners, which, _ = self._detector.detectMarkers(image)
        if which is None or len(which) == 0:
            return NO_SQUARES
        return Squares(np.concatenate(corners).astype(np.float64), which[:, 0].astype(np.int64))


class _BitsAround:
    """Finds squares as OpenCV does, and reads the bits inside and around them."""

    def __init__(self, family: str, ids: Sequence[int], parameters: cv2.aruco.DetectorParameters) -> None:
        self._family, self._parameters, self._count = FAMILIES[family], parameters, len(ids)
        turned = [np.rot90(patterns(family)[list(ids)], turns, axes=(1, 2)) for turns in range(4)]
        self._looks = np.where(np.concatenate(turned), 1.0, -1.0).astype(np.float32).reshape(4 * len(ids), -1)
        self._white, self._black = (cells[1:-1, 1:-1].ravel() for cells in same(family))
        at = (np.arange(self._family.cells) - (self._family.cells - 1) / 2.0) / self._family.square + 0.5
        self._grid = np.stack(np.meshgrid(at, at), axis=-1).reshape(1, -1, 2)  # of a square from 0 to 1

    def find(self, image: Image) -> Squares:
        quads = self._quads(dark_squares(image, self._family))
        if not quads:
            return NO_SQUARES
        corners = np.stack(quads)
        cells = self._cells(image, corners)
        white, black = np.median(cells[:, self._white], axis=1), np.median(cells[:, self._black], axis=1)
        bits = np.where(cells > (white + black)[:, None] / 2.0, 1.0, -1.0).astype(np.float32)
        wrong = (bits.shape[1] - bits @ self._looks.T) / 2.0
        best, may = wrong.argmin(1), self._parameters.errorCorrectionRate * ((self._family.distance - 1) // 2)
        found: list[tuple[int, Array]] = []
        for k in np.argsort(wrong.min(1)).tolist():
            if wrong[k, best[k]] > may or white[k] - black[k] < _CONTRAST:
                continue
            turns, which = divmod(int(best[k]), self._count)
            square = corners[k, (np.arange(4) - turns) % 4]
            if not any(which == other and _are_same(square, known) for other, known in found):
                found.append((which, square))
        if not found:
            return NO_SQUARES
        return Squares(np.stack([square for _, square in found]), np.array([which for which, _ in found]))

    def _quads(self, image: Image) -> list[Array]:
        """Return the corners (4, 2) of what is dark, surrounded by light, and has four of them, clockwise [px]."""
        p, longer = self._parameters, max(image.shape)
        least, most = p.minMarkerPerimeterRate * longer, p.maxMarkerPerimeterRate * longer
        quads = []
        for window in range(p.adaptiveThreshWinSizeMin, p.adaptiveThreshWinSizeMax + 1, p.adaptiveThreshWinSizeStep):
            mean, below = cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV
            dark = cv2.adaptiveThreshold(image, 255, mean, below, window, p.adaptiveThreshConstant)
            outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
            for outline in outlines:
                if least < len(outline) < most:
                    polygon = cv2.approxPolyDP(outline, p.polygonalApproxAccuracyRate * len(outline), closed=True)
                    # Outlines go anticlockwise around what is dark, and clockwise around a hole in it.
                    if len(polygon) == 4 and cv2.isContourConvex(polygon) and cv2.contourArea(polygon, True) < 0.0:
                        quads.append(_widened(polygon[::-1, 0].astype(np.float64)))
        return quads

    def _cells(self, image: Image, corners: Array) -> Array:
        """Return the greys (M, C * C) in the middles of the cells of prints whose squares have corners (M, 4, 2)."""
        unit = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
        maps = [cv2.getPerspectiveTransform(unit, square.astype(np.float32)) for square in corners]
        at = np.concatenate([cv2.perspectiveTransform(self._grid, each) for each in maps]).astype(np.float32)
        greys = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(greys, np.float64).reshape(at.shape[:2])


def _widened(corners: Array) -> Array:
    """Return the corners (4, 2) of a square, clockwise, whose outline goes through the middles of its pixels."""
    ahead = np.roll(corners, -1, axis=0) - corners
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1), 1.0)[:, None]
    return np.asarray(corners + 0.5 * (np.roll(ahead, 1, axis=0) - ahead), np.float64)


def _are_same(first: Array, other: Array) -> bool:
    return float(np.linalg.norm(first.mean(0) - other.mean(0))) < _SAME_SQUARE * float(
        np.linalg.norm(first[0] - first[1])
    )

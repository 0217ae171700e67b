"""A ChArUco board, and what an image shows of it."""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array, Image

_RATIO = 0.12  # of the markers' side over a square's, measured against named: small ones are measured too small
_CORNERS = 12  # fewer say little of a view's pose, and are often those of a board that is half out of focus


class BoardView(NamedTuple):
    """The board's M corners in one image."""

    name: str
    points: Array  # (M, 3) [m; board: x along its squares' rows, y down its columns, z = 0]
    pixels: Array  # (M, 2), integer coordinates are pixel centres
    ids: NDArray[np.intp]  # (M,)
    image: Image


class Sight(NamedTuple):
    """What was found in one image, also where it is no view."""

    view: BoardView | None
    markers: tuple[int, ...]  # ids of the dictionary's markers
    marker_ratio: float | None  # their side over a square's, as the corners measure it


@dataclass(frozen=True)
class Board:
    """A board as its print names it; corners are numbered along the rows, from the print's upper left."""

    squares: tuple[int, int] = (11, 8)
    square_m: float = 0.04
    marker_m: float = 0.03
    dictionary: str = "DICT_5X5_250"

    def __post_init__(self) -> None:
        if min(self.squares) < 4:
            raise CalibrationError(f"a board of {self.shown} has too few corners: take 4 x 4 squares or more")
        if not 0.3 * self.square_m <= self.marker_m < self.square_m:
            sizes_mm = f"{self.marker_m * 1e3:g} mm do not fit {self.square_m * 1e3:g}"
            raise CalibrationError(f"markers of {sizes_mm} mm squares")
        if not self.dictionary.startswith("DICT_") or not hasattr(cv2.aruco, self.dictionary):
            known = ", ".join(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
            raise CalibrationError(f"there is no dictionary {self.dictionary}: take one of {known}")
        markers, printed = len(self._dictionary.bytesList), self.squares[0] * self.squares[1] // 2
        if printed > markers:
            needed = f"{self.shown} need {printed} markers, {self.dictionary} has {markers}"
            raise CalibrationError(f"{needed}: take a larger one")

    @property
    def shown(self) -> str:
        return f"{self.squares[0]} x {self.squares[1]} squares"

    @property
    def corners(self) -> Array:
        """Return all inner corners (N, 3) [m; board]."""
        return np.array(self.print.getChessboardCorners(), np.float64)

    @property
    def print(self) -> cv2.aruco.CharucoBoard:
        return cv2.aruco.CharucoBoard(self.squares, self.square_m, self.marker_m, self._dictionary)

    @property
    def _dictionary(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))


class BoardDetector:
    """Finds a board's corners to a fraction of a pixel."""

    def __init__(self, board: Board) -> None:
        self._corners = board.corners
        self._square_m = board.square_m
        self._detector = cv2.aruco.CharucoDetector(board.print)

    def detect(self, name: str, image: Image) -> Sight:
        """Return what a gray image (H, W) shows."""
        found, ids, marker_corners, marker_ids = self._detector.detectBoard(image)
        markers = () if marker_ids is None else tuple(int(i) for i in marker_ids.ravel())
        if ids is None or len(ids) < _CORNERS:
            return Sight(None, markers, None)
        numbers = ids.ravel().astype(np.intp)
        points, pixels = self._corners[numbers], found.reshape(-1, 2).astype(np.float64)
        if np.linalg.matrix_rank(points[:, :2] - points[0, :2], tol=self._square_m) < 2:
            return Sight(None, markers, None)  # one row says nothing of the pose
        ratio = self._ratio(points, pixels, np.concatenate(marker_corners))
        return Sight(BoardView(name, points, pixels, numbers, image), markers, ratio)

    def _ratio(self, points: Array, pixels: Array, marker_corners: NDArray[np.float32]) -> float | None:
        """Return the markers' side over a square's: the corners' homography takes them back to the board."""
        to_board, _ = cv2.findHomography(pixels, points[:, :2])
        if to_board is None:
            return None
        back = cv2.perspectiveTransform(marker_corners.reshape(-1, 1, 2).astype(np.float64), to_board).reshape(-1, 4, 2)
        sides = np.linalg.norm(back - np.roll(back, 1, axis=1), axis=2)
        return float(np.median(sides) / self._square_m)


class BoardCheck:
    """Notices, over many images, that the board is not the one that was named."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._images = self._marked = self._fitting = 0
        self._seen: set[int] = set()
        self._ratios: list[float] = []

    def add(self, sight: Sight) -> None:
        self._images += 1
        self._marked += len(sight.markers) >= _CORNERS
        self._fitting += sight.view is not None
        self._seen.update(sight.markers)
        if sight.marker_ratio is not None:
            self._ratios.append(sight.marker_ratio)

    def faults(self) -> list[str]:
        board, last = self._board, self._board.squares[0] * self._board.squares[1] // 2 - 1
        if not self._seen:
            where = f"{self._images} images"
            return [f"no marker of {board.dictionary} in {where}: was the board in sight, is --dictionary right?"]
        strange = sorted(marker for marker in self._seen if marker > last)
        if len(strange) > last // 4:  # a few may be misread, or of another sheet
            listed = ", ".join(map(str, strange[:5]))
            return [f"markers {listed} ... are not of a board of {board.shown} (0 to {last}): check --squares"]
        if self._fitting < self._marked / 2:
            return [
                f"the markers do not lie as on a board of {board.shown}: in {self._marked - self._fitting} of "
                f"{self._marked} images no corners fit them; check --squares, and that the print is not mirrored"
            ]
        named, measured = board.marker_m / board.square_m, float(np.median(self._ratios or [np.nan]))
        if abs(measured - named) > _RATIO * named:
            return [f"markers measure {measured:.2f} of a square, not {named:.2f}: check --square-mm and --marker-mm"]
        return []

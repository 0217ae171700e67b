"""What a set of views shows of a lens, which images add to it, and which view is missing."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.lens.board import Board, BoardView
from robofleet.calibration.lens.bundle import Fit, inverse, view_information
from robofleet.calibration.lens.floor import Ceiling, FloorErrors
from robofleet.calibration.lens.projection import Lens
from robofleet.core.arrays import Array

COLUMNS, ROWS = 6, 4  # cells of the image
_ENOUGH_CORNERS = 4  # in a cell
_EMPTY_CELLS = 3  # at most, but for the image's corners
_ALIKE_WAY = 0.01  # rms of the corners' way, of the image's diagonal
_STILL_WAY = 0.001  # the same, from one image to the next
_COMMON_CORNERS = 6  # that two views must share to be alike
_TILTED_DEG = 12.0  # of the board against the image's plane; less is flat
_TILTED_VIEWS = 2  # in each direction of a pair
_DEPTH_RATIO = 1.25  # farthest corner over the nearest
_ASKED_DEG = 30.0
_ASKED_WIDTHS = (0.4, 0.7)  # of the board, in image widths
_ASKED_CORNERS = 12  # of a view that is asked for


class Lean(Enum):
    """Which edge of the board is farther from the camera, as the image shows it."""

    FLAT = "-"
    LEFT = "left"
    RIGHT = "right"
    UPPER = "upper"
    LOWER = "lower"


class Offer(Enum):
    """What an image adds."""

    NEW = "used"
    NO_BOARD = "too little of the board"
    ALIKE = "too similar to one that is used"
    MOVING = "the board moves"


class Collector:
    """Picks the views worth having, in the order of their images."""

    def __init__(self, size: tuple[int, int], *, film: bool) -> None:
        """Take the images' (width, height); in a ``film`` a board has to hold still for two images."""
        self._diagonal, self._film = math.hypot(*size), film
        self._before: BoardView | None = None
        self.views: list[BoardView] = []

    def offer(self, view: BoardView) -> Offer:
        before, self._before = self._before, view
        if self._film and (before is None or self._apart(before, view) > _STILL_WAY):
            return Offer.MOVING
        if any(self._apart(used, view) < _ALIKE_WAY for used in self.views):
            return Offer.ALIKE
        self.views.append(view._replace(image=view.image.copy()))  # a camera may use its own again
        return Offer.NEW

    def _apart(self, first: BoardView, other: BoardView) -> float:
        """Return how far the corners are apart that both show, rms, of the diagonal."""
        _, i, j = np.intersect1d(first.ids, other.ids, return_indices=True)
        if len(i) < _COMMON_CORNERS:
            return math.inf
        way = first.pixels[i] - other.pixels[j]
        return float(np.sqrt((way * way).sum(axis=1).mean())) / self._diagonal


def tilt(pose: Array) -> tuple[Lean, float]:
    """Return how a board with a pose (6,) leans, and by which angle [deg]."""
    normal = cv2.Rodrigues(pose[:3])[0][:, 2]
    angle = math.degrees(math.acos(min(1.0, abs(normal[2]))))
    if angle < _TILTED_DEG:
        return Lean.FLAT, angle
    x, y = normal[:2] * np.sign(normal[2])
    if abs(x) > abs(y):
        return (Lean.LEFT if x > 0 else Lean.RIGHT), angle
    return (Lean.UPPER if y > 0 else Lean.LOWER), angle


@dataclass(frozen=True)
class Coverage:
    """Where in the image corners were, how the board leant, and how deep the views reach."""

    corners: Array  # (ROWS, COLUMNS), counts
    leans: Array  # (ROWS, COLUMNS, len(Lean)), of the views that reach the cell
    views: dict[Lean, int]
    depths: float  # farthest corner over the nearest
    needed: NDArray[np.bool_]  # (ROWS, COLUMNS), cells that see the floor that matters

    @classmethod
    def of(cls, fit: Fit, ceiling: Ceiling) -> "Coverage":
        lens = fit.lens
        corners, leans = np.zeros((ROWS, COLUMNS)), np.zeros((ROWS, COLUMNS, len(Lean)))
        counts, depths = dict.fromkeys(Lean, 0), []
        for view, pose in zip(fit.views, fit.poses, strict=True):
            own = cell_counts(lens.size, view.pixels)
            lean, _ = tilt(pose)
            corners += own
            leans[..., list(Lean).index(lean)] += own >= _ENOUGH_CORNERS
            counts[lean] += 1
            depths.append((view.points @ cv2.Rodrigues(pose[:3])[0].T + pose[3:])[:, 2])
        z = np.concatenate(depths)
        slopes = lens.slopes(np.array([_middle(lens, *cell) for cell in np.ndindex(ROWS, COLUMNS)]))
        needed = ceiling.sees(slopes) | (
            np.isnan(slopes[:, 0]) & (lens.kind == "pinhole")
        )  # NaN: the fit is still wild
        depth = float(z.max() / max(z.min(), 1e-9))
        return cls(corners, leans, counts, depth, needed.reshape(ROWS, COLUMNS))

    @property
    def empty(self) -> NDArray[np.bool_]:
        """Return the needed cells (ROWS, COLUMNS) that too few corners fell into: any corner, else more than a few."""
        empty = self.needed & (self.corners < _ENOUGH_CORNERS)
        if empty.sum() <= _EMPTY_CELLS:
            empty[1:-1] = empty[:, 1:-1] = False
        return np.asarray(empty)

    @property
    def missing_leans(self) -> tuple[Lean, ...]:
        """Return the directions that would help: both of a pair that has too few views."""
        pairs = ((Lean.LEFT, Lean.RIGHT), (Lean.UPPER, Lean.LOWER))
        return tuple(lean for pair in pairs if sum(self.views[k] for k in pair) < _TILTED_VIEWS for lean in pair)

    def faults(self) -> list[str]:
        faults = []
        if self.empty.any():
            places = sorted({place(*cell) for cell in np.argwhere(self.empty).tolist()})
            faults.append(f"hardly any corner of the board was {', '.join(places)} of the image")
        for pair, axis in (((Lean.LEFT, Lean.RIGHT), "left or right"), ((Lean.UPPER, Lean.LOWER), "upper or lower")):
            tilted = sum(self.views[lean] for lean in pair)
            if tilted < _TILTED_VIEWS:
                faults.append(
                    f"the {axis} edge was tilted away by {_TILTED_DEG:g} deg in {tilted} views: "
                    f"{_TILTED_VIEWS} or more are needed"
                )
        if self.depths < _DEPTH_RATIO:
            depths = f"the farthest is {self.depths:.2f} times as far as the nearest"
            faults.append(f"all corners are about equally far: {depths}")
        return faults


class Wanted(NamedTuple):
    """The view that would help most."""

    row: int
    column: int
    lean: Lean
    distance_m: float
    rms_mm: float  # over the arena, with it

    def __str__(self) -> str:
        away = f"its {self.lean.value} edge {_ASKED_DEG:g} deg away from the camera"
        how = "flat" if self.lean is Lean.FLAT else away
        return f"show the board {place(self.row, self.column)} of the image, about {self.distance_m:.1f} m away, {how}"


def place(row: int, column: int) -> str:
    vertical = "upper" if row == 0 else "lower" if row == ROWS - 1 else ""
    horizontal = "left" if column == 0 else "right" if column == COLUMNS - 1 else ""
    if vertical and horizontal:
        return f"in the {vertical} {horizontal} corner"
    if vertical or horizontal:
        return f"at the {vertical or horizontal} edge"
    return "in the middle"


def cell_counts(size: tuple[int, int], pixels: Array) -> Array:
    """Return how many pixels (N, 2) fall into each cell (ROWS, COLUMNS) of an image of (width, height)."""
    width, height = size
    bounds = [[-0.5, height - 0.5], [-0.5, width - 0.5]]
    return np.histogram2d(pixels[:, 1], pixels[:, 0], (ROWS, COLUMNS), bounds)[0]


def next_view(fit: Fit, floor: FloorErrors, coverage: Coverage, board: Board) -> Wanted:
    """Return the view, of some all over the image, after which least would be uncertain.

    While parts of the image are empty or a lean is missing, only views that mend that are asked for.
    """
    ranked: list[tuple[bool, bool, float, Wanted]] = []
    for row, column, lean, distance, points, pose in _candidates(fit.lens, board):
        pixels, J_lens, J_pose = fit.lens.project(points, pose)
        covariance = fit.noise_px**2 * inverse(fit.information + view_information(J_lens, J_pose))
        rms_mm = floor.rms_mm(covariance)
        fills = coverage.empty[row, column] and cell_counts(fit.lens.size, pixels)[row, column] >= _ENOUGH_CORNERS
        leans = lean in coverage.missing_leans
        ranked.append((not fills, not leans, rms_mm, Wanted(row, column, lean, distance, rms_mm)))
    if not ranked:  # the lens is still impossible
        return Wanted(0, 0, Lean.LEFT, _distance(fit.lens, board, _ASKED_WIDTHS[0]), math.inf)
    return min(ranked, key=lambda candidate: candidate[:3])[3]


def _candidates(lens: Lens, board: Board) -> list[tuple[int, int, Lean, float, Array, Array]]:
    """Return cell, lean, distance [m], visible corners (M, 3) and pose (6,) of views that can be asked for."""
    width, height = lens.size
    everything, middle = board.corners, board.corners.mean(axis=0)
    turns = [(lean, _turn(lean)) for lean in Lean]
    candidates = []
    for row, column in np.ndindex(ROWS, COLUMNS):
        ray = np.append(lens.slopes(_middle(lens, row, column)[None])[0], 1.0)
        if not np.isfinite(ray).all():
            continue
        for share in _ASKED_WIDTHS:
            distance = _distance(lens, board, share)
            for lean, turn in turns:
                pose = np.concatenate([turn, ray * distance - cv2.Rodrigues(turn)[0] @ middle])
                pixels, _, _ = lens.project(everything, pose)
                inside = ((pixels > 2.0) & (pixels < np.array([width, height]) - 3.0)).all(axis=1)
                if (
                    inside.sum() >= _ASKED_CORNERS
                    and np.linalg.matrix_rank(everything[inside, :2] - everything[inside, :2][0]) == 2
                ):
                    candidates.append((row, column, lean, distance, everything[inside], pose))
    return candidates


def _middle(lens: Lens, row: int, column: int) -> Array:
    """Return a cell's middle (2,) [px]."""
    return np.array([(column + 0.5) * lens.size[0] / COLUMNS, (row + 0.5) * lens.size[1] / ROWS]) - 0.5


def _distance(lens: Lens, board: Board, share: float) -> float:
    """Return from where the board is as wide as a share of the image [m]."""
    return float(lens.values[0] * board.squares[0] * board.square_m / (share * lens.size[0]))


def _turn(lean: Lean) -> Array:
    angle = math.radians(_ASKED_DEG)
    return {
        Lean.FLAT: np.zeros(3),
        Lean.LEFT: np.array([0.0, angle, 0.0]),
        Lean.RIGHT: np.array([0.0, -angle, 0.0]),
        Lean.UPPER: np.array([-angle, 0.0, 0.0]),
        Lean.LOWER: np.array([angle, 0.0, 0.0]),
    }[lean]

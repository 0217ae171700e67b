"""The pictures by which a projector is calibrated: all black, all white, and a grid of tags with its negative.

Each is two greys alone, so that a projector's gamma plays no part. What a camera sees of tags less what it sees of the
negative, over white less black, is the grid by itself: floor, prints and lamps drop out, and an edge stands where it
is whatever the camera's tone curve. Tags say which pixels they are, also where a camera sees a part of the picture;
Gray code would need some twenty pictures in place of these four, and bends with gamma and tone curve.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Image
from robofleet.core.settings import FAMILIES, FamilyName
from robofleet.projection.model import Projector
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.families import pattern
from robofleet.tracking.tags.finder import TagFinder

FAMILY: FamilyName = "36h11"
_ROWS = 9  # of tags; as many columns as fit
_QUIET_CELLS = 2  # between two tags' black squares: white, which a tag needs around it
_LEAST_LIGHT = 8.0  # of white less black, which tells a pixel's share [grey levels]
_SATURATED = 250.0  # of a mean: noise is cut off at 255


@dataclass(frozen=True)
class Grid:
    """A picture full of tags: tag k is the k-th, row by row."""

    size: tuple[int, int]  # width, height [px]

    @property
    def cell_px(self) -> int:
        """Side of a tag's cell."""
        return max(1, min(self.size) // (_ROWS * self._pitch_cells + _QUIET_CELLS))

    @property
    def pitch_px(self) -> int:
        """From a tag to the next one."""
        return self.cell_px * self._pitch_cells

    @property
    def _pitch_cells(self) -> int:
        return FAMILIES[FAMILY].cells + _QUIET_CELLS

    @property
    def corners(self) -> NDArray[np.int64]:
        """Each tag's upper left pixel (M, 2)."""
        counts = [(side - _QUIET_CELLS * self.cell_px) // self.pitch_px for side in self.size]
        starts = [
            (side - count * self.pitch_px + _QUIET_CELLS * self.cell_px) // 2
            for side, count in zip(self.size, counts, strict=True)
        ]
        x, y = (start + self.pitch_px * np.arange(count) for start, count in zip(starts, counts, strict=True))
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)[: FAMILIES[FAMILY].ids]

    @property
    def centres(self) -> Array:
        """Each tag's centre (M, 2) [px]."""
        return self.corners.astype(np.float64) + (FAMILIES[FAMILY].cells * self.cell_px - 1) / 2.0

    @property
    def picture(self) -> Image:
        """The grid, (H, W)."""
        shown = np.full(self.size[::-1], 255, np.uint8)
        for tag, (x, y) in enumerate(self.corners.tolist()):
            drawn = np.kron(pattern(tag, FAMILY), np.ones((self.cell_px, self.cell_px))) > 0
            shown[y : y + len(drawn), x : x + len(drawn)] = 255 * drawn
        return shown

    def pictures(self) -> dict[str, Image]:
        """Return what is shown, by name."""
        tags = self.picture
        return {
            "black": np.zeros_like(tags), "white": np.full_like(tags, 255), "tags": tags, "negative": 255 - tags
        }  # fmt: skip


@dataclass(frozen=True)
class Reading:
    """What one camera sees of a grid."""

    tags: NDArray[np.int64]  # (N,)
    pixels: Array  # (N, 2) of the camera, of their centres
    sigma_px: Array  # (N,) standard deviation of a coordinate
    lit: float  # share of the camera's image in which the projector's light tells
    saturated: float  # share of that in which white is too bright to tell
    over_room: float  # that light over the room's, where it is bright; 0: there is none
    blur_px: float  # standard deviation of an edge's Gaussian, all of projector, lens and pixel; NaN: no tag


def read(grid: Grid, seen: dict[str, Array]) -> Reading:
    """Find a grid's tags in the means (H, W) of the images taken of each of its ``pictures``."""
    light = seen["white"] - seen["black"]
    lit = light > _LEAST_LIGHT
    share = np.where(lit, (seen["tags"] - seen["negative"]) / np.maximum(light, _LEAST_LIGHT), 0.0)
    saturated = float((seen["white"] >= _SATURATED)[lit].mean()) if lit.any() else 0.0
    over_room = float(np.percentile(light[lit] / np.maximum(seen["black"][lit], 1.0), 90.0)) if lit.any() else 0.0
    image = np.asarray(np.clip(np.rint(127.5 + 127.5 * share), 0, 255), np.uint8)
    found = TagFinder(FAMILY, range(len(grid.corners))).find(image) if lit.any() else {}
    once = {tag: prints[0] for tag, prints in found.items() if len(prints) == 1}
    blur_px = _blur_px(share, [reading.corners for reading in once.values()], list(once)) if once else float("nan")
    return Reading(
        np.array(list(once), np.int64),
        np.array([reading.centre for reading in once.values()]).reshape(-1, 2),
        np.array([reading.sigma for reading in once.values()]),
        float(lit.mean()), saturated, over_room, blur_px,
    )  # fmt: skip


def bends(grid: Grid, tags: NDArray[np.int64], camera: CameraGeometry, projector: Projector) -> Array:
    """Return how far from its tags' centres (N, 2) [px] a camera sees the middles of homographies laid over them: the
    lenses of projector and camera bend a tag, and a homography does not."""
    cells = np.arange(FAMILIES[FAMILY].cells + 1) * grid.cell_px - 0.5
    lattice = np.stack(np.meshgrid(cells, cells), axis=-1).reshape(-1, 2)
    off = []
    for corner, centre in zip(grid.corners[tags], grid.centres[tags], strict=True):
        floor = projector.floor(np.vstack([corner + lattice, centre]))
        *seen, middle = camera.project(np.column_stack([floor, np.zeros(len(floor))]))
        laid, _ = cv2.findHomography((corner + lattice - centre) / grid.pitch_px, np.array(seen) - middle)
        off.append(laid[:2, 2] / laid[2, 2])
    return np.array(off).reshape(-1, 2)


def _blur_px(share: Array, squares: list[Array], tags: list[int]) -> float:
    """Return how blurred the edges between cells are: the area in which the share goes from -1/2 to 1/2, over their
    length, is 1.349 standard deviations wide."""
    cells = FAMILIES[FAMILY].cells
    between, widths = np.abs(share) < 0.5, []
    for corners, tag in zip(squares, tags, strict=True):
        shown = np.pad(pattern(tag, FAMILY), 1, constant_values=True)
        edges = int((shown[1:] != shown[:-1]).sum() + (shown[:, 1:] != shown[:, :-1]).sum())
        side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
        middle = corners.mean(axis=0)
        around = middle + (corners - middle) * (cells + _QUIET_CELLS / 2.0) / cells  # with half of the white rim
        mask = np.zeros(share.shape, np.uint8)
        cv2.fillConvexPoly(mask, np.rint(around).astype(np.int32), 1)
        left, top = np.maximum(around.min(axis=0).astype(int), 0)
        right, bottom = around.max(axis=0).astype(int) + 2
        part = slice(top, bottom), slice(left, right)
        widths.append(np.count_nonzero(between[part] & (mask[part] > 0)) / (edges * side / cells) / 1.349)
    return float(np.median(widths))

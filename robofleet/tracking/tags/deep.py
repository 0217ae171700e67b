"""Finds the tags that one threshold misses: faint, blurred, or with a corner or a side covered. It is slow.

What is black is decided by the darkest and brightest greys nearby, where greys are steep, so that no contrast is
expected. A tag lies flat at a known height and has a known size, so one whole side of a black square says where all of
it is: a cover that leaves one side whole leaves the tag to be found. Squares whose paper is brightest beside their rim
come first. Their cells say which target it can be and what hides the others of them; the photometric fit, without the
hidden cells, places it.

The fit's correlation says which tag it is; that of a faint one only once most noise is smoothed away. Blur makes tags
alike: so few cells may then be misread that any other tag of the family has at least two more that are wrong.

A cover may hide so many bits of the code that any two tags of the family still differ by two of those that are seen.
Of the cells that are seen one may be wrong, as a cover's edge may lie on it; no other tag of the family may explain
them nearly as well.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Complex, Image
from robofleet.core.settings import FAMILIES
from robofleet.tracking.tags.detection import CORNERS, Findings, Region, TagSearch
from robofleet.tracking.tags.families import Squares, dark_squares, patterns, same
from robofleet.tracking.tags.photometric import ALIKE, Fit, Found, PhotometricFit, side_px
from robofleet.tracking.tags.targets import Target

_LIKELY = 0.7  # least correlation of a tag that is blurred, faint, or of which each cell is right: white overflows
_BLUR_PX = 0.8  # that takes the noise away, standard deviation
_FINE = 0.27  # no more than so much, where bits are read: more would mix small ones [cells]
_SMALL_PX = 4.0  # cells to whose middles a line does not lead well enough
_STEPS_PX = (1.0, 0.5)  # by which their squares are shifted, one after the other,
_AROUND = np.stack(np.meshgrid([0, -1, 1], [0, -1, 1]), axis=-1).reshape(9, 2)  # to the best of nine places
_NEARBY = 0.45  # how far greys decide what is black: not beyond the paper, where the floor may be brighter [cells]
_LEAST_CONTRAST = 3  # of paper and rim: half of the least that a tag is found with [grey levels]
_LEAST_SLOPE = 2.5  # of an edge: that of 15 levels that are blurred over a pixel; noise of 3.5 makes 2.2 [1/px]
_SOBEL = 128.0  # what OpenCV's of 5 x 5 pixels makes of a slope of 1
_OUTLINE = 2.2  # least outline of what is seen of a tag, where a diagonal step counts as one [sides]
_STRAIGHT = 0.085  # of a side: a line so straight is one
_LONGER = (0.75, 1.25)  # a whole side, over the true one
_SAME = 0.12  # places and headings closer than this are of one square [sides, rad]
_SIDES_AT_ONCE, _SQUARES_AT_ONCE = 1024, 64  # sides whose squares are compared, and squares that are read
_MOST_FAILURES = 6  # squares at once that no target fits: a millisecond each
_RIM = 0.53  # of the cells that are black in all tags, and must be seen: the rim
_PAPER = 0.53  # of those that are white: the paper around it, one cell wide
_ROUGHLY, _AT_LAST = 3, 1  # cells that may be wrong before the fit, and after it: a cover's edge may lie on one
_SHARPER = 0.25  # of what a cell differs from each of its neighbours: blur took it away
_HIDDEN = 0.04  # what a cell costs a cover that hides it; a cell as grey as its level costs one that does not 1
_HIDES = 0.6  # of the rim, or of the paper, that a cover hides and that does not look as if it were seen
_APART_BITS = 2  # bits by which another tag must be worse


class DeepSearch(TagSearch):
    """Finds what ``TagDetector`` misses."""

    def __init__(self, fit: PhotometricFit, targets: Sequence[Target]) -> None:
        self._fit, self._lot = fit, np.random.default_rng(0)
        self._targets = tuple(targets)
        self._sides = np.array([target.side for target in targets])
        sizes = [side_px(fit.geometry, target) for target in targets]
        self._sizes_px = min(sizes), max(sizes)
        self._cell_px = min(sizes) / FAMILIES[fit.family].square
        self._fine_px = min(_BLUR_PX, _FINE * self._cell_px)
        self._kinds = sorted({(target.side, target.height) for target in targets})
        self._family = FAMILIES[fit.family]
        self._grid, self._covers = _grid(self._family.cells + 2, self._family.square), _covers(fit.family)
        self._on_grid = _weights(self._grid)
        self._paper, self._rim = same(fit.family)
        self._free = ~(self._paper | self._rim)[1:-1, 1:-1]
        self._all = patterns(fit.family).astype(np.float32)
        self._white = self._all[[target.tag for target in targets]]
        self._seen = (~self._covers[:, 1:-1, 1:-1]).reshape(len(self._covers), -1).astype(np.float32)
        self._most_misread = (self._family.distance - _APART_BITS) // 2
        self._hidden = int((self._covers[:, 1:-1, 1:-1] & self._free).sum((1, 2)).max())  # bits of a code, at most

    def squares(self, image: Image, region: Region | None = None, bright: float | None = None) -> Squares:
        left, top, right, bottom = region or Region(0, 0, image.shape[1], image.shape[0])
        part = _smooth(image[top:bottom, left:right], _BLUR_PX)
        fine = part if self._fine_px == _BLUR_PX else _smooth(image[top:bottom, left:right], self._fine_px)
        begins, ends = self._edges(dark_squares(part, self._family))
        corner = np.array([left, top], np.float64)
        corners, found = [np.empty((0, 4, 2))], [np.empty(0, np.int64)]
        for side, height in self._kinds if len(begins) else ():
            which = np.flatnonzero([(target.side, target.height) == (side, height) for target in self._targets])
            some = self._lot.permutation(len(begins))[:_SIDES_AT_ONCE]
            centre, psi = self._whole_sides(begins[some] + corner, ends[some] + corner, side, height)
            pixels = self._on_grid @ (self._pixels(centre, psi, side, height, CORNERS) - corner)
            best = np.argsort(-self._likely(_levels(fine, pixels)))
            chosen = best[self._order(len(best))[:_SQUARES_AT_ONCE]]
            centre, psi, pixels = centre[chosen], psi[chosen], pixels[chosen]
            shift = self._shifts(fine, pixels)
            cells = _levels(fine, pixels + shift[:, None]).reshape(-1, *self._rim.shape)
            square, target, turns = self._read(cells, which)
            heading = psi[square] + turns * (math.pi / 2.0)
            others = _apart(centre[square], heading, target, _SAME * side)
            at = self._pixels(centre[square[others]], heading[others], side, height, CORNERS)
            corners.append(at + shift[square[others], None])
            found.append(target[others])
        return Squares(np.concatenate(corners), np.concatenate(found))

    def place(self, image: Image, squares: Squares, known: Complex | None = None) -> Findings:
        """Return what squares of an image are; see ``detect``. A few may fail, then the others wait."""
        tags: list[Found] = []
        worth = np.zeros(len(squares.which))
        failures = 0
        for k in self._order(len(squares.which)).tolist():
            corners, target = squares.corners[k], int(squares.which[k])
            x_y = self._fit.geometry.to_plane(corners, float(self._fit.heights[target]))
            at = x_y[:, 0] + 1j * x_y[:, 1]
            centre = complex(at.mean())
            psi = float(np.angle(((at - centre) * CORNERS.conj()).sum()))
            near = 0.5 * self._sides[target]
            if known is not None and abs(centre - known[target]) < near:
                continue
            if any(tag.target == target and abs(tag.centre - centre) < near for tag in tags):
                continue
            tag = self.near(image, target, centre, psi)
            if tag is not None:
                tags.append(tag)
                worth[k] = 1.0
                continue
            worth[k] = -1.0
            failures += 1
            if failures == _MOST_FAILURES:
                break
        order = np.argsort(-worth, kind="stable")
        return Findings(tuple(tags), 0, Squares(squares.corners[order], squares.which[order]))

    def near(self, image: Image, target: int, centre: complex, psi: float, *, followed: bool = False) -> Found | None:
        """Return a target that is near a guess, whole or partly covered; None if nothing says that it is there.

        followed: it was there in the image before, so that no other tag of the family can be there.
        """
        whole = self._fit.fit(image, np.array([target]), np.array([centre]), np.array([psi]))
        if whole.alike[0] > ALIKE or (whole.alike[0] > _LIKELY and self._is_noisy(image, whole, target)):
            return whole.found(0, target)
        covered = self._covered(image, target, centre, psi, followed=followed)
        if covered is not None or whole.alike[0] < _LIKELY:
            return covered
        blurred = self._fit.blurred(image, target, centre, psi)
        if blurred.alike[0] > ALIKE and self._misread(image, blurred, target) <= self._most_misread:
            return blurred.found(0, target)
        return whole.found(0, target) if self._misread(image, whole, target) == 0 else None

    def _is_noisy(self, image: Image, fit: Fit, target: int) -> bool:
        """Return whether a print looks like its pattern once most of the noise is gone."""
        if self._misread(image, fit, target) > self._most_misread:
            return False
        centre, psi = complex(fit.centre[0]), float(fit.psi[0])
        left, top, right, bottom = self._around(image, target, centre, psi)
        smooth = np.zeros(image.shape, np.uint8)
        smooth[top:bottom, left:right] = _smooth(image[top:bottom, left:right], self._fine_px)
        return bool(self._fit.blurred(smooth, target, centre, psi).alike[0] > ALIKE)

    def _covered(self, image: Image, target: int, centre: complex, psi: float, *, followed: bool) -> Found | None:
        """Return a target near a guess if something covers a part of it."""
        for may_be_wrong in (_ROUGHLY, _AT_LAST):
            cells = self._cells(image, target, centre, psi)
            if cells is None:
                return None
            cover, wrong = self._cover(cells, target)
            if wrong > may_be_wrong or not cover.any():
                return None
            guess = np.array([target]), np.array([centre]), np.array([psi])
            fit = self._fit.fit(image, *guess, hidden=cover[1:-1, 1:-1])
            if fit.alike[0] <= ALIKE:
                return None
            centre, psi = complex(fit.centre[0]), float(fit.psi[0])
            if may_be_wrong == _AT_LAST and not (
                self._hides(cells, cover) and (followed or not self._is_like_another(cells, target, wrong))
            ):
                return None
        return fit.found(0, target)

    # Squares

    def _order(self, count: int) -> NDArray[np.int64]:
        """Return in which order to look at so many of which the most promising ones come first: one of these, one by
        lot, and so on. Thus none waits for ever."""
        both = np.column_stack([np.arange(count), self._lot.permutation(count)]).ravel()
        return both[np.sort(np.unique(both, return_index=True)[1])]

    def _edges(self, image: Image) -> tuple[Array, Array]:
        """Return begins and ends (E, 2) [px] of straight lines with black on their left and about a side long."""
        small, large = self._sizes_px
        reach = max(1, round(_NEARBY * small / self._family.square))
        box = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        darkest, brightest = cv2.erode(image, box), cv2.dilate(image, box)
        below = cv2.compare(image, cv2.addWeighted(darkest, 0.5, brightest, 0.5, 0.0), cv2.CMP_LT)
        steep = cv2.dilate(_steep(image, _LEAST_SLOPE), box)
        black = cv2.medianBlur(cv2.bitwise_and(below, steep), 3)  # specks would be most of the outlines
        outlines, _ = cv2.findContours(black, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        fewest, straight = _OUTLINE * small, max(1.0, _STRAIGHT * small)
        corners = [cv2.approxPolyDP(line, straight, closed=True)[:, 0] for line in outlines if len(line) > fewest]
        if not corners:
            return np.empty((0, 2)), np.empty((0, 2))
        begin = np.concatenate(corners).astype(np.float64)
        following, lasts = np.arange(1, len(begin) + 1), np.cumsum([len(polygon) for polygon in corners])
        following[lasts - 1] = np.concatenate([[0], lasts[:-1]])
        end = begin[following]
        length = np.hypot(*(end - begin).T) + 1.0
        good = (length > 0.7 * small) & (length < 1.4 * large)
        begin, end = begin[good], end[good]
        # Outlines go through the middles of pixels: half a pixel is missing on each side.
        ahead = (end - begin) / np.maximum(np.hypot(*(end - begin).T), 1.0)[:, None]
        outwards = ahead[:, ::-1] * [-1.0, 1.0]  # outlines have their black on the left, as one sees them
        return begin + 0.5 * (outwards - ahead), end + 0.5 * (outwards + ahead)

    def _whole_sides(self, begin: Array, end: Array, side: float, height: float) -> tuple[Complex, Array]:
        """Return centres and headings of the squares, some a quarter turn off, of which these are a side."""
        x_y = self._fit.geometry.to_plane(np.concatenate([begin, end]), height)
        a, b = np.split(x_y[:, 0] + 1j * x_y[:, 1], 2)
        length = np.abs(b - a) / side
        good = (length > _LONGER[0]) & (length < _LONGER[1])
        a, b = a[good], b[good]
        ahead = (b - a) / np.abs(b - a)
        return (a + b) / 2.0 + 1j * ahead * side / 2.0, np.angle(ahead)

    def _pixels(self, centre: Complex, psi: Array, side: float, height: float, points: Complex) -> Array:
        """Return where points (K,) of prints [sides] appear (M, K, 2)."""
        if not len(centre):
            return np.empty((0, len(points), 2))
        at = centre[:, None] + side * np.exp(1j * psi)[:, None] * points
        world = np.stack([at.real, at.imag, np.full(at.shape, height)], axis=-1)
        return self._fit.geometry.project(world.reshape(-1, 3)).reshape(*at.shape, 2)

    # Cells

    def _likely(self, cells: Array) -> Array:
        """Return how much brighter the paper is than the rim, in the spread of both, by a print's cells (..., K)."""
        white, black = cells[..., self._paper.ravel()], cells[..., self._rim.ravel()]
        return np.asarray((white.mean(-1) - black.mean(-1)) / np.sqrt(white.var(-1) + black.var(-1) + 1.0))

    def _shifts(self, image: Image, pixels: Array) -> Array:
        """Return how far off squares, whose cells are at ``pixels`` (M, K, 2), are likelier (M, 2) [px]: a line is not
        good to a small cell."""
        shift, every = np.zeros((len(pixels), 2)), np.arange(len(pixels))
        for step in _STEPS_PX if self._cell_px < _SMALL_PX else ():
            steps = shift + step * _AROUND[:, None]
            at = (pixels + steps[:, :, None]).reshape(-1, *pixels.shape[1:])
            likely = self._likely(_levels(image, at)).reshape(len(_AROUND), -1)
            shift = steps[likely.argmax(0), every]
        return shift

    def _read(self, cells: Array, which: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Return which squares (M,) by their cells (M, C + 2, C + 2) may be which of the targets, turned how often."""
        inner = _sharp(cells)
        white, black = np.median(cells[:, self._paper], axis=1), np.median(cells[:, self._rim], axis=1)
        half = ((white + black) / 2.0)[:, None]
        good = white - black > _LEAST_CONTRAST
        good &= ((cells[:, self._rim] < half).sum(1) >= _RIM * self._rim.sum()) & (
            (cells[:, self._paper] > half).sum(1) >= _PAPER * self._paper.sum()
        )
        square = np.flatnonzero(good)
        bits = (inner[square] > half[square, :, None]).astype(np.float32)
        found: list[tuple[float, int, int, int]] = []
        for turns in range(4):
            turned, theirs = np.rot90(bits, -turns, axes=(1, 2)), self._white[which]
            near = self._differ(turned, theirs) <= _ROUGHLY + self._hidden
            for i in np.flatnonzero(near.any(1)):
                may = np.flatnonzero(near[i])
                wrong = self._wrong(turned[i, None], theirs[may])[0]
                found += [
                    (float(wrong[k]), int(square[i]), int(which[may[k]]), turns)
                    for k in np.flatnonzero(wrong <= _ROUGHLY)
                ]
        rows = np.array(sorted(found), np.int64).reshape(-1, 4)
        return rows[:, 1], rows[:, 2], rows[:, 3].astype(np.float64)

    def _differ(self, bits: NDArray[np.float32], white: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return in how many bits of the code cells (M, C, C) differ from patterns (N, C, C): (M, N)."""
        ours, theirs = bits[:, self._free], white[:, self._free]
        differ: NDArray[np.float32] = ours.sum(1)[:, None] + theirs.sum(1) - 2.0 * ours @ theirs.T
        return differ

    def _wrong(self, bits: NDArray[np.float32], white: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return how many cells (M, C, C) differ from patterns (N, C, C), with the cover that explains most: (M, N)."""
        white = white.reshape(-1, self._seen.shape[1]).T
        wrong, theirs = np.empty((len(bits), white.shape[1]), np.float32), self._seen @ white
        for k, pattern in enumerate(bits.reshape(-1, self._seen.shape[1])):  # every cover in one product
            differ = theirs + (self._seen @ pattern)[:, None] - 2.0 * ((self._seen * pattern) @ white)
            wrong[k] = differ.min(0)
        return wrong

    def _cells(self, image: Image, target: int, centre: complex, psi: float) -> Array | None:
        """Return the cells (C + 2, C + 2) of a print and its paper, 0: black, 1: white; None if it is not there."""
        left, top, right, bottom = self._around(image, target, centre, psi)
        if right < left + 9 or bottom < top + 9:
            return None
        smooth = _smooth(image[top:bottom, left:right], self._fine_px)
        pixels = self._pixels(*self._square(target, centre, psi), self._grid)
        cells = _levels(smooth, pixels - [left, top])[0].reshape(self._rim.shape)
        white = np.pad(self._white[target] > 0.5, 1, constant_values=True)
        low, high = np.median(cells[~white]), np.median(cells[white])
        return None if high - low < _LEAST_CONTRAST else (cells - low) / (high - low)

    def _square(self, target: int, centre: complex, psi: float) -> tuple[Complex, Array, float, float]:
        """Return a target as one of the squares that ``_pixels`` takes."""
        return np.array([centre]), np.array([psi]), float(self._sides[target]), float(self._fit.heights[target])

    def _around(self, image: Image, target: int, centre: complex, psi: float) -> Region:
        """Return the part of an image in which a print and its paper are."""
        pixels = self._pixels(*self._square(target, centre, psi), self._grid)[0]
        left, top = np.maximum(np.floor(pixels.min(0)).astype(int) - 4, 0).tolist()
        right, bottom = np.minimum(np.ceil(pixels.max(0)).astype(int) + 5, image.shape[::-1]).tolist()
        return Region(left, top, right, bottom)

    def _misread(self, image: Image, fit: Fit, target: int) -> int:
        """Return how many cells of a print are not as they should be; all of them if there is no paper around it."""
        cells = self._cells(image, target, complex(fit.centre[0]), float(fit.psi[0]))
        if cells is None or (cells[self._paper] > 0.5).mean() < _PAPER:
            return self._rim.size
        return int(((_sharp(cells[None])[0] > 0.5) != (self._white[target] > 0.5)).sum())

    def _cover(self, cells: Array, target: int) -> tuple[NDArray[np.bool_], int]:
        """Return the cells (C + 2, C + 2) that are hidden, as far as that explains, and how many others are wrong."""
        off = np.abs(cells[1:-1, 1:-1] - self._white[target]).ravel().clip(0.0, 1.0)
        best = int(np.argmin(self._seen @ (off * off) - _HIDDEN * self._seen.sum(1)))
        return self._covers[best], int(self._seen[best] @ (off > 0.5))

    def _is_like_another(self, cells: Array, target: int, wrong: int) -> bool:
        """Return whether another tag of the family explains cells nearly as well, who leaves so many wrong."""
        most = self._family.distance - _APART_BITS  # bits that a cover hides
        for turns in range(4):
            bits = np.rot90(cells[1:-1, 1:-1] > 0.5, turns)
            others = (self._all != bits)[:, self._free].sum(1) < wrong + _APART_BITS + most
            others[self._targets[target].tag] &= turns > 0
            if (
                others.any()
                and self._wrong(bits[None].astype(np.float32), self._all[others]).min() < wrong + _APART_BITS
            ):
                return True
        return False

    def _hides(self, cells: Array, cover: NDArray[np.bool_]) -> bool:
        """Return whether a cover hides anything: else this may be another print, of which some bits are ours."""
        if not cover.any():
            return False
        rim, paper = cells[cover & self._rim], cells[cover & self._paper]
        return bool(max((rim > 0.35).sum() / max(len(rim), 4), (paper < 0.65).sum() / max(len(paper), 4)) >= _HIDES)


def _apart(centre: Complex, psi: Array, target: NDArray[np.int64], same: float) -> list[int]:
    """Return which of squares (M,) are not one with another that comes before: each side of a square finds it."""
    kept: list[int] = []
    left, turned = np.ones(len(centre), np.bool_), np.exp(1j * psi)
    for k in range(len(centre)):
        if left[k]:
            kept.append(k)
            left &= (target != target[k]) | (np.abs(centre - centre[k]) > same) | (np.abs(turned - turned[k]) > _SAME)
    return kept


def _sharp(cells: Array) -> Array:
    """Return the inner cells (M, C, C) of prints and their paper (M, C + 2, C + 2), as if they were less blurred."""
    inner = cells[:, 1:-1, 1:-1]
    beside = cells[:, :-2, 1:-1] + cells[:, 2:, 1:-1] + cells[:, 1:-1, :-2] + cells[:, 1:-1, 2:]
    return inner + _SHARPER * (4.0 * inner - beside)


def _grid(count: int, square: int) -> Complex:
    """Return the middles (count * count,) of the cells of a print and its paper, row by row [sides]."""
    at = (np.arange(count) - (count - 1) / 2.0) / square
    return (at - 1j * at[:, None]).ravel()


def _weights(points: Complex) -> Array:
    """Return how points (K,) of a square [sides] follow from its ``CORNERS`` (K, 4), if it is seen from above."""
    x, y = points.real[:, None], points.imag[:, None]
    return (0.5 + 2.0 * CORNERS.real * x) * (0.5 + 2.0 * CORNERS.imag * y)


def _steep(image: Image, least: float) -> Image:
    """Return where greys change by more than so much from pixel to pixel."""
    across, down = (cv2.Sobel(image, cv2.CV_16S, *axis, ksize=5) for axis in ((1, 0), (0, 1)))
    twice = cv2.add(cv2.convertScaleAbs(across, alpha=2.0 / _SOBEL), cv2.convertScaleAbs(down, alpha=2.0 / _SOBEL))
    return np.asarray(cv2.threshold(twice, 2.0 * least, 255, cv2.THRESH_BINARY)[1], np.uint8)


def _smooth(image: Image, sigma: float) -> Image:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8)


def _levels(image: Image, pixels: Array) -> Array:
    """Return an image's greys (M, K) at pixels (M, K, 2)."""
    if not len(pixels):
        return np.empty(pixels.shape[:2])
    at, none = np.asarray(pixels, np.float32), np.empty(0, np.float32)
    greys = cv2.remap(image, at, none, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(greys, np.float64).reshape(pixels.shape[:2])


def _covers(family: str) -> NDArray[np.bool_]:
    """Return what covers may hide of a print and its paper (K, C + 2, C + 2): nothing, a quarter, all beyond a line."""
    white, black = same(family)
    n = len(white)
    at = np.arange(n) - (n - 1) / 2.0
    covers = [np.zeros((n, n), np.bool_)]
    for size in (n // 2 - 1, n // 2):
        quarter = np.pad(np.ones((size, size), np.bool_), (0, n - size))
        covers += [np.rot90(quarter, turns) for turns in range(4)]
    for angle in np.arange(16) * math.tau / 16.0:
        depth = math.cos(angle) * at + math.sin(angle) * at[:, None]
        covers += [depth > edge for edge in np.arange(depth.max() - 1.0, 0.0, -0.5)]
    bits = np.array([(cover & ~white & ~black).sum() for cover in covers])
    return np.unique(np.stack(covers)[bits <= FAMILIES[family].distance - _APART_BITS], axis=0)

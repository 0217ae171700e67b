"""How a camera shows an edge: blur over the image, tone curve and noise, from the edges of a board's squares.

Each edge between two corners separates a black square from a white one. Along its normal the light rises as a step that
the lens's Gaussian and the pixel's square spread; the tone curve then bends it. In linear light that rise is the same
from both sides, so its asymmetry tells the curve, apart from the width. Common to all edges are the blur in the image's
middle, how much more it is in the corners, and the tone curve; each edge has its two levels, its place and its turn of
its own, which are eliminated (Schur complement). What is left where an edge is flat is noise, by level.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.lens.board import Board, BoardView
from robofleet.calibration.lens.projection import Lens
from robofleet.config.calibrated import ImagingSettings
from robofleet.core.arrays import Array, Image

_REACH_PX = (3.5, 7.0)  # on both sides of an edge: least and most
_LEAST_WAY_PX = 5.0  # along it
_LEAST_CONTRAST = 40.0  # [grey levels]
_SATURATED = (2, 253)  # grey levels that are cut off
_EDGES = (12, 200)  # least and most
_STEPS = 12
_START_PX, _NARROWEST_PX, _WIDEST_PX = 0.8, 0.2, 4.0
_GAMMA = 1.0 / 2.2
_MOST_BEND = math.log(50.0)
_OUTLIER = 2.0  # times the median edge's rms
_SPREAD = 2.5  # standard deviations of a marker's blur
_FLAT = 1.5  # the same from an edge, where its place hardly matters
_LEAST_PIXELS = 200  # that tell noise
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


class _Edge(NamedTuple):
    """Pixels around an edge, M of them."""

    across: Array  # (M,) from where the lens puts the edge, towards white [px]
    along: Array  # (M,) from its middle [half its length]
    gray: Array  # (M,)
    clear: float  # across, where a marker begins [px]
    share: float  # squared distance from the image's middle over that of a corner
    shifts: Array  # (16,) along the normal of parts of a pixel's square [px]

    def without_marker(self, values: Array) -> "_Edge":
        """Return the pixels to which a marker does not spread."""
        near = self.across < self.clear - _SPREAD * (values[0] + values[1] * self.share) - 0.7
        return self._replace(across=self.across[near], along=self.along[near], gray=self.gray[near])

    def sees_white(self, values: Array) -> bool:
        return bool(self.across.max() > _FLAT * (values[0] + values[1] * self.share))


def measure_imaging(lens: Lens, views: Sequence[BoardView], poses: Array, board: Board) -> ImagingSettings | None:
    """Return how the camera shows the board, which views (V) show under poses (V, 6); None where its squares are too
    small, or too few edges are seen."""
    edges = [edge for view, pose in zip(views, poses, strict=True) for edge in _edges(lens, view, pose, board)]
    edges = edges[:: -(-len(edges) // _EDGES[1]) or 1]
    if len(edges) < _EDGES[0]:
        return None
    found = edges
    for _ in range(2):
        values, _ = _fitted(edges)
        edges = [edge for edge in found if edge.without_marker(values).sees_white(values)]
        edges = [edge.without_marker(values) for edge in edges]
        if len(edges) < _EDGES[0]:
            return None
    values, left = _fitted(edges)
    rms = np.array([math.sqrt(float((rest * rest).mean())) for rest in left])
    good = np.flatnonzero(rms <= _OUTLIER * np.median(rms))
    edges = [edges[k] for k in good]
    if len(edges) < _EDGES[0]:
        return None
    values, left = _fitted(edges)
    read, shot = _noise(edges, left, values)
    middle, corner, bend = (float(value) for value in values)
    return ImagingSettings(
        blur_px=round(middle, 3),
        blur_edge_px=round(max(middle + corner, 0.0), 3),
        tone=round(float(_tone(np.array([0.5]), bend)[0]) - 0.5, 3),
        read_noise_gray=None if read is None else round(read, 3),
        shot_noise=None if shot is None else round(shot, 5),
    )


def _edges(lens: Lens, view: BoardView, pose: Array, board: Board) -> Iterator[_Edge]:
    """Yield the edges between a view's corners."""
    columns = board.squares[0] - 1
    corners = dict(zip(view.ids.tolist(), view.points, strict=True))
    square, size = board.square_m, np.array(lens.size)
    for i, start in corners.items():
        for j, step in ((i + 1, np.array([0.0, square, 0.0])), (i + columns, np.array([square, 0.0, 0.0]))):
            if j not in corners or (j == i + 1 and j % columns == 0):
                continue
            end = corners[j]
            # The edge, and a point across it as far as a marker is.
            points = np.array([start, end, 0.5 * (start + end) + 0.5 * (1.0 - board.marker_m / square) * step])
            a, b, off = lens.project(points, pose)[0]
            edge = _edge(view.image, a, b, off, size)
            if edge is not None:
                yield edge


def _edge(image: Image, a: Array, b: Array, off: Array, size: Array) -> _Edge | None:
    """Return the pixels around the edge from ``a`` to ``b``; a marker begins at ``off``."""
    middle, length = 0.5 * (a + b), float(np.linalg.norm(b - a))
    ahead = (b - a) / length
    normal = np.array([-ahead[1], ahead[0]])
    clear = abs(float((off - middle) @ normal))
    reach, half = _REACH_PX[1], 0.5 * length - _REACH_PX[1] - 1.0
    if clear < _REACH_PX[0] or half < _LEAST_WAY_PX:
        return None
    extent = half + reach + 2.0
    first = np.floor(middle - extent).astype(int).clip(0, size)
    last = np.ceil(middle + extent).astype(int).clip(0, size)
    u, v = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    way = np.stack([u, v], axis=-1) - middle
    across, along = way @ normal, way @ ahead
    patch = image[first[1] : last[1], first[0] : last[0]].astype(np.float64)
    between, inside = (np.abs(across) > 2.0) & (np.abs(across) < clear - 1.0), np.abs(along) < half
    if not (between & inside & (across > 0.0)).any() or not (between & inside & (across < 0.0)).any():
        return None
    rise = float(patch[between & inside & (across > 0.0)].mean() - patch[between & inside & (across < 0.0)].mean())
    if abs(rise) < _LEAST_CONTRAST:
        return None
    if rise < 0.0:
        across, normal = -across, -normal
    near = inside & (across > -reach) & (across < min(reach, clear - 2.0))
    gray, across, along = patch[near], across[near], along[near] / half
    if len(gray) < 8 * _LEAST_WAY_PX or gray.min() < _SATURATED[0] or gray.max() > _SATURATED[1]:
        return None
    centre = (size - 1.0) / 2.0
    share = float(((middle - centre) ** 2).sum() / (centre**2).sum())
    shifts = (0.5 * (normal[0] * _NODES[:, None] + normal[1] * _NODES)).ravel()
    return _Edge(across, along, gray, clear, share, shifts)


def _fitted(edges: list[_Edge]) -> tuple[Array, list[Array]]:
    """Return blur in the middle, what is more in the corners [px] and the tone curve's bend, and what is left of each
    edge's greys, by Gauss and Newton."""
    values, damping = np.array([_START_PX, 0.0, 0.5]), 1e-3
    own = [np.array([edge.gray.min(), edge.gray.max(), 0.0, 0.0]) for edge in edges]
    least, left = math.inf, list[Array]()
    kept = values, own
    products: list[tuple[Array, Array, Array, Array, Array]] = []
    for _ in range(_STEPS):
        shown = [_shown(edge, values, mine) for edge, mine in zip(edges, own, strict=True)]
        squares = sum(float((rest * rest).sum()) for rest, _ in shown)
        if squares < least:
            done = least - squares < 1e-5 * squares
            least, left, kept, damping = squares, [rest for rest, _ in shown], (values, own), damping / 5.0
            products = [
                (
                    J[:, :3].T @ J[:, :3],
                    J[:, :3].T @ J[:, 3:],
                    J[:, 3:].T @ J[:, 3:],
                    J[:, :3].T @ rest,
                    J[:, 3:].T @ rest,
                )
                for rest, J in shown
            ]
            if done:
                break
        else:
            damping *= 10.0
        values, own = _step(*kept, products, damping)
    return kept[0], left


def _step(
    values: Array, own: list[Array], products: list[tuple[Array, Array, Array, Array, Array]], damping: float
) -> tuple[Array, list[Array]]:
    """Return the common values and each edge's after a damped step."""
    information, pull = np.zeros((3, 3)), np.zeros(3)
    solved = []
    for A, B, C, a, c in products:
        damped = C + damping * np.diag(np.diag(C)) + 1e-9 * np.eye(4)
        by_values, by_rest = np.linalg.solve(damped, B.T), np.linalg.solve(damped, c)
        information += A - B @ by_values
        pull += a - B @ by_rest
        solved.append((by_values, by_rest))
    step = np.linalg.solve(information + (damping + 1e-9) * np.diag(np.diag(information)) + 1e-9 * np.eye(3), pull)
    moved = values + np.clip(step, -0.5, 0.5)
    moved[0] = np.clip(moved[0], _NARROWEST_PX, _WIDEST_PX)
    moved[2] = np.clip(moved[2], 0.0, _MOST_BEND)
    step = moved - values
    return moved, [mine + by_rest - by_values @ step for mine, (by_values, by_rest) in zip(own, solved, strict=True)]


def _shown(edge: _Edge, values: Array, own: Array) -> tuple[Array, Array]:
    """Return what is left of an edge's greys (M,), and how its greys change (M, 7) with the three common values and
    with its black, white, place and turn [px]."""
    black, white, shift, turn = own
    sigma = max(values[0] + values[1] * edge.share, _NARROWEST_PX)
    at = (edge.across - shift - turn * edge.along)[:, None] + edge.shifts
    weights = 0.25 * np.outer(_WEIGHTS, _WEIGHTS).ravel()
    z = at / sigma
    density = np.exp(-0.5 * z * z) / math.sqrt(math.tau)
    light = np.clip(_below(z) @ weights, 0.0, 1.0)
    steep, wider = density @ weights / sigma, -(z * density) @ weights / sigma
    h = 1e-4
    share = _tone(light, values[2])
    slope = (_tone(np.minimum(light + h, 1.0), values[2]) - _tone(np.maximum(light - h, 0.0), values[2])) / (
        np.minimum(light + h, 1.0) - np.maximum(light - h, 0.0)
    )
    bent = (_tone(light, values[2] + h) - share) / h
    contrast = white - black
    J = np.column_stack(
        [
            contrast * slope * wider, contrast * slope * wider * edge.share, contrast * bent, 1.0 - share, share,
            -contrast * slope * steep, -contrast * slope * steep * edge.along,
        ]
    )  # fmt: skip
    return edge.gray - black - contrast * share, J


def _tone(light: Array, bend: float) -> Array:
    """Return which share of the way from black to white (M,) a camera shows for a share of the light.

    It raises light to ``_GAMMA``; of that, black and white take a part, the more of it the darker black is: white over
    black is exp(bend). 0 is linear.
    """
    ratio = math.expm1(max(bend, 1e-6))
    shown: Array = ((1.0 + ratio * light) ** _GAMMA - 1.0) / ((1.0 + ratio) ** _GAMMA - 1.0)
    return shown


def _below(z: Array) -> Array:
    """Return the normal distribution's integral, to 1e-7 (Abramowitz and Stegun, 7.1.26)."""
    x = np.abs(z) / math.sqrt(2.0)
    t = 1.0 / (1.0 + 0.3275911 * x)
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    above = 0.5 * tail * np.exp(-x * x)
    below: Array = np.where(z > 0.0, 1.0 - above, above)
    return below


def _noise(edges: list[_Edge], left: list[Array], values: Array) -> tuple[float | None, float | None]:
    """Return the read noise [grey levels] and by how much its variance grows with each level, where edges are flat."""
    rows: list[tuple[float, float, int]] = []
    for edge, rest in zip(edges, left, strict=True):
        flat = _FLAT * (values[0] + values[1] * edge.share)
        for side in (edge.across > flat, edge.across < -flat):
            count = int(np.count_nonzero(side))
            if count > 8:
                rows.append((float(edge.gray[side].mean()), float((rest[side] ** 2).sum()) / (count - 2), count))
    if sum(count for _, _, count in rows) < _LEAST_PIXELS:
        return None, None
    gray, variance, count = np.array(rows).T
    weights: NDArray[np.float64] = count.copy()
    design = np.column_stack([np.ones_like(gray), gray])
    solution = np.zeros(2)
    for _ in range(3):
        solution = np.linalg.lstsq(design * np.sqrt(weights)[:, None], variance * np.sqrt(weights), rcond=None)[0]
        weights = count / np.maximum(design @ solution, 0.05) ** 2
    return math.sqrt(max(solution[0], 0.0)), float(solution[1])

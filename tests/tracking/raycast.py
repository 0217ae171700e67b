"""An independent camera, slow and physical: ray-cast prints under a whole camera model, for figures one can believe.

Nothing here is shared with the tracker or the simulated camera. Each pixel is cut into 6 x 6 sub-samples; each is cast
as a ray through the lens (distortion inverted by Newton's method) onto the print's own plane, at its own instant of the
exposure, which a rolling shutter shifts from row to row. The print is made of sharp black and white squares on paper,
averaged exactly over the sub-sample's footprint. The lens's Gaussian spreads the sub-samples; a disc of defocus and the
pixel's square gather them. Then come uneven light, shot and read noise, clipping and 8 bits. Around the prints lies a
floor of clutter at z = 0.

A print's forward is its right and its left its top, with the pattern upright as OpenCV draws it. Times count from the
instant at which the image's middle row is in mid-exposure. Grey levels are linear in the light.
"""

import functools
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import ArrayLike, NDArray

from tests.tracking.library import drawn
from tests.tracking.raycamera import RayCamera

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

BLACK, WHITE = 25.0, 215.0  # of the print under full light
SQUARES = {"36h11": (8, 8), "Standard41h12": (9, 5)}  # cells along the print, and along the square that has its side
_SUB = 6  # sub-samples along a pixel
_NODES = 8  # along a patch: between them, where rays meet a plane is a polynomial to better than a nanometre
_TAIL = 5.0  # standard deviations of the lens's Gaussian, beyond which nothing is left
_INSTANT_PX = 0.25  # motion that a sub-sample averages with one instant drawn from it


class Cable(NamedTuple):
    """A straight strip across a print; it ends with the print's surroundings."""

    forward: float  # of a point under it, from the centre of the print at time 0 [m; print]
    left: float
    angle: float  # of its run, from the print's forward at time 0 [rad]
    width: float  # [m]
    above: float  # the print [m]
    grey: float


class Print(NamedTuple):
    """A tag that moves with a constant twist."""

    tag: int
    side: float  # of its square [m]
    height: float  # above the floor [m]
    pose: tuple[float, float, float]  # x, y [m], psi [rad; CCW +] of its centre at time 0, world
    twist: tuple[float, float, float] = (0.0, 0.0, 0.0)  # forward, left [m/s], turn [rad/s; CCW +]
    cable: Cable | None = None
    family: str = "36h11"
    greys: tuple[float, float] = (BLACK, WHITE)
    tilt: tuple[float, float] = (0.0, 0.0)  # how far its forward, and its left, rise above the horizontal [rad]


class Patch(NamedTuple):
    """What stands before the floor in a rectangle of the image."""

    where: tuple[slice, slice]  # rows, columns
    cover: Floats  # how much of each pixel is print or cable
    light: Floats  # their grey times that, under full light


def along(pose: tuple[float, float, float], twist: tuple[float, float, float], t: ArrayLike) -> tuple[Array, ...]:
    """Return x, y, psi at times ``t`` [s] of what moves with a constant twist in its own frame."""
    turn = twist[2] * np.asarray(t)
    reach = t * np.sinc(turn / (2.0 * math.pi))  # the chord of an arc, per unit of its length
    c, s = np.cos(pose[2] + turn / 2.0), np.sin(pose[2] + turn / 2.0)
    x = pose[0] + reach * (c * twist[0] - s * twist[1])
    y = pose[1] + reach * (s * twist[0] + c * twist[1])
    return x, y, pose[2] + turn


def instant(camera: RayCamera, tag: Print) -> float:
    """Return when the row that shows the centre of a print is in mid-exposure [s]."""
    t = 0.0
    for _ in range(4):
        x, y, _psi = along(tag.pose, tag.twist, t)
        t = float(camera.row_time(camera.project(np.array([[x, y, tag.height]]))[0, 1]))
    return t


class RayCaster:
    """Makes images of one camera: a fixed floor, and prints above it."""

    def __init__(self, camera: RayCamera, floor: Floats, rng: np.random.Generator) -> None:
        """Take the floor's greys as this camera sees them under full light, (H, W)."""
        self.camera, self.floor, self._rng = camera, floor, rng
        self.lamps = _lamps(camera.size)
        self._lens, self._gather = _gaussian(camera.lens_sigma_px * _SUB), _gather(camera.defocus)
        self._spread = math.ceil(_TAIL * camera.lens_sigma_px)  # of a point by the lens [px]

    def image(self, prints: Iterable[Print], level: float, noise: float) -> NDArray[np.uint8]:
        """Return a picture (H, W) under ``level`` of the full light.

        ``noise`` is its standard deviation at grey 128, half of that variance from the light's quanta, so that less
        light has less noise.
        """
        return self.exposed(self.light(prints) * np.float32(level), noise)

    def exposed(self, light: Floats, noise: float) -> NDArray[np.uint8]:
        """Return a picture of the greys ``light`` (H, W); see ``image``."""
        if noise:
            sigma = noise * np.sqrt(0.5 + light * np.float32(0.5 / 128.0))
            light = light + sigma * self._rng.standard_normal(light.shape, dtype=np.float32)
        return np.rint(light.clip(0.0, 255.0)).astype(np.uint8)

    def light(self, prints: Iterable[Print]) -> Floats:
        """Return the greys (H, W) under full light, uneven as it is, without noise, clipping and rounding."""
        light = self.floor.copy()
        for patch in map(self.patch, prints):
            light[patch.where] *= 1.0 - patch.cover
            light[patch.where] += patch.light
        return light * self.lamps

    def patch(self, tag: Print) -> Patch:
        """Cast the rays around one print."""
        camera = self.camera
        x, y, psi = along(tag.pose, tag.twist, instant(camera, tag))
        cells, cell = _cells(tag)
        rim = 0.5 * cells * cell * np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
        c, s = math.cos(psi), math.sin(psi)
        corners = camera.project(np.column_stack([rim @ [[c, s], [-s, c]] + [x, y], np.full(4, tag.height)]))
        middle = corners.mean(0)
        ahead = np.diff(
            camera.on_plane(middle + np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]]), tag.height), axis=0
        )
        pixel = math.sqrt(abs(ahead[0, 0] * ahead[2, 1] - ahead[0, 1] * ahead[2, 0]))  # on the print's plane [m]
        # Of its quickest point [px/s].
        speed = (math.hypot(*tag.twist[:2]) + 0.72 * cells * cell * abs(tag.twist[2])) / pixel
        smear = speed * (camera.exposure + 2.0 * np.ptp(corners[:, 1]) * camera.line_time)
        first = np.floor(corners.min(0) - smear - self._spread - 2.0).astype(int).clip(0, camera.size)
        last = np.ceil(corners.max(0) + smear + self._spread + 3.0).astype(int).clip(0, camera.size)
        if (first >= last).any():
            none = np.zeros((0, 0), np.float32)
            return Patch((slice(0, 0), slice(0, 0)), none, none)
        more = self._spread + 1  # pixels on every side: what lens and defocus bring from there
        u, v = ((np.arange((b - a + 2 * more) * _SUB) + 0.5) / _SUB + a - more - 0.5
                for a, b in zip(first, last, strict=True))  # fmt: skip
        # What an edge's sub-sample averages is the run of its way across it, so that no step is left at any angle.
        edge = np.abs(corners[1] - corners[0])
        footprint = pixel / _SUB * float(edge.max() / np.hypot(*edge))
        cover, light = self._exposed(tag, u, v, footprint, max(1, math.ceil(speed * camera.exposure / _INSTANT_PX)))
        where = slice(first[1], last[1]), slice(first[0], last[0])
        return Patch(where, self._gathered(cover), self._gathered(light))

    def _exposed(self, tag: Print, u: Array, v: Array, footprint: float, instants: int) -> tuple[Floats, Floats]:
        """Return cover and light of the sub-samples in columns ``u`` and rows ``v``, averaged over the exposure."""
        x, y = self._meet(u, v, tag.height, tag.pose, tag.tilt)
        strip = None if tag.cable is None else self._cable(tag, tag.cable, u, v, footprint)
        rows, columns = np.arange(len(v))[:, None], np.arange(len(u))
        scatter = np.modf(0.7548776662466927 * columns + 0.5698402909980532 * rows)[0].astype(
            np.float32
        )  # even, no grid
        begun = self.camera.row_time(v).astype(np.float32)[:, None] - np.float32(0.5 * self.camera.exposure)
        cover, light = np.zeros_like(x), np.zeros_like(x)
        for k in range(instants):
            t = begun + (k + scatter) * np.float32(self.camera.exposure / instants)
            seen = self._seen(tag, x, y, t, footprint)
            cover += seen[0] / np.float32(instants)
            light += seen[1] / np.float32(instants)
        if strip is not None and tag.cable is not None:
            cover, light = cover + strip - cover * strip, light + strip * (np.float32(tag.cable.grey) - light)
        return cover, light

    def _seen(self, tag: Print, x: Floats, y: Floats, t: Floats, footprint: float) -> tuple[Floats, Floats]:
        """Return how much of each sub-sample's footprint is paper, and its grey, averaged over a square."""
        at_x, at_y, psi = along((0.0, 0.0, tag.pose[2]), tag.twist, t)
        c, s, d_x, d_y = np.cos(psi), np.sin(psi), x - at_x, y - at_y
        cells, cell = _cells(tag)
        half = 0.5 * cells
        forward, left = _on_print(c * d_x + s * d_y, c * d_y - s * d_x, tag.tilt)
        column, row = half + forward / cell, half - left / cell
        right, to_right, on_x = _edges(column, footprint / cell, cells)
        below, to_below, on_y = _edges(row, footprint / cell, cells)
        look = np.pad(
            np.where(_white(tag.tag, tag.family), tag.greys[1], tag.greys[0]), 2, constant_values=tag.greys[1]
        )
        look = look.astype(np.float32)
        here, wide = look.ravel(), look.shape[1]
        at = below * wide + right
        above = here[at] + to_right * (here[at + 1] - here[at])
        at += wide
        under = here[at] + to_right * (here[at + 1] - here[at])
        cover = on_x * on_y
        return cover, cover * (above + to_below * (under - above))

    def _cable(self, tag: Print, cable: Cable, u: Array, v: Array, footprint: float) -> Floats:
        """Return how much of each sub-sample is cable."""
        x, y = self._meet(u, v, tag.height + cable.above, tag.pose)
        c, s = math.cos(tag.pose[2]), math.sin(tag.pose[2])
        run = tag.pose[2] + cable.angle
        d_x, d_y = x - (c * cable.forward - s * cable.left), y - (s * cable.forward + c * cable.left)
        away = np.abs(math.cos(run) * d_y - math.sin(run) * d_x)
        return np.clip((0.5 * cable.width - away) / footprint + 0.5, 0.0, 1.0)

    def _meet(
        self, u: Array, v: Array, height: float, origin: tuple[float, float, float],
        tilt: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[Floats, Floats]:  # fmt: skip
        """Return x, y (V, U) from ``origin`` [m] where the rays of columns ``u`` and rows ``v`` meet a plane."""
        nodes = np.cos(math.pi * (np.arange(_NODES) + 0.5) / _NODES)
        to_nodes = np.linalg.inv(chebvander(nodes, _NODES - 1))

        def span(at: Array) -> tuple[Array, Array]:
            middle, half = (at[0] + at[-1]) / 2.0, (at[-1] - at[0]) / 2.0
            return middle + half * nodes, chebvander((at - middle) / half, _NODES - 1) @ to_nodes

        (u_nodes, from_u), (v_nodes, from_v) = span(u), span(v)
        pixels = np.stack(np.meshgrid(u_nodes, v_nodes), axis=-1).reshape(-1, 2)
        point = self.camera.on_plane(pixels, height)
        for _ in range(6 if any(tilt) else 0):  # each brings it a hundred times nearer
            point = self.camera.on_plane(pixels, height + _rise(point - origin[:2], origin[2], tilt))
        x, y = point.T.reshape(2, _NODES, _NODES)
        # On a busy machine BLAS's threads wait for each other longer than such a product takes: einsum has none.
        x = np.einsum("vi,ui->vu", from_v @ (x - origin[0]), from_u)
        y = np.einsum("vi,ui->vu", from_v @ (y - origin[1]), from_u)
        return x.astype(np.float32), y.astype(np.float32)

    def _gathered(self, fine: Floats) -> Floats:
        """Return the pixels (h, w) of sub-samples (6 (h + 2 n), 6 (w + 2 n)), n being 1 more than the lens spreads.

        Six sub-samples' squares are a pixel's, and a Gaussian sampled so finely is as good as the integral over it.
        """
        if self._spread:
            cut = self._spread * _SUB
            fine = cv2.sepFilter2D(fine, cv2.CV_32F, self._lens, self._lens)[cut:-cut, cut:-cut]
        h, w = fine.shape[0] // _SUB, fine.shape[1] // _SUB
        blocks = fine.reshape(h, _SUB, w, _SUB).transpose(0, 2, 1, 3).reshape(h, w, _SUB * _SUB) @ self._gather
        pixels = np.zeros((h - 2, w - 2), np.float32)
        for k in range(9):
            pixels += blocks[k // 3 : k // 3 + h - 2, k % 3 : k % 3 + w - 2, k]
        return pixels


def _on_print(forward: Any, left: Any, tilt: tuple[float, float]) -> tuple[Any, Any]:
    """Return where on a tilted print points lie whose horizontal way from its centre is given."""
    left = left / math.cos(tilt[1])
    return (forward + left * (math.sin(tilt[0]) * math.sin(tilt[1]))) / math.cos(tilt[0]), left


def _rise(way: Array, psi: float, tilt: tuple[float, float]) -> Array:
    """Return how far points (N, 2) of a tilted print lie above its centre, from their horizontal way from it [m]."""
    c, s = math.cos(psi), math.sin(psi)
    forward, left = _on_print(way @ [c, s], way @ [-s, c], tilt)
    return np.asarray(forward * math.sin(tilt[0]) + left * (math.cos(tilt[0]) * math.sin(tilt[1])), np.float64)


def clutter(size: tuple[int, int], rng: np.random.Generator, lens_sigma_px: float = 0.6) -> Floats:
    """Return a floor (H, W) behind a lens: mottled, with lines, tape, and squares that are no tags."""
    width, height = size
    coarse = rng.normal(120.0, 25.0, (height // 40 + 2, width // 40 + 2)).astype(np.float32)
    floor = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    for _ in range(60):
        a, b = rng.uniform(0.0, size, (2, 2)).astype(int).tolist()
        cv2.line(floor, a, b, rng.uniform(20.0, 220.0), int(rng.integers(1, 6)), cv2.LINE_AA)
    for _ in range(60):
        side = rng.uniform(10.0, 60.0)
        box = cv2.boxPoints((tuple(rng.uniform(0.0, size)), (side, side), rng.uniform(0.0, 90.0)))
        cv2.fillConvexPoly(floor, box.astype(int), rng.uniform(10.0, 220.0), cv2.LINE_AA)
    floor += rng.normal(0.0, 4.0, floor.shape).astype(np.float32)
    return cv2.GaussianBlur(floor, (0, 0), lens_sigma_px).clip(5.0, 230.0)


def _lamps(size: tuple[int, int]) -> Floats:
    """Return the uneven light (H, W): bright up left, three quarters of that in the far corner."""
    width, height = size
    u, v = np.arange(width, dtype=np.float32) / width - 0.3, np.arange(height, dtype=np.float32)[:, None] / width
    v -= 0.4 * height / width
    return np.float32(1.0) - np.float32(0.4) * (u * u + v * v)


def _edges(at: Floats, width: float, cells: int) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return the cell before the nearest border of cells, how far beyond it, and how much lies on the paper."""
    border = np.rint(at).clip(0, cells)
    beyond = np.clip((at - border) / width + 0.5, 0.0, 1.0)
    paper = np.clip(np.minimum(at, cells - at) / width + 0.5, 0.0, 1.0)
    return border.astype(np.int64), beyond, paper


def _gaussian(sigma: float) -> Floats:
    """Return the weights (N,) of a Gaussian at whole numbers, N odd; of a standard deviation of 0: 1."""
    at = np.arange(-math.ceil(_TAIL * sigma), math.ceil(_TAIL * sigma) + 1)
    weights = np.exp(-0.5 * (at / max(sigma, 1e-9)) ** 2)
    return (weights / weights.sum()).astype(np.float32)


def _gather(defocus: float) -> Floats:
    """Return the weights (36, 9) of a pixel's sub-samples for itself and its neighbours: disc and square, convolved."""
    if not 0.0 <= defocus <= 1.0:
        raise ValueError(f"defocus {defocus} px: between 0 and 1")
    k = np.arange(4000)
    radius, angle = defocus * np.sqrt((k + 0.5) / len(k)), k * math.pi * (3.0 - math.sqrt(5.0))
    # Sub-samples of the pixel before, of the pixel itself, and of the one after it, from its centre.
    inside = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    away = inside[:, None] + [-1.0, 0.0, 1.0]
    on_u = np.abs(away[..., None] + radius * np.cos(angle)) < 0.5
    on_v = np.abs(away[..., None] + radius * np.sin(angle)) < 0.5
    weights = np.einsum("iak,jbk->ijab", on_v.astype(np.float32), on_u.astype(np.float32)).reshape(_SUB * _SUB, 9)
    return weights / weights.sum()


def _cells(tag: Print) -> tuple[int, float]:
    """Return how many cells lie along the paper, which has a white one on each side, and how large they are [m]."""
    cells, square = SQUARES[tag.family]
    return cells + 2, tag.side / square


@functools.cache
def _white(tag: int, family: str) -> NDArray[np.bool_]:
    """Return the white cells of a print: as OpenCV draws it, or as the AprilTag library does, half a turn further."""
    cells = SQUARES[family][0]
    if hasattr(cv2.aruco, f"DICT_APRILTAG_{family}"):
        known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family}"))
        return np.asarray(known.generateImageMarker(tag, cells) > 0)
    return np.rot90(drawn(tag, family), 2)

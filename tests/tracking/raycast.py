"""An independent camera, slow and physical: ray-cast prints under a whole camera model, for figures one can believe.

Nothing here is shared with the tracker or the simulated camera. Each pixel is cut into 6 x 6 sub-samples; each is cast
as a ray through the lens (distortion inverted by Newton's method) onto the print's own plane, at its own instant of the
exposure, which a rolling shutter shifts from row to row. The print is made of sharp black and white squares on paper,
averaged exactly over the sub-sample's footprint. A disc of defocus and the lens's Gaussian spread the sub-samples, and
the pixel's square gathers them. Then come uneven light, shot and read noise, clipping and 8 bits; ``sensor.py`` has
other cameras. Around the prints lies a floor of clutter at z = 0.

A print's forward is its right and its left its top, with the pattern upright as OpenCV draws it. Times count from the
instant at which the image's middle row is in mid-exposure. Grey levels are linear in the light.
"""

import functools
import math
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numba
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
_ARC = 64.0 / 6.0  # a parabola's length from its top, past its run: so many times sag^2 run^3 / chord^4
_TAIL = 4.0  # standard deviations of the lens's Gaussian, beyond which nothing is left
_INSTANT_PX = 0.25  # motion that a sub-sample averages with one instant drawn from it
_SIGMAS = np.linspace(-6.0, 6.0, 2401)
_BEYOND = np.array([0.5 * math.erfc(at / math.sqrt(2.0)) for at in _SIGMAS.tolist()])  # of a normal distribution


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
    stretch: tuple[float, float] = (0.0, 0.0)  # of the paper along its forward, and its left, by the printer [shares]
    bow: float = 0.0  # how far the middles of its front and rear edges lie below its centre: a cylinder's part [m]


class Shadow(NamedTuple):
    """Straight bands of shade over all that the camera sees, at rest in the image."""

    softness: float  # standard deviation of the Gaussian that blurs their edges, before the lens does [px]
    depth: float = 0.5  # share of the light that is missing
    width: float = 60.0  # from an edge to the next [px]
    angle: float = 0.4  # from the image's right to the edges' normal [rad]

    def gain(self, u: Array, v: Array) -> Floats:
        """Return the light (V, U) in columns ``u`` and rows ``v``; 1: no shade."""
        across = math.cos(self.angle) * u + math.sin(self.angle) * v[:, None]
        lit = np.abs(np.mod(across, 2.0 * self.width) - self.width) - 0.5 * self.width  # from the nearest edge
        return (1.0 - self.depth * np.interp(lit / self.softness, _SIGMAS, _BEYOND)).astype(np.float32)


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

    def __init__(
        self, camera: RayCamera, floor: Floats, rng: np.random.Generator, shadow: Shadow | None = None
    ) -> None:
        """Take the floor's greys as this camera sees them under full light, (H, W)."""
        self.camera, self._rng, self._shadow = camera, rng, shadow
        self.floor = floor if shadow is None else floor * shadow.gain(*map(np.arange, camera.size))
        self.lamps = _lamps(camera.size)
        self._disc, self._taps = _disc(camera.defocus * _SUB), _taps(camera.lens_sigma_px * _SUB)
        # Pixels around a patch from which light comes into it.
        self._spread = math.ceil(len(self._taps) / (2 * _SUB) + camera.defocus)

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
        spread = self._spread
        first = np.floor(corners.min(0) - smear - spread - 2.0).astype(int).clip(0, camera.size)
        last = np.ceil(corners.max(0) + smear + spread + 3.0).astype(int).clip(0, camera.size)
        if (first >= last).any():
            none = np.zeros((0, 0), np.float32)
            return Patch((slice(0, 0), slice(0, 0)), none, none)
        u, v = (
            (np.arange((b - a + 2 * spread) * _SUB) + 0.5) / _SUB + a - spread - 0.5
            for a, b in zip(first, last, strict=True)
        )
        # A sub-sample's square, seen along the image's axis that crosses an edge best: so the lattice leaves no steps.
        edge = np.abs(corners[1] - corners[0])
        footprint = pixel / _SUB * float(edge.max() / np.hypot(*edge))
        cover, light = self._exposed(tag, u, v, footprint, max(1, math.ceil(speed * camera.exposure / _INSTANT_PX)))
        where = slice(first[1], last[1]), slice(first[0], last[0])
        return Patch(where, self._gathered(cover), self._gathered(light))

    def _exposed(self, tag: Print, u: Array, v: Array, footprint: float, instants: int) -> tuple[Floats, Floats]:
        """Return cover and light of the sub-samples in columns ``u`` and rows ``v``, averaged over the exposure."""
        x, y = self._meet(u, v, tag.height, tag)
        begun = self.camera.row_time(v) - 0.5 * self.camera.exposure
        look = np.where(_white(tag.tag, tag.family), tag.greys[1], tag.greys[0])
        look = np.pad(look, 2, constant_values=tag.greys[1]).astype(np.float32)
        cover, light = np.zeros_like(x), np.zeros_like(x)
        _expose(
            x, y, begun, self.camera.exposure / instants, instants, np.array([tag.pose[2], *tag.twist]),
            np.array([*tag.tilt, *tag.stretch, _ARC * tag.bow**2 / tag.side**4]), look, _cells(tag)[1], footprint,
            cover, light,
        )  # fmt: skip
        if tag.cable is not None:
            strip = self._cable(tag, tag.cable, u, v, footprint)
            cover, light = cover + strip - cover * strip, light + strip * (np.float32(tag.cable.grey) - light)
        if self._shadow is not None:
            light *= self._shadow.gain(u, v)
        return cover, light

    def _cable(self, tag: Print, cable: Cable, u: Array, v: Array, footprint: float) -> Floats:
        """Return how much of each sub-sample is cable."""
        x, y = self._meet(u, v, tag.height + cable.above, tag._replace(tilt=(0.0, 0.0), bow=0.0))
        c, s = math.cos(tag.pose[2]), math.sin(tag.pose[2])
        run = tag.pose[2] + cable.angle
        d_x, d_y = x - (c * cable.forward - s * cable.left), y - (s * cable.forward + c * cable.left)
        away = np.abs(math.cos(run) * d_y - math.sin(run) * d_x)
        return np.clip((0.5 * cable.width - away) / footprint + 0.5, 0.0, 1.0)

    def _meet(self, u: Array, v: Array, height: float, tag: Print) -> tuple[Floats, Floats]:
        """Return x, y (V, U) from a print's centre [m] where the rays of columns ``u`` and rows ``v`` meet it."""
        nodes = np.cos(math.pi * (np.arange(_NODES) + 0.5) / _NODES)
        to_nodes = np.linalg.inv(chebvander(nodes, _NODES - 1))

        def span(at: Array) -> tuple[Array, Array]:
            middle, half = (at[0] + at[-1]) / 2.0, (at[-1] - at[0]) / 2.0
            return middle + half * nodes, chebvander((at - middle) / half, _NODES - 1) @ to_nodes

        (u_nodes, from_u), (v_nodes, from_v) = span(u), span(v)
        pixels = np.stack(np.meshgrid(u_nodes, v_nodes), axis=-1).reshape(-1, 2)
        point = self.camera.on_plane(pixels, height)
        for _ in range(6 if any(tag.tilt) or tag.bow else 0):  # each brings it a hundred times nearer
            point = self.camera.on_plane(pixels, height + _rise(point - tag.pose[:2], tag))
        x, y = (point - tag.pose[:2]).T.reshape(2, _NODES, _NODES)
        return _outer(from_v @ x, from_u), _outer(from_v @ y, from_u)

    def _gathered(self, fine: Floats) -> Floats:
        """Return the pixels (h, w) of sub-samples (6 (h + 2 n), 6 (w + 2 n)), n being how far light is spread."""
        if len(self._disc) > 1:
            fine = cv2.filter2D(fine, cv2.CV_32F, self._disc, borderType=cv2.BORDER_REPLICATE)
        first = self._spread * _SUB - (len(self._taps) - _SUB) // 2
        shape = fine.shape[0] // _SUB - 2 * self._spread, fine.shape[1] // _SUB - 2 * self._spread
        rows = np.zeros((shape[0], fine.shape[1]), np.float32)
        return np.asarray(_decimated(fine, self._taps, first, rows, np.zeros(shape, np.float32)))


@numba.njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _expose(  # type: ignore[no-untyped-def]
    x, y, begun, step, instants, motion, paper, look, cell, footprint, cover, light
):
    """Add how much of each sub-sample at x, y (V, U) is paper, and its grey, averaged over ``instants``.

    begun (V,): when a row's exposure begins [s]. motion: psi, forward, left, turn. paper: tilts, stretches, arc. Each
    sub-sample has instants of its own, spread evenly without a grid.
    """
    rising, leaning = math.sin(paper[0]) * math.sin(paper[1]), math.cos(paper[1])
    per_forward, per_left, arc = 1.0 / (1.0 + paper[2]), 1.0 / (1.0 + paper[3]), paper[4]
    cells, wide, share = len(look) - 2, cell / footprint, np.float32(1.0 / instants)
    half = 0.5 * cells
    for i in range(len(y)):
        for k in range(instants):
            t = begun[i] + (k + 0.5) * step
            turn = motion[3] * t
            bent = 0.5 * turn
            chord = t * (1.0 - bent * bent / 6.0 + bent**4 / 120.0)  # of an arc
            c, s = math.cos(motion[0] + bent), math.sin(motion[0] + bent)
            at_x, at_y = chord * (c * motion[1] - s * motion[2]), chord * (s * motion[1] + c * motion[2])
            c, s = math.cos(motion[0] + turn), math.sin(motion[0] + turn)
            v_x, v_y = c * motion[1] - s * motion[2], s * motion[1] + c * motion[2]
            for j in range(x.shape[1]):
                scatter = 0.7548776662466927 * j + 0.5698402909980532 * i
                later = (scatter - math.floor(scatter) - 0.5) * step
                turned = motion[3] * later
                d_x = x[i, j] - at_x - later * (v_x - 0.5 * turned * v_y)
                d_y = y[i, j] - at_y - later * (v_y + 0.5 * turned * v_x)
                forward, left = c * d_x + s * d_y, c * d_y - s * d_x
                forward, left = (
                    forward + turned * (left - 0.5 * turned * forward),
                    left - turned * (forward + 0.5 * turned * left),
                )
                left /= leaning
                forward = (forward + left * rising) / math.cos(paper[0])
                forward += arc * forward**3
                column, row = half + forward * per_forward / cell, half - left * per_left / cell
                on = _inside(column, cells, wide) * _inside(row, cells, wide)
                if on > 0.0:
                    a, b = min(max(int(column + 0.5), 0), cells), min(max(int(row + 0.5), 0), cells)
                    right = min(max((column - a) * wide + 0.5, 0.0), 1.0)
                    below = min(max((row - b) * wide + 0.5, 0.0), 1.0)
                    above = look[b, a] + right * (look[b, a + 1] - look[b, a])
                    under = look[b + 1, a] + right * (look[b + 1, a + 1] - look[b + 1, a])
                    cover[i, j] += share * np.float32(on)
                    light[i, j] += share * np.float32(on * (above + below * (under - above)))


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _inside(at, cells, wide):  # type: ignore[no-untyped-def]
    """Return how much of a sub-sample lies on the paper, along one of its sides."""
    return min(max(min(at, cells - at) * wide + 0.5, 0.0), 1.0)


@numba.njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _outer(a, b):  # type: ignore[no-untyped-def]
    """Return the product (V, U) of (V, N) and the transpose of (U, N); BLAS's threads would wait for each other."""
    product = np.empty((len(a), len(b)), np.float32)
    for i in range(len(a)):
        for j in range(len(b)):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            product[i, j] = total
    return product


@numba.njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _decimated(fine, taps, first, rows, pixels):  # type: ignore[no-untyped-def]
    """Fill rows (h, U), and from them pixels (h, w), with weighted sums of sub-samples, one for each ``_SUB`` of them,
    the first sum beginning with the sub-sample ``first``."""
    for i in range(len(rows)):
        for k in range(len(taps)):
            line, weight = fine[first + i * _SUB + k], taps[k]
            for j in range(len(line)):
                rows[i, j] += weight * line[j]
    for i in range(len(pixels)):
        for j in range(pixels.shape[1]):
            for k in range(len(taps)):
                pixels[i, j] += taps[k] * rows[i, first + j * _SUB + k]
    return pixels


def _rise(way: Array, tag: Print) -> Array:
    """Return how far points (N, 2) of a print lie above its centre, from their horizontal way from it [m]."""
    c, s = math.cos(tag.pose[2]), math.sin(tag.pose[2])
    left = way @ [-s, c] / math.cos(tag.tilt[1])
    forward = (way @ [c, s] + left * (math.sin(tag.tilt[0]) * math.sin(tag.tilt[1]))) / math.cos(tag.tilt[0])
    tilted = forward * math.sin(tag.tilt[0]) + left * (math.cos(tag.tilt[0]) * math.sin(tag.tilt[1]))
    return np.asarray(tilted - tag.bow * (2.0 * forward / tag.side) ** 2, np.float64)


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


def _taps(sigma: float) -> Floats:
    """Return the weights of sub-samples along one side, for a pixel: six squares in a row, spread by a Gaussian [_SUB].

    Six sub-samples' squares are a pixel's, and a Gaussian sampled so finely is as good as the integral over it.
    """
    at = np.arange(-math.ceil(_TAIL * sigma), math.ceil(_TAIL * sigma) + 1)
    gaussian = np.exp(-0.5 * (at / max(sigma, 1e-9)) ** 2)
    return (np.convolve(gaussian / gaussian.sum(), np.full(_SUB, 1.0 / _SUB))).astype(np.float32)


def _disc(radius: float) -> Floats:
    """Return how much of a disc lies in each sub-sample's square (N, N), N odd, around the middle one."""
    k = np.arange(100_000)
    r, angle = radius * np.sqrt((k + 0.5) / len(k)), k * math.pi * (3.0 - math.sqrt(5.0))
    reach = math.ceil(radius - 0.5) + 0.5 if radius > 0.5 else 0.5
    share, _, _ = np.histogram2d(r * np.sin(angle), r * np.cos(angle), round(2.0 * reach), [[-reach, reach]] * 2)
    return (share / len(k)).astype(np.float32)


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

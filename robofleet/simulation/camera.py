"""The simulated camera's images: tags on robots over a cluttered floor, as lens, exposure and sensor show it.

A pixel is the mean, over its row's exposure, of the scene behind it blurred by a Gaussian with the variance of the
lens and of the pixel's area together. Greys are in [0, 255]. What a pixel's ray meets at the tags' height is one
static map; at any other height it is that point, moved away from the camera's foot by a fixed share.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import image_kernel
from robofleet.simulation.floor import TEXEL, Floor, textures
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.photometric import CELLS
from robofleet.tracking.targets import Target

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Looks = tuple[Array32, NDArray[np.int64]]  # textures (tags, levels, S, S), and which one each robot carries

_BLUR_PX = math.sqrt(0.5**2 + 1.0 / 12.0)  # standard deviation: lens, and a pixel's square
_BODY = 70.0  # grey of a robot in full light
_BODY_RADIUS = 0.8  # [tag sides]
_BODY_DROP_M = 0.02  # the body's top lies below the tag
_MARGIN = 1.1  # around a robot: the scale at its edge is not that of its middle
_RAMP = math.sqrt(20.0)  # width of a smooth step [standard deviations of its blur]
_LEVELS = 6  # textures a tag, between the finest and the coarsest scale in the image
_MOTION_PX = 0.7  # what moves further during an exposure is drawn at several instants
_MOST_INSTANTS = 64


class Print(NamedTuple):
    """A tag that lies still."""

    target: Target
    x: float  # [m; world]
    y: float
    psi: float  # of the print's right [rad; CCW +]


class Shutter(NamedTuple):
    """When pixels see."""

    exposure: float = 0.0  # of each row [s]
    line_time: float = 0.0  # from a row's to the next one's [s]


_AT_ONCE = Shutter()


class SceneRenderer:
    """Draws what a calibrated camera sees of N robots. Same arguments and generator state, same images."""

    def __init__(
        self,
        geometry: CameraGeometry,
        image_size: tuple[int, int],
        robots: Sequence[Target],
        noise_gray: float,
        rng: np.random.Generator,
        *,
        shutter: Shutter = _AT_ONCE,
        prints: Sequence[Print] = (),
        offsets: Array | None = None,
        light: float = 1.0,
    ) -> None:
        """Take the image's (width, height), the tags on the N robots, all of one side, and those that lie still.

        offsets (N, 3): forward, left [m], turn [rad] of the tags on their robots. light: of full light.
        """
        self._size, self._robots, self._prints, self._shutter = image_size, tuple(robots), tuple(prints), shutter
        self._offsets = np.zeros((len(robots), 3)) if offsets is None else offsets
        self._side, self._rng = robots[0].side, rng
        self._height = max(target.height for target in robots)
        width, height = image_size
        v, u = np.mgrid[:height, :width].astype(np.float64)
        self._pixels = np.column_stack([u.ravel(), v.ravel()])
        self._gain = np.float32(light) * _uneven_light(u / width - 0.5, (v - 0.5 * height) / width, rng)
        self._floor = Floor(geometry.to_plane(self._border(), 0.0), self._side, _BLUR_PX, rng)
        # Noise is stored with an offset that the background lacks: one saturating addition does both signs.
        self._offset = math.ceil(5.0 * noise_gray)
        bank = rng.normal(self._offset, noise_gray, 2 * width * height)
        self._bank = np.clip(np.rint(bank), 0, 2 * self._offset).astype(np.uint8)
        self._image = np.empty((height, width), np.uint8)
        self.moved(geometry)
        self.looks = np.arange(len(robots))  # (N,) which robot's tag each robot carries
        self.render(np.full((len(robots), 3), np.nan))  # compiles the kernels, or loads them

    def moved(self, geometry: CameraGeometry) -> None:
        """Look from another place from now on."""
        self._geometry = geometry
        width, height = self._size
        plane = geometry.to_plane(self._pixels, self._height).reshape(height, width, 2)
        plane_x, plane_y = (np.ascontiguousarray(plane[..., axis], dtype=np.float32) for axis in (0, 1))
        self._plane = plane_x, plane_y
        self._sigmas = _BLUR_PX * _scales(plane)
        self._textures = np.stack([textures(robot.tag, self._side, self._sigmas) for robot in self._robots])
        floor = self._floor.grays(plane + (plane - geometry.position[:2]) * self._further(0.0))
        background = np.rint(np.maximum(floor * self._gain - self._offset, 0.0)).astype(np.uint8)
        for (tag, side, tag_height, _), x, y, psi in self._prints:
            lying = np.array([[x, y, psi]])
            look, still = (textures(tag, side, self._sigmas)[None], np.zeros(1, np.int64)), np.zeros((1, 3))
            self._draw(background, np.zeros_like(background), look, side, [tag_height], lying, still, still)
        self._background = background

    def render(self, poses: Array, velocities: Array | None = None) -> Image:
        """Return the image (H, W) of robots at poses (N, 3): x, y [m], psi [rad] at mid-exposure of their tags' rows.

        velocities (N, 3): of x, y [m/s], psi [rad/s]. A robot with a NaN is left out. The image is overwritten by the
        next call.
        """
        start = int(self._rng.integers(self._image.size))
        noise = self._bank[start : start + self._image.size].reshape(self._image.shape)
        cv2.add(self._background, noise, dst=self._image)
        moving = np.zeros_like(poses) if velocities is None else velocities
        heights = [robot.height for robot in self._robots]
        looks = self._textures, self.looks
        self._draw(self._image, noise, looks, self._side, heights, poses, moving, self._offsets, bodies=True)
        return self._image

    def rows(self, poses: Array) -> Array:
        """Return the rows (N,) of the image in which the tags of robots at poses (N, 3) have their centres [px]."""
        return self._centres(poses, [robot.height for robot in self._robots], self._offsets)[:, 1]

    def _draw(
        self, image: Image, noise: Image, looks: Looks, side: float, heights: Sequence[float],
        poses: Array, velocities: Array, offsets: Array, *, bodies: bool = False,
    ) -> None:  # fmt: skip
        further = np.array([(self._further(h), self._further(h - _BODY_DROP_M)) for h in heights])
        _draw(
            image, noise, self._offset, *self._plane, self._gain, *looks, self._sigmas, side,
            self._geometry.position, further, _BODY_RADIUS * side if bodies else 0.0, poses, velocities, offsets,
            np.array(self._shutter), self._centres(poses, heights, offsets), np.flatnonzero(np.isfinite(poses).all(1)),
        )  # fmt: skip

    def _centres(self, poses: Array, heights: Sequence[float], offsets: Array) -> Array:
        """Return where the tags' centres appear (N, 2) [px]."""
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x = poses[:, 0] + c * offsets[:, 0] - s * offsets[:, 1]
        y = poses[:, 1] + s * offsets[:, 0] + c * offsets[:, 1]
        return self._geometry.project(np.column_stack([x, y, heights]))

    def _further(self, height: float) -> float:
        """Return how far, of its way along the ground, a ray goes on from the map's height to another one."""
        return float((self._height - height) / (self._geometry.position[2] - self._height))

    def _border(self) -> Array:
        width, height = self._size
        return self._pixels.reshape(height, width, 2)[[0, -1]].reshape(-1, 2)


def _scales(plane: Array) -> Array:
    """Return metres a pixel, (_LEVELS,), from the finest to the coarsest of the map ``plane`` (H, W, 2)."""
    d_u, d_v = plane[1:, 1:] - plane[1:, :-1], plane[1:, 1:] - plane[:-1, 1:]
    scale = np.sqrt(np.abs(d_u[..., 0] * d_v[..., 1] - d_u[..., 1] * d_v[..., 0]))
    return np.geomspace(scale.min(), scale.max(), _LEVELS)


def _uneven_light(u: Array, v: Array, rng: np.random.Generator) -> Array32:
    """Return the gain (H, W) in [0.65, 1]: lamps to one side, and the lens darker in its corners."""
    angle = rng.uniform(-math.pi, math.pi)
    gain = 0.9 + 0.15 * (u * math.cos(angle) + v * math.sin(angle)) - 0.3 * (u * u + v * v)
    return np.asarray(gain, dtype=np.float32)


@image_kernel
def _draw(  # type: ignore[no-untyped-def]
    image, noise, offset, plane_x, plane_y, gain, textures, looks, sigmas, side, eye, further, body_radius,
    poses, velocities, offsets, shutter, centres, seen,
):  # fmt: skip
    """Blend the prints ``seen``, and bodies below them, into background and noise; ``centres`` (N, 2) [px]."""
    exposure, line_time = shutter
    instants = np.empty((_MOST_INSTANTS, 6), np.float32)
    cover, light = np.empty(image.shape[1], np.float32), np.empty(image.shape[1], np.float32)
    at = np.empty((3, image.shape[1]), np.float32)
    paper = side / 2 + side / CELLS
    for n in seen:
        u, v = centres[n]
        scale = _scale(plane_x, plane_y, u, v)
        level = np.argmin(np.abs(sigmas - _BLUR_PX * scale))
        look, sigma, texel = textures[looks[n], level], sigmas[level], TEXEL * sigmas[0]
        moved = math.hypot(velocities[n, 0], velocities[n, 1]) + abs(velocities[n, 2]) * side
        count = min(max(1, math.ceil(moved * exposure / (scale * _MOTION_PX))), _MOST_INSTANTS)
        aside = math.sqrt(2.0) * paper
        if body_radius > 0.0:  # the body is seen beside the tag, as it lies lower
            foot = math.hypot(poses[n, 0] - eye[0], poses[n, 1] - eye[1])
            off = math.hypot(offsets[n, 0], offsets[n, 1])
            aside = max(aside, body_radius + off + foot * (further[n, 1] - further[n, 0]))
        reach = _MARGIN * (aside + 0.5 * _RAMP * sigma + moved * exposure) / scale + 1.0
        _place(poses[n], velocities[n], offsets[n], 0.0, exposure, instants[:count])
        for i in range(max(0, int(v - reach)), min(image.shape[0], int(v + reach) + 2)):
            half = math.sqrt(max(reach * reach - (i - v) ** 2, 0.0))
            left, right = max(0, int(u - half)), min(image.shape[1], int(u + half) + 2)
            if right <= left:
                continue
            if line_time > 0.0:
                _place(poses[n], velocities[n], offsets[n], (i - v) * line_time, exposure, instants[:count])
            hidden, shown = cover[: right - left], light[: right - left]
            hidden[:], shown[:] = 0.0, 0.0
            for k in range(count):
                _look(
                    plane_x[i, left:right], plane_y[i, left:right], eye, further[n], instants[k], look,
                    np.float32(1.0 / texel), np.float32(1.0 / (_RAMP * sigma)), np.float32(paper),
                    np.float32(body_radius), at[:, : right - left], hidden, shown,
                )  # fmt: skip
            _blend(image[i, left:right], noise[i, left:right], offset, gain[i, left:right], hidden, shown, count)


@image_kernel
def _place(pose, velocity, offset, late, exposure, instants):  # type: ignore[no-untyped-def]
    """Fill ``instants`` (K, 6): x, y of the tag, its cosine and sine, x, y of the body, over an exposure."""
    for k in range(len(instants)):
        t = late + ((k + 0.5) / len(instants) - 0.5) * exposure
        x, y, psi = pose[0] + t * velocity[0], pose[1] + t * velocity[1], pose[2] + t * velocity[2]
        c, s = math.cos(psi), math.sin(psi)
        instants[k, 0], instants[k, 1] = x + c * offset[0] - s * offset[1], y + s * offset[0] + c * offset[1]
        instants[k, 2], instants[k, 3] = math.cos(psi + offset[2]), math.sin(psi + offset[2])
        instants[k, 4], instants[k, 5] = x, y


@image_kernel
def _scale(plane_x, plane_y, u, v):  # type: ignore[no-untyped-def]
    """Return metres a pixel of the plane at a pixel, or at the image's nearest one."""
    i, j = min(max(int(v), 1), plane_x.shape[0] - 1), min(max(int(u), 1), plane_x.shape[1] - 1)
    d_u = plane_x[i, j] - plane_x[i, j - 1], plane_y[i, j] - plane_y[i, j - 1]
    d_v = plane_x[i, j] - plane_x[i - 1, j], plane_y[i, j] - plane_y[i - 1, j]
    return math.sqrt(abs(d_u[0] * d_v[1] - d_u[1] * d_v[0]))


@image_kernel
def _look(  # type: ignore[no-untyped-def]
    x, y, eye, further, instant, look, per_texel, ramp, paper, body_radius, at, cover, light
):
    """Add to ``cover`` (n,) how much of the floor a robot hides in a row, and its grey times that to ``light`` (n,).

    x, y (n,): where the rays meet the map's plane [m]. ``at`` (3, n): how much is tag, and where on the texture.
    """
    one, zero = np.float32(1.0), np.float32(0.0)
    to_tag, to_body = np.float32(further[0]), np.float32(further[1])
    eye_x, eye_y = np.float32(eye[0]), np.float32(eye[1])
    middle = np.float32(0.5 * (look.shape[0] - 1))
    tag, row, column = at[0], at[1], at[2]
    for j in range(len(x)):
        d_x = x[j] + (x[j] - eye_x) * to_tag - instant[0]
        d_y = y[j] + (y[j] - eye_y) * to_tag - instant[1]
        a, b = instant[2] * d_x + instant[3] * d_y, instant[2] * d_y - instant[3] * d_x
        tag[j] = _step((paper - abs(a)) * ramp) * _step((paper - abs(b)) * ramp)
        row[j], column[j] = middle - b * per_texel, middle + a * per_texel
    for j in range(len(x)):
        if tag[j] > zero:
            light[j] += tag[j] * _bilinear(look, row[j], column[j])
    if body_radius == zero:
        for j in range(len(x)):
            cover[j] += tag[j]
        return
    for j in range(len(x)):
        d_x = x[j] + (x[j] - eye_x) * to_body - instant[4]
        d_y = y[j] + (y[j] - eye_y) * to_body - instant[5]
        body = (one - tag[j]) * _step((body_radius - np.sqrt(d_x * d_x + d_y * d_y)) * ramp)
        light[j] += body * np.float32(_BODY)
        cover[j] += tag[j] + body


@image_kernel
def _blend(image, noise, offset, gain, cover, light, count):  # type: ignore[no-untyped-def]
    """Put a robot's row, of ``count`` instants, over background and noise."""
    share, low, high = np.float32(1.0 / count), np.float32(0.0), np.float32(255.0)
    shift, rounding = np.float32(offset), np.float32(0.5)
    for j in range(len(image)):
        hidden = cover[j] * share
        gray = np.float32(image[j]) * (np.float32(1.0) - hidden) + light[j] * share * gain[j]
        gray += (np.float32(noise[j]) - shift) * hidden
        image[j] = np.uint8(min(max(gray, low), high) + rounding) if hidden > low else image[j]


@image_kernel
def _step(d):  # type: ignore[no-untyped-def]
    """Return the smooth step from 0 at d = -1/2 to 1 at 1/2."""
    t = min(max(d + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
    return t * t * (np.float32(3.0) - np.float32(2.0) * t)


@image_kernel
def _bilinear(texture, row, column):  # type: ignore[no-untyped-def]
    """Return the texture between its four texels; its rim goes on for ever."""
    last = np.float32(texture.shape[0] - 1.001)
    row, column = min(max(row, np.float32(0.0)), last), min(max(column, np.float32(0.0)), last)
    i, j = int(row), int(column)
    p, q = row - np.float32(i), column - np.float32(j)
    upper = texture[i, j] + q * (texture[i, j + 1] - texture[i, j])
    lower = texture[i + 1, j] + q * (texture[i + 1, j + 1] - texture[i + 1, j])
    return upper + p * (lower - upper)

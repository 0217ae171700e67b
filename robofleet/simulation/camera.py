"""The simulated camera's images: tags on robots over a cluttered floor, as lens, exposure and sensor show it.

A pixel is the mean, over its row's exposure, of the scene behind it blurred by a Gaussian with the variance of the
lens and of the pixel's area together. Greys are in [0, 255]. What a pixel's ray meets at the tags' height is one
static map; at any other height it is that point, moved away from the camera's foot by a fixed share.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Array32, Image, Indices
from robofleet.simulation.draw import cells, centres, draw, renew
from robofleet.simulation.floor import WIDEST, Floor
from robofleet.tracking.camera import CameraGeometry, Lens
from robofleet.tracking.tags.targets import Target

_PIXEL_VARIANCE = 1.0 / 12.0  # of a pixel's square [px^2]
_BODY_RADIUS = 0.8  # [sides of the tag's print]
_BODY_DROP_M = 0.02  # the body's top lies below the tag
_IMAGES = 7  # that are drawn one after the other; with _STRIPS, which has no factor in common, see ``render``
_STRIPS = 12
_HORIZON = 0.1  # rays flatter than this slope meet the ground as if they had it


class Print(NamedTuple):
    """A tag that lies still."""

    target: Target
    x: float  # [m; world]
    y: float
    psi: float  # of the print's right [rad; CCW +]


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
        exposure_s: float = 0.0,
        line_time_s: float = 0.0,
        prints: Sequence[Print] = (),
        offsets: Array | None = None,
        light: float = 1.0,
        obstacles: Sequence[Array] = (),
        lens_sigma_px: float = 0.5,
        shade: Array32 | None = None,
        stretches: Array | None = None,
        bows: Array | None = None,
    ) -> None:
        """Take the image's (width, height), the tags on the N robots, all of one side, and those that lie still.

        exposure_s: of each row. line_time_s: from a row's to the next one's. offsets (N, 3): forward, left [m], turn
        [rad] of the tags on their robots. light: as ``expose`` takes it. obstacles (K, 2) each: outlines on the floor
        [m]. lens_sigma_px: standard deviation of the lens's Gaussian. shade (H, W): what is left of the light.
        stretches (N, 2): shares by which the robots' prints are too long along their right and their top. bows (N,):
        how far the middles of their left and right edges lie below their centres [m].
        """
        self._size, self._robots, self._prints = image_size, tuple(robots), tuple(prints)
        self._shutter = exposure_s, line_time_s
        self._offsets = np.zeros((len(robots), 3)) if offsets is None else offsets
        self._whole, self._rng = robots[0].whole, rng
        self._height = max(target.height for target in robots)
        width, height = image_size
        v, u = np.mgrid[:height, :width].astype(np.float64)
        self.blur_px = math.sqrt(lens_sigma_px**2 + _PIXEL_VARIANCE)
        self._even = _uneven_light(u / width - 0.5, (v - 0.5 * height) / width, rng)
        if shade is not None:
            self._even *= shade
        self._shade = np.broadcast_to(np.float32(1.0) if shade is None else shade, (height, width))
        self._light = np.float32(light)
        self._projected: tuple[Array32, Array32] | None = None  # light on the floor and at the tags' height
        self._floor = Floor(self._plane_at(geometry, 0.0), geometry.position, self._whole, self.blur_px, rng, obstacles)
        self._offset = math.ceil(5.0 * noise_gray)
        bank = rng.normal(self._offset, noise_gray, 2 * width * height)
        self._quiet_bank = np.clip(np.rint(bank), 0, 2 * self._offset).astype(np.uint8)
        self._quiet_offset, self._bank = self._offset, self._quiet_bank
        self._images = np.empty((_IMAGES, height, width), np.uint8)
        # Of each image, what is renewed when it is drawn again: robots, prints, and a strip.
        self._boxes = np.zeros((_IMAGES, len(robots) + len(prints) + 1, 4), np.int64)
        self._rendered, self._noise = 0, 1.0
        self._heights = np.array([target.height for target in robots])
        self._stretches = np.zeros((len(robots), 2)) if stretches is None else stretches
        self._bows = np.zeros(len(robots)) if bows is None else bows
        looks = [cells(target.tag, target.family) for target in robots]
        self._looks = np.stack([*looks, np.zeros_like(looks[0])])
        self.moved(geometry)
        self.looks = np.arange(len(robots))  # (N,) which robot's tag each robot carries; N: plain paper
        self.render(np.full((len(robots), 3), np.nan))  # compiles the kernels, or loads them

    def moved(self, geometry: CameraGeometry) -> None:
        self._geometry = geometry
        plane = self._plane_at(geometry, self._height)
        self._plane = plane[0].astype(np.float32), plane[1].astype(np.float32)
        away = plane - geometry.position[:2, None, None]
        near = np.maximum(*np.abs(away)) < WIDEST * geometry.position[2]
        self._blurs = self.blur_px * _scales(plane, near)
        self._further = self._further_by(self._heights)
        away *= self._further_by(np.zeros(1))[0, 0]
        plane += away
        self._floor_grays = self._floor.grays(plane)
        self._light_ground()

    def expose(self, exposure_s: float, light: float, noise: float) -> None:
        """Draw exposures of another length from now on, with ``light`` times the greys of full light, and with
        ``noise`` times the noise: what gain makes of both."""
        self._shutter = (exposure_s, self._shutter[1])
        if (np.float32(light), noise) == (self._light, self._noise):
            return
        if noise != self._noise:
            self._noise = noise
            self._offset = min(math.ceil(self._quiet_offset * noise), 127)
            bank = np.rint((self._quiet_bank.astype(np.float32) - self._quiet_offset) * noise) + self._offset
            self._bank = np.clip(bank, 0, 2 * self._offset).astype(np.uint8)
        self._light = np.float32(light)
        self._light_ground()

    def planes(self) -> tuple[tuple[Array32, Array32, float], ...]:
        """Return where the pixels' rays meet the floor, and the tags' plane: x and y (H, W) [m], and the height."""
        floor_x, floor_y = self._plane_at(self._geometry, 0.0).astype(np.float32)
        return (floor_x, floor_y, 0.0), (*self._plane, self._height)

    def project(self, floor: Array32, tags: Array32, parts: Sequence[tuple[slice, slice]]) -> None:
        """Let projectors' light (H, W) fall on the floor, and on tags and robots, from now on: beside the room's, in
        the same shares. ``parts``: rows and columns in which it is not as it was at the call before."""
        first, self._projected = self._projected is None, (floor, tags)
        if first:
            self._light_ground()
            return
        boxes = np.array([(across.start, down.start, across.stop, down.stop) for down, across in parts])
        lying = self._lying
        apart = (boxes[:, None, :2] >= lying[:, 2:]) | (lying[:, :2] >= boxes[:, None, 2:])
        if not apart.any(axis=2).all():  # prints are drawn as wholes
            boxes = np.concatenate([boxes, lying])
        for left, top, right, bottom in boxes.tolist():
            part = slice(top, bottom), slice(left, right)
            self._floor_gain[part], self._gain[part] = self._gains(part)
            self._ground[part] = self._floor_lit(part)
        if len(boxes) > len(parts):
            self._lay()
        for stale in self._stale:
            stale.append(boxes)

    def _gains(self, part: tuple[slice, slice]) -> tuple[Array32, Array32]:
        """Return the light on the floor, and at the tags' height."""
        room = self._light * self._even[part]
        if self._projected is None:
            return room, room
        floor, tags = (room + light[part] * self._shade[part] for light in self._projected)
        return floor, tags

    def _floor_lit(self, part: tuple[slice, slice]) -> Image:
        return np.minimum(np.rint(self._floor_grays[part] * self._floor_gain[part]), 255).astype(np.uint8)

    def _light_ground(self) -> None:
        whole = slice(None), slice(None)
        self._floor_gain, self._gain = self._gains(whole)
        self._ground = self._floor_lit(whole)
        self._boxes[:] = 0
        self._lay()
        self._boxes[1:] = self._boxes[0]
        self._unseen = _IMAGES  # images of another place
        self._stale: list[list[Indices]] = [[] for _ in range(_IMAGES)]  # what else each image renews

    @property
    def _lying(self) -> Indices:
        """The prints' boxes."""
        return self._boxes[0, len(self._robots) : -1]

    def _lay(self) -> None:
        """Draw the prints on the ground."""
        quiet = np.full_like(self._ground, self._offset)
        for k, (target, x, y, psi) in enumerate(self._prints):
            lying, height, look = np.array([[x, y, psi]]), np.array([target.height]), cells(target.tag, target.family)
            still, further = np.zeros((1, 3)), self._further_by(height)
            boxes = self._lying[k : k + 1]
            flat = self._shapes(np.zeros((1, 2)), np.zeros(1))
            self._draw(
                self._ground, quiet, self._floor_gain, look[None], target.whole, height, further, flat, lying, still,
                still, boxes,
            )  # fmt: skip

    def render(self, poses: Array, velocities: Array | None = None) -> Image:
        """Return the image (H, W) of robots at poses (N, 3): x, y [m], psi [rad] at mid-exposure of their tags' rows.

        velocities (N, 3): of x, y [m/s], psi [rad/s]. A robot with a NaN is left out. The image is the renderer's: it
        is not to be changed, and overwritten by a later call.

        Robots and prints have new noise in each image. The floor has that of ``_IMAGES`` images in turn, of which a
        call renews one strip: a detector that searches the image in as many parts sees none of it twice.
        """
        turns, which = divmod(self._rendered, _IMAGES)
        self._rendered += 1
        image: Image = self._images[which]
        boxes, n = self._boxes[which], len(self._robots)
        height, width = image.shape
        if self._unseen:
            self._unseen -= 1
            boxes[-1] = 0, 0, width, height
        else:
            strip = turns % _STRIPS
            boxes[-1] = 0, strip * height // _STRIPS, width, (strip + 1) * height // _STRIPS
        start = int(self._rng.integers(image.size))
        noise = self._bank[start : start + image.size].reshape(image.shape)
        stale, self._stale[which] = self._stale[which], []
        renew(image, self._ground, noise, self._offset, np.concatenate([boxes, *stale]) if stale else boxes)
        moving = np.zeros_like(poses) if velocities is None else velocities
        self._draw(
            image, noise, self._gain, self._looks[self.looks], self._whole, self._heights, self._further,
            self._shapes(self._stretches, self._bows), poses, moving, self._offsets, boxes[:n], bodies=True,
        )  # fmt: skip
        return image

    def rows(self, poses: Array) -> Array:
        """Return the rows (N,) of the image in which the tags of robots at poses (N, 3) have their centres [px]."""
        return np.asarray(centres(self._geometry.flat, poses, self._offsets, self._heights)[:, 1], np.float64)

    def _draw(
        self, image: Image, noise: Image, gain: Array32, looks: Array32, side: float, heights: Array, further: Array,
        shapes: Array, poses: Array, velocities: Array, offsets: Array, boxes: Indices, *, bodies: bool = False,
    ) -> None:  # fmt: skip
        draw(
            image, noise, self._offset, *self._plane, gain, looks, self.blur_px, self._blurs, side,
            self._geometry.flat, self._geometry.position, heights, further, _BODY_RADIUS * side if bodies else 0.0,
            poses, velocities, offsets, shapes, self._shutter, np.flatnonzero(np.isfinite(poses).all(1)), boxes,
        )  # fmt: skip

    def _shapes(self, stretches: Array, bows: Array) -> Array:
        """Return prints' shapes (M, 4), as ``draw`` takes them; a bowed print is a part of a cylinder along its top."""
        down = self._geometry.position[2] - self._height
        curves = 4.0 * bows / self._robots[0].side ** 2  # how far a print lies lower, by the square of the way [1/m]
        return np.column_stack([1.0 / (1.0 + stretches), curves / down, curves**2 * (2.0 / 3.0)])

    def _further_by(self, heights: Array) -> Array:
        """Return how far, of its way along the ground, a ray goes on from the map's height to tags' and bodies'."""
        below = np.stack([heights, heights - _BODY_DROP_M], axis=1)
        return np.asarray((self._height - below) / (self._geometry.position[2] - self._height), np.float64)

    def _plane_at(self, geometry: CameraGeometry, height: float) -> Array:
        """Return where the pixels' rays meet z = height, (2, H, W) [m; world]; rays near the horizon: far away."""
        slopes = _slopes(geometry.lens, geometry.K.tobytes(), geometry.distortion.tobytes(), self._size)
        turn, eye = geometry.T_world_camera[:3, :3], geometry.position
        rays = turn[:, :2] @ slopes
        rays += turn[:, 2:]
        down, (ahead, aside) = -rays[2], np.abs(rays[:2])
        np.maximum(ahead, aside, out=ahead)
        ahead *= _HORIZON
        np.maximum(down, ahead, out=down)
        np.divide(eye[2] - height, down, out=down)
        points: Array = rays[:2]
        points *= down
        points += eye[:2, None]
        return points.reshape(2, self._size[1], self._size[0])


@lru_cache(maxsize=2)  # a camera that moves keeps its lens
def _slopes(lens: Lens, K: bytes, distortion: bytes, size: tuple[int, int]) -> Array:
    """Return the slopes (2, H W) of all pixels' rays; matrices as bytes of doubles."""
    own = CameraGeometry(np.frombuffer(K).reshape(3, 3), np.frombuffer(distortion), np.eye(4), lens)
    v, u = np.mgrid[: size[1], : size[0]].astype(np.float64)
    # In the camera's own frame the plane z = 1 holds each ray's slopes.
    return np.ascontiguousarray(own.to_plane(np.column_stack([u.ravel(), v.ravel()]), 1.0).T)


def _scales(plane: Array, near: NDArray[np.bool_]) -> Array:
    """Return metres a pixel (2,) where it is finest, and coarsest, of the map (2, H, W) where it is ``near``."""
    here = plane[:, 1:, 1:]
    d_u, d_v = here - plane[:, 1:, :-1], here - plane[:, :-1, 1:]
    area = np.abs(d_u[0] * d_v[1] - d_u[1] * d_v[0])
    inside = near[1:, 1:]
    return np.sqrt([area.min(where=inside, initial=np.inf), area.max(where=inside, initial=0.0)])


def _uneven_light(u: Array, v: Array, rng: np.random.Generator) -> Array32:
    """Return the gain (H, W) in [0.65, 1]: lamps to one side, and the lens darker in its corners."""
    angle = rng.uniform(-math.pi, math.pi)
    gain = 0.9 + 0.15 * (u * math.cos(angle) + v * math.sin(angle)) - 0.3 * (u * u + v * v)
    return np.asarray(gain, dtype=np.float32)

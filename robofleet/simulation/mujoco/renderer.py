"""MuJoCo's renderer as an overhead camera: floor, obstacles and robots with tags as OpenGL draws them.

OpenGL draws a pinhole's image, ``_FINE`` samples a pixel along each axis. The lens bends it, its Gaussian blurs it, and
a pixel is the mean of its square. Floor and prints are drawn once; of each image only what robots can hide is new.
"""

import ctypes.util
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from robofleet.core.arrays import Array, Array32, Image
from robofleet.simulation.camera import Print
from robofleet.simulation.mujoco.extra import mujoco, turned
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraError
from robofleet.tracking.tags.families import pattern
from robofleet.tracking.tags.targets import Target
from robofleet.vehicles.interface import WorldObstacle

BLACK, WHITE, FLOOR, SOLID, BODY = 30, 215, 130, 100, 70  # greys in full light
_FINE = 6  # samples of a pixel along each axis
_BUFFER = 1024  # sides of what OpenGL draws at once [samples]
_TILE = 120  # sides of the parts in which the ground is drawn [px]
_TEXELS = 32  # of a cell
_AWAY = -100.0  # height of what is not there [m]
_MARGIN = 3  # around a part, for the blur [px]
_STILL_PX = 0.05  # motion in an exposure that is not drawn
_BODY_DROP_M = 0.02  # a body's top lies below its tag
_PAPER_M = 0.0005  # a print's height above the floor, at least
_GHOST = {"contype": 0, "conaffinity": 0}  # nothing collides
_BANK = 2  # images of noise that are drawn in turn, from anywhere in them


class Body(NamedTuple):
    """What a robot looks like from above."""

    target: Target
    radius: float  # [m]


def no_display() -> str:
    """Return why nothing can be drawn here, and what to install; nothing where it can."""
    if ctypes.util.find_library("OSMesa") or ctypes.util.find_library("EGL"):
        return ""
    return "nothing here draws without a display: install OSMesa (Debian: apt-get install libosmesa6)"


def _context() -> Any:
    """Return OpenGL's context without a display: OSMesa's, which draws alike everywhere, else EGL's."""
    try:
        if ctypes.util.find_library("OSMesa"):
            from mujoco.osmesa import GLContext  # noqa: PLC0415 - an extra
        else:
            from mujoco.egl import GLContext  # noqa: PLC0415
        return GLContext(_BUFFER, _BUFFER)
    except Exception as error:
        raise CameraError(no_display() or f"OpenGL draws nothing here: {error}: install libosmesa6") from error


class MujocoRenderer:
    """Draws what a calibrated camera sees of N robots."""

    def __init__(
        self, geometry: CameraGeometry, size: tuple[int, int], robots: Sequence[Body], prints: Sequence[Print],
        obstacles: Sequence[WorldObstacle], offsets: Array, noise_gray: float, rng: np.random.Generator, *,
        exposure_s: float, light: float, lens_sigma_px: float, shade: Array32,
    ) -> None:  # fmt: skip
        """Take the image's (width, height); ``offsets`` (N, 3): forward, left [m], turn [rad] of the tags."""
        mj = self._mj = mujoco()
        self._size, self._robots, self._offsets = size, tuple(robots), offsets
        self._exposure_s, self._light, self._noise = exposure_s, light, 1.0
        self._shade, self._sigma = shade, lens_sigma_px * _FINE
        self._rng, self._noise_gray = rng, noise_gray
        self._bank = self._drawn_noise()
        self._model = _scene(robots, prints, obstacles, offsets, rng).compile()
        self._data = mj.MjData(self._model)
        mj.mj_forward(self._model, self._data)
        plates = [self._model.geom(f"plate{row}") for row in range(len(robots))]
        self._plates = np.array([plate.id for plate in plates])
        self._materials = np.array([*(self._model.mat(f"print{row}").id for row in range(len(robots))), self._model.mat("paper").id])
        self._gl = _context()
        self._gl.make_current()
        self._drawing = mj.MjrContext(self._model, mj.mjtFontScale.mjFONTSCALE_50)
        mj.mjr_setBuffer(mj.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._scene, self._view = mj.MjvScene(self._model, self._model.ngeom + 10), mj.MjvCamera()
        self._option = mj.MjvOption()
        self._scene.flags[:] = 0
        self._samples = np.empty((_BUFFER, _BUFFER, 3), np.uint8)
        self.looks = np.arange(len(robots))  # (N,) whose tag each robot carries; N: plain paper
        self.moved(geometry)

    def moved(self, geometry: CameraGeometry) -> None:
        self._geometry = geometry
        width, height = self._size
        v, u = np.mgrid[-1 - _MARGIN : height + 2 + _MARGIN, -1 - _MARGIN : width + 2 + _MARGIN].astype(np.float64)
        own = CameraGeometry(geometry.K, geometry.distortion, np.eye(4), geometry.lens)
        slopes = own.to_plane(np.column_stack([u.ravel(), v.ravel()]), 1.0)
        self._slopes = slopes.reshape(*u.shape, 2).astype(np.float32)
        self._put(np.full((len(self._robots), 3), np.nan))
        self._ground = np.empty((height, width), np.float32)
        for top in range(0, height, _TILE):
            for left in range(0, width, _TILE):
                box = left, top, min(left + _TILE, width), min(top + _TILE, height)
                self._ground[box[1] : box[3], box[0] : box[2]] = self._drawn(box)
        self._expose_ground()

    def expose(self, exposure_s: float, light: float, noise: float) -> None:
        """Expose so from now on: with ``light`` times the greys of full light, and ``noise`` times the noise."""
        self._exposure_s = exposure_s
        if (light, noise) == (self._light, self._noise):
            return
        if noise != self._noise:
            self._noise = noise
            self._bank = self._drawn_noise()
        self._light = light
        self._expose_ground()

    def render(self, poses: Array, velocities: Array | None = None) -> Image:
        """Return what is seen (H, W) of robots at ``poses`` (N, 3) [m, rad; world], mid-exposure, that move with
        ``velocities`` (N, 3) [m/s, rad/s]; a robot with a NaN is left out."""
        image = self._clean.copy()
        moving = np.zeros_like(poses) if velocities is None else velocities
        boxes = self._boxes(poses)
        at = (0.0,)
        if len(boxes) and self._motion_px(poses, moving) > _STILL_PX:  # two instants with the exposure's variance
            at = (-self._exposure_s / math.sqrt(12.0), self._exposure_s / math.sqrt(12.0))
        light = [np.zeros((box[3] - box[1], box[2] - box[0]), np.float32) for box in boxes]
        for t in at:
            self._put(poses + t * moving)
            for box, part in zip(boxes, light, strict=True):
                part += self._drawn(box) / len(at)
        for (left, top, right, bottom), part in zip(boxes, light, strict=True):
            part *= self._light * self._shade[top:bottom, left:right]
            image[top:bottom, left:right] = part
        start = int(self._rng.integers((_BANK - 1) * image.size + 1))
        image += self._bank[start : start + image.size].reshape(image.shape)
        return np.asarray(np.clip(np.rint(image), 0.0, 255.0), np.uint8)

    def rows(self, poses: Array) -> Array:
        """Return the rows (N,) of the image in which the robots' tags have their centres [px]."""
        heights = np.array([body.target.height for body in self._robots])
        known = np.nan_to_num(poses)
        rows = self._geometry.project(np.column_stack([known[:, :2], heights]))[:, 1]
        return np.where(np.isfinite(poses).all(1), rows, np.nan)

    def _drawn_noise(self) -> Array32:
        width, height = self._size
        noise = self._rng.standard_normal(_BANK * width * height, np.float32)
        return np.asarray(noise * np.float32(self._noise_gray * self._noise), np.float32)

    def _expose_ground(self) -> None:
        self._clean = np.asarray(self._ground * self._light * self._shade, np.float32)

    def _put(self, poses: Array) -> None:
        """Put the robots there, with the tags that they carry now."""
        known = np.isfinite(poses).all(1)
        at = np.where(known[:, None], poses, 0.0)
        self._data.mocap_pos[:, :2], self._data.mocap_pos[:, 2] = at[:, :2], np.where(known, 0.0, _AWAY)
        self._data.mocap_quat[:, 0], self._data.mocap_quat[:, 3] = np.cos(at[:, 2] / 2.0), np.sin(at[:, 2] / 2.0)
        self._model.geom_matid[self._plates] = self._materials[self.looks]
        self._mj.mj_kinematics(self._model, self._data)
        everything = self._mj.mjtCatBit.mjCAT_ALL
        self._mj.mjv_updateScene(self._model, self._data, self._option, None, self._view, everything, self._scene)

    def _boxes(self, poses: Array) -> list[tuple[int, int, int, int]]:
        """Return the parts of the image, left, top, right, bottom [px], that the robots that are there can hide."""
        boxes = []
        width, height = self._size
        for body, (x, y, psi) in zip(self._robots, poses.tolist(), strict=True):
            if math.isnan(x + y + psi):
                continue
            reach = max(body.radius, body.target.whole) + 0.02
            square = [(x + a * reach, y + b * reach, z) for a in (-1, 1) for b in (-1, 1) for z in (0.0, body.target.height)]
            pixels = self._geometry.project(np.array(square))
            left, top = np.maximum(np.floor(pixels.min(0)).astype(int), 0).tolist()
            right, bottom = np.minimum(np.ceil(pixels.max(0)).astype(int) + 1, (width, height)).tolist()
            boxes += [
                (i, j, min(i + _TILE, right), min(j + _TILE, bottom))
                for j in range(top, bottom, _TILE) for i in range(left, right, _TILE)
            ]  # fmt: skip
        return boxes

    def _motion_px(self, poses: Array, velocities: Array) -> float:
        focal, depth = self._geometry.K[0, 0], self._geometry.position[2]
        there = np.isfinite(poses).all(1)
        speeds = np.hypot(velocities[there, 0], velocities[there, 1])
        return float(speeds.max(initial=0.0) * self._exposure_s * focal / depth)

    def _drawn(self, box: tuple[int, int, int, int]) -> Array32:
        """Return the greys in full light of a part of the image."""
        left, top, right, bottom = box
        rows = _samples(top - _MARGIN, bottom + _MARGIN) + 1 + _MARGIN
        columns = _samples(left - _MARGIN, right + _MARGIN) + 1 + _MARGIN
        u, v = np.meshgrid(columns.astype(np.float32), rows.astype(np.float32))
        slopes = cv2.remap(self._slopes, u, v, cv2.INTER_LINEAR)
        low, high = slopes.min((0, 1)) - 1e-6, slopes.max((0, 1)) + 1e-6
        count = np.minimum(np.ceil((high - low) * np.diag(self._geometry.K)[:2] * _FINE).astype(int) + 2, _BUFFER)
        pinhole = self._pinhole(low, high, count.tolist())
        at = np.asarray((slopes - low) / (high - low) * count - 0.5, np.float32)
        bent = cv2.remap(pinhole, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        blurred = cv2.GaussianBlur(bent, (0, 0), self._sigma)
        inner = blurred[_MARGIN * _FINE : -_MARGIN * _FINE, _MARGIN * _FINE : -_MARGIN * _FINE]
        means = inner.reshape(bottom - top, _FINE, right - left, _FINE).mean((1, 3))
        return np.asarray(means, np.float32)

    def _pinhole(self, low: Array, high: Array, count: Sequence[int]) -> Array32:
        """Return the greys of the rays whose slopes to the right and down lie between two ends."""
        T, (width, height), near = self._geometry.T_world_camera, count, 0.05
        for eye in self._scene.camera:
            eye.pos, eye.forward, eye.up = T[:3, 3], T[:3, 2], -T[:3, 1]
            eye.orthographic = 0
            eye.frustum_near, eye.frustum_far = near, 50.0
            eye.frustum_center, eye.frustum_width = near * (low[0] + high[0]) / 2.0, near * (high[0] - low[0]) / 2.0
            eye.frustum_top, eye.frustum_bottom = -near * low[1], -near * high[1]
        self._gl.make_current()
        view = self._mj.MjrRect(0, 0, width, height)
        self._mj.mjr_render(view, self._scene, self._drawing)
        samples = self._samples.reshape(-1)[: 3 * width * height].reshape(height, width, 3)
        self._mj.mjr_readPixels(samples, None, view, self._drawing)
        return np.ascontiguousarray(samples[::-1, :, 0], np.float32)  # OpenGL's rows go up


def _samples(first: int, end: int) -> Array:
    """Return where the samples of pixels lie along an axis [px]."""
    return (np.arange((end - first) * _FINE) + 0.5) / _FINE - 0.5 + first


def _scene(
    robots: Sequence[Body], prints: Sequence[Print], obstacles: Sequence[WorldObstacle], offsets: Array,
    rng: np.random.Generator,
) -> Any:  # fmt: skip
    """Return all that is seen, as MuJoCo's specification. Greys are a surface's own: the light comes from everywhere."""
    mj = mujoco()
    spec = mj.MjSpec()
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [1.0] * 3, [0.0] * 3
    spec.visual.headlight.specular = [0.0] * 3
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 0, 0
    spec.visual.global_.offwidth = spec.visual.global_.offheight = _BUFFER
    spec.visual.map.znear, spec.visual.map.zfar = 0.01, 100.0
    wood = rng.integers(FLOOR - 12, FLOOR + 13, (96, 96)).astype(np.uint8)
    _material(spec, "wood", cv2.resize(wood, (960, 960), interpolation=cv2.INTER_CUBIC))
    world = spec.worldbody
    world.add_geom(type=mj.mjtGeom.mjGEOM_PLANE, size=[8.0, 8.0, 1.0], material="wood", **_GHOST)
    for obstacle in obstacles:
        _raise(spec, obstacle)
    for k, (target, x, y, psi) in enumerate(prints):
        _material(spec, f"lying{k}", _print(target))
        lying = {"pos": [x, y, max(target.height, _PAPER_M)], "quat": turned(psi), "material": f"lying{k}"}
        world.add_geom(**lying, **_plate(target), **_GHOST)
    _material(spec, "paper", np.full((8, 8), WHITE, np.uint8))
    for row, (body, (forward, left, turn)) in enumerate(zip(robots, offsets.tolist(), strict=True)):
        _material(spec, f"print{row}", _print(body.target))
        robot = world.add_body(mocap=True, pos=[0.0, 0.0, _AWAY])
        half = (body.target.height - _BODY_DROP_M) / 2.0
        robot.add_geom(
            type=mj.mjtGeom.mjGEOM_CYLINDER, size=[body.radius, half, 0.0], pos=[0.0, 0.0, half], rgba=_gray(BODY), **_GHOST
        )  # fmt: skip
        robot.add_geom(
            name=f"plate{row}", pos=[forward, left, body.target.height], quat=turned(turn), material=f"print{row}",
            **_plate(body.target), **_GHOST,
        )  # fmt: skip
    return spec


def _plate(target: Target) -> dict[str, Any]:
    """Return a print with the paper around it: a cell on each side."""
    half = target.whole * (1.0 + 2.0 / len(pattern(target.tag, target.family))) / 2.0
    return {"type": mujoco().mjtGeom.mjGEOM_PLANE, "size": [half, half, 1.0]}


def _print(target: Target) -> Image:
    cells = np.pad(pattern(target.tag, target.family), 1, constant_values=True)
    greys = np.where(cells, WHITE, BLACK).astype(np.uint8)
    return np.repeat(np.repeat(greys, _TEXELS, 0), _TEXELS, 1)


def _material(spec: Any, name: str, greys: Image) -> None:
    """Add a surface that shows greys (H, W), row 0 at the top."""
    mj = mujoco()
    height, width = greys.shape
    pixels = np.repeat(greys[:, :, None], 3, 2)
    texture = spec.add_texture(name=name, type=mj.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3)
    texture.data = pixels.tobytes()
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, reflectance=0.0)
    textures = list(material.textures)
    textures[mj.mjtTextureRole.mjTEXROLE_RGB] = name
    material.textures = textures


def _raise(spec: Any, obstacle: WorldObstacle) -> None:
    """Add an obstacle: a disc, or the hull of a polygon's corners."""
    mj, half = mujoco(), obstacle.height / 2.0
    if obstacle.radius:
        spec.worldbody.add_geom(
            type=mj.mjtGeom.mjGEOM_CYLINDER, size=[obstacle.radius, half, 0.0], pos=[*obstacle.points[0], half],
            rgba=_gray(SOLID), **_GHOST,
        )  # fmt: skip
        return
    corners = [(x, y, z) for x, y in obstacle.points for z in (0.0, obstacle.height)]
    spec.add_mesh(name=obstacle.name, uservert=np.ravel(corners))
    spec.worldbody.add_geom(type=mj.mjtGeom.mjGEOM_MESH, meshname=obstacle.name, rgba=_gray(SOLID), **_GHOST)


def _gray(gray: int) -> list[float]:
    return [gray / 255.0] * 3 + [1.0]

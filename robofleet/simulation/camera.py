"""The simulated camera's images: tags on robots over a cluttered floor, as lens, exposure and sensor show it.

A pixel is the mean, over the exposure, of the scene behind it blurred by a Gaussian with the variance of the
lens and of the pixel's area together. A tag's blurred pattern is exact (products of error functions), so that
its edges lie where they should. Greys are in [0, 255].
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import image_kernel
from robofleet.tracking.camera import CameraGeometry

Image = NDArray[np.uint8]
Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# The look of the scene: assumed, and in the range of a laboratory.
_BLUR_PX = math.sqrt(0.5**2 + 1.0 / 12.0)  # standard deviation: lens, and a pixel's square
_BLACK, _WHITE, _BODY = 30.0, 215.0, 70.0  # greys of print, paper and robot in full light
_BODY_RADIUS = 0.8  # [tag sides]
_BODY_DROP_M = 0.02  # the body's top lies below the tag
_CELLS = 8  # of the tag's pattern, black rim included; a white cell lies around it
_REACH = 1.15  # from a robot's centre to beyond its blurred edge [tag sides]
_FLOOR_M = 0.002  # side of a pixel of the drawn floor
_RAMP = math.sqrt(20.0)  # width of a smooth step [standard deviations of its blur]
_TEXEL = 0.25  # of the pattern's texture [standard deviations of the blur]
_LEVELS = 6  # textures a tag, between the finest and the coarsest scale in the image


class SceneRenderer:
    """Draws what a calibrated camera sees of N tags. Same arguments and generator state, same images."""

    def __init__(
        self,
        geometry: CameraGeometry,
        image_size: tuple[int, int],
        tag_ids: Sequence[int],
        side_m: float,
        height_m: float,
        noise_gray: float,
        rng: np.random.Generator,
    ) -> None:
        """Take the image's (width, height), the N tags' ids, their black square's side and their height."""
        self._geometry, self._rng = geometry, rng
        self._side, self._heights = side_m, np.array([height_m, height_m - _BODY_DROP_M])
        x, y, z = geometry.position
        self._eye = (x, y, _BODY_DROP_M / (z - height_m))  # how far, of its way, a ray goes on to the bodies
        width, height = image_size
        v, u = np.mgrid[:height, :width].astype(np.float64)
        pixels = np.column_stack([u.ravel(), v.ravel()])
        plane = geometry.to_plane(pixels, height_m).reshape(height, width, 2)
        self._plane = plane.astype(np.float32)
        self._sigmas = _BLUR_PX * _scales(plane)
        self._textures = np.stack([_textures(tag, side_m, self._sigmas) for tag in tag_ids])
        self._gain = _uneven_light(u / width - 0.5, (v - 0.5 * height) / width, rng)
        floor = _floor(plane + (plane - [x, y]) * (height_m / (z - height_m)), side_m, rng)
        # Noise is stored with an offset that the background lacks: one saturating addition does both signs.
        self._offset = math.ceil(5.0 * noise_gray)
        bank = rng.normal(self._offset, noise_gray, 2 * width * height)
        self._bank = np.clip(np.rint(bank), 0, 2 * self._offset).astype(np.uint8)
        self._background = np.rint(np.maximum(floor * self._gain - self._offset, 0.0)).astype(np.uint8)
        self._image = np.empty((height, width), np.uint8)
        self.render(np.full((1, len(tag_ids), 3), np.nan))  # compiles the kernels, or loads them

    def render(self, poses: Array) -> Image:
        """Return the image (H, W) of poses (K, N, 3): x, y [m], psi [rad] at K instants of the exposure.

        A tag with a NaN is left out. The image is overwritten by the next call.
        """
        start = int(self._rng.integers(self._image.size))
        noise = self._bank[start : start + self._image.size].reshape(self._image.shape)
        cv2.add(self._background, noise, dst=self._image)
        points = np.empty((2, *poses.shape))
        points[..., :2] = poses[..., :2]
        points[..., 2] = self._heights[:, None, None]
        centres = self._geometry.project(points.reshape(-1, 3)).reshape(2, *poses.shape[:2], 2)
        _draw(
            self._image, noise, self._offset, self._plane, self._gain, self._textures, self._sigmas,
            self._side, self._eye, poses, centres, np.flatnonzero(np.isfinite(poses).all((0, 2))),
        )  # fmt: skip
        return self._image


def _scales(plane: Array) -> Array:
    """Return metres a pixel, (_LEVELS,), from the finest to the coarsest of the map ``plane`` (H, W, 2)."""
    d_u, d_v = plane[1:, 1:] - plane[1:, :-1], plane[1:, 1:] - plane[:-1, 1:]
    scale = np.sqrt(np.abs(d_u[..., 0] * d_v[..., 1] - d_u[..., 1] * d_v[..., 0]))
    return np.geomspace(scale.min(), scale.max(), _LEVELS)


def _pattern(tag: int) -> Array:
    """Return the tag's cells (8, 8), 0 black and 1 white, row 0 at the top as OpenCV prints it."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return np.asarray(dictionary.generateImageMarker(tag, _CELLS) > 0, dtype=np.float64)


def _textures(tag: int, side: float, sigmas: Array) -> Array32:
    """Return the pattern (levels, S, S) on endless white paper, blurred by ``sigmas`` (levels,) [m]."""
    texel = _TEXEL * sigmas[0]
    half = math.ceil((side / 2 + 4 * sigmas[-1]) / texel)
    at = np.arange(-half, half + 1) * texel
    edges = (np.arange(_CELLS + 1) / _CELLS - 0.5) * side
    levels = []
    for sigma in sigmas:
        steps = np.vectorize(math.erf)((at[:, None] - edges) / (sigma * math.sqrt(2.0))) / 2.0
        cells = steps[:, :-1] - steps[:, 1:]
        levels.append(_WHITE - (_WHITE - _BLACK) * cells @ (1.0 - _pattern(tag)) @ cells.T)
    return np.array(levels, dtype=np.float32)


def _uneven_light(u: Array, v: Array, rng: np.random.Generator) -> Array32:
    """Return the gain (H, W) in [0.65, 1]: lamps to one side, and the lens darker in its corners."""
    angle = rng.uniform(-math.pi, math.pi)
    gain = 0.9 + 0.15 * (u * math.cos(angle) + v * math.sin(angle)) - 0.3 * (u * u + v * v)
    return np.asarray(gain, dtype=np.float32)


def _floor(xy: Array, side: float, rng: np.random.Generator) -> Array:
    """Return greys (H, W) of a cluttered floor at points ``xy`` (H, W, 2) [m]."""
    low, high = xy.min((0, 1)), xy.max((0, 1))
    w, h = np.ceil((high - low) / _FLOOR_M).astype(int) + 1
    size = np.array([w, h])
    wood = rng.integers(120, 150, (12, 20), dtype=np.uint8)
    floor = np.asarray(cv2.resize(wood, (w, h), interpolation=cv2.INTER_CUBIC), np.uint8)
    for _ in range(12):  # scraps, and patches of bright light
        patch = (rng.uniform(0, size).tolist(), rng.uniform(20, 140, 2).tolist(), rng.uniform(0, 180))
        cv2.ellipse(floor, patch, int(rng.choice([60, 90, 180, 245])), -1, cv2.LINE_AA)
    for _ in range(10):  # tape
        a, b = rng.integers(0, size, (2, 2))
        cv2.line(floor, a, b, int(rng.choice([50, 200])), int(rng.integers(2, 12)), cv2.LINE_AA)
    for _ in range(4):  # cables
        heading = rng.normal(0.0, 0.2, 120).cumsum()
        bends = rng.uniform(0, size) + 8.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1).cumsum(0)
        cv2.polylines(floor, [bends.astype(np.int32)], False, 45, 4, cv2.LINE_AA)
    for _ in range(12):  # prints that look like tags
        cells = np.zeros((_CELLS, _CELLS), np.uint8)
        cells[1:-1, 1:-1] = rng.integers(0, 2, (_CELLS - 2, _CELLS - 2))
        _paste(floor, 30 + 180 * np.pad(cells, 1, constant_values=1), side, rng)
    at = ((xy - low) / _FLOOR_M).astype(np.float32)
    floor = np.asarray(cv2.GaussianBlur(floor, (0, 0), _BLUR_PX * 1.5), np.uint8)  # a pixel is 1.5 of the floor's
    return np.asarray(cv2.remap(floor, at[..., 0], at[..., 1], cv2.INTER_LINEAR), np.float64)


def _paste(floor: Image, cells: Image, side: float, rng: np.random.Generator) -> None:
    """Lay a print of ``cells`` somewhere onto ``floor``."""
    scale, angle = side / (_CELLS * _FLOOR_M), rng.uniform(-math.pi, math.pi)
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    x, y = rng.uniform(0, floor.shape[::-1])
    onto = np.array([[c, -s, x], [s, c, y]])
    cv2.warpAffine(cells, onto, floor.shape[::-1], floor, cv2.INTER_NEAREST, cv2.BORDER_TRANSPARENT)


@image_kernel
def _draw(  # type: ignore[no-untyped-def]
    image, noise, offset, plane, gain, textures, sigmas, side, eye, poses, centres, seen
):
    """Blend robots ``seen`` into background and noise; ``centres`` (2, K, N, 2) [px]: tags, bodies."""
    instants = np.empty((poses.shape[0], 4))
    for n in seen:
        for k in range(poses.shape[0]):
            x, y, psi = poses[k, n]
            instants[k] = (x, y, math.cos(psi), math.sin(psi))
        us, vs = centres[:, :, n, 0], centres[:, :, n, 1]
        scale = _scale(plane, us[0, 0], vs[0, 0])
        level = np.argmin(np.abs(sigmas - _BLUR_PX * scale))
        texture, sigma, texel = textures[n, level], sigmas[level], _TEXEL * sigmas[0]
        reach = _REACH * side / scale + 2.0
        left, right = max(0, int(us.min() - reach)), min(image.shape[1], int(us.max() + reach) + 1)
        top, bottom = max(0, int(vs.min() - reach)), min(image.shape[0], int(vs.max() + reach) + 1)
        for i in range(top, bottom):
            for j in range(left, right):
                x, y = plane[i, j, 0], plane[i, j, 1]
                cover, light = _look(x, y, instants, texture, sigma, texel, side, eye)
                if cover > 0.0:
                    gray = image[i, j] * (1.0 - cover) + light * gain[i, j] + (noise[i, j] - offset) * cover
                    image[i, j] = min(max(int(gray + 0.5), 0), 255)


@image_kernel
def _scale(plane, u, v):  # type: ignore[no-untyped-def]
    """Return metres a pixel of the plane at a pixel, or at the image's nearest one."""
    i, j = min(max(int(v), 1), plane.shape[0] - 1), min(max(int(u), 1), plane.shape[1] - 1)
    d_u, d_v = plane[i, j] - plane[i, j - 1], plane[i, j] - plane[i - 1, j]
    return math.sqrt(abs(d_u[0] * d_v[1] - d_u[1] * d_v[0]))


@image_kernel
def _look(x, y, instants, texture, sigma, texel, side, eye):  # type: ignore[no-untyped-def]
    """Return how much of the floor a robot hides at x, y [m; tags' plane], and its grey times that."""
    ramp, paper, middle = 1.0 / (_RAMP * sigma), side / 2 + side / _CELLS, (texture.shape[0] - 1) / 2
    below_x, below_y = x + (x - eye[0]) * eye[2], y + (y - eye[1]) * eye[2]
    cover = light = 0.0
    for k in range(instants.shape[0]):
        x_k, y_k, c, s = instants[k, 0], instants[k, 1], instants[k, 2], instants[k, 3]
        a, b = c * (x - x_k) + s * (y - y_k), c * (y - y_k) - s * (x - x_k)
        sheet = _step((paper - abs(a)) * ramp) * _step((paper - abs(b)) * ramp)
        radius = math.sqrt((below_x - x_k) ** 2 + (below_y - y_k) ** 2)
        body = (1.0 - sheet) * _step((_BODY_RADIUS * side - radius) * ramp)
        cover += sheet + body
        light += body * _BODY
        if sheet > 0.0:
            light += sheet * _bilinear(texture, middle - b / texel, middle + a / texel)
    return cover / instants.shape[0], light / instants.shape[0]


@image_kernel
def _step(d):  # type: ignore[no-untyped-def]
    """Return the smooth step from 0 at d = -1/2 to 1 at 1/2."""
    t = min(max(d + 0.5, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@image_kernel
def _bilinear(texture, row, column):  # type: ignore[no-untyped-def]
    """Return the texture between its four texels; its rim goes on for ever."""
    last = texture.shape[0] - 1
    row, column = min(max(row, 0.0), last - 1e-3), min(max(column, 0.0), last - 1e-3)
    i, j = int(row), int(column)
    p, q = row - i, column - j
    upper = texture[i, j] + q * (texture[i, j + 1] - texture[i, j])
    lower = texture[i + 1, j] + q * (texture[i + 1, j + 1] - texture[i + 1, j])
    return upper + p * (lower - upper)

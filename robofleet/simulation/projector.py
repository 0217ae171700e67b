"""The light of a simulated projector where a camera sees it: gamma, black level, vignetting, focus and delay.

Blur of projector and camera together is laid over the picture before it is sampled: so edges lie where they should,
however coarse the camera's pixels are. No robot throws a shadow.
"""

import math
from collections import deque
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus
from robofleet.config.projectors import ProjectorSettings, SimulatedProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.arrays import Array32, Flags, Image
from robofleet.core.clock import S
from robofleet.projection.model import Projector
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.run_picture import RunPicture

_NOWHERE = -1e4  # a pixel that no picture has
_TILE = 32  # side of what is lit anew as a whole [px]
_BLUR_REACH = 4.0  # of a Gaussian [standard deviations]

Map = tuple[Array32, Array32]  # pixels of a projector, u and v (H, W)
Rectangle = tuple[slice, slice]  # rows, columns


class SimulatedProjector:
    """A projector, and what it shows when."""

    def __init__(self, settings: ProjectorSettings, simulated: SimulatedProjectorSettings) -> None:
        self._simulated, self.projector = simulated, Projector.from_model(simulated.model)
        self._delay_ns, self._period_ns = round(simulated.model.delay_s * S), round(S / simulated.rate_hz)
        self._coming: deque[tuple[int, Image]] = deque()  # from when on it is lit, and the picture
        self._picture: Image | None = None
        w, h = settings.width, settings.height
        v, u = np.mgrid[:h, :w].astype(np.float32)
        squared = ((u - (w - 1) / 2) ** 2 + (v - (h - 1) / 2) ** 2) / (((w - 1) / 2) ** 2 + ((h - 1) / 2) ** 2)
        self._even = simulated.brightness * (1.0 - simulated.vignetting * squared)
        grays = (np.arange(256) / 255.0) ** simulated.gamma
        self._linear = (simulated.black + (1.0 - simulated.black) * grays).astype(np.float32)
        self.light = np.zeros((h, w), np.float32)  # of its pixels [shares of full light], blurred by the camera, too
        self._sigma_px = 0.0

    def show(self, picture: Image, now_ns: int) -> None:
        """Take a picture (H, W), whose light comes after the projector's own delay."""
        self._coming.append((now_ns + self._delay_ns, picture))

    def drawn_ns(self, now_ns: int) -> int:
        """Return when the picture of a run was drawn that is lit at an instant."""
        return (now_ns - self._delay_ns) // self._period_ns * self._period_ns

    def update(self, now_ns: int, blur_px: float) -> Flags:
        """Go on to what is lit at an instant, for a camera's blur; returns which tiles of ``light`` changed."""
        before, sigma = self._picture, math.hypot(self._simulated.focus_px, blur_px)
        while self._coming and self._coming[0][0] <= now_ns:
            self._picture = self._coming.popleft()[1]
        if self._picture is None:
            return np.zeros(_tiled(self.light.shape), np.bool_)
        if before is None or sigma != self._sigma_px:
            changed = np.ones(_tiled(self.light.shape), np.bool_)
        else:
            around = np.ones((2 * math.ceil(_BLUR_REACH * sigma / _TILE) + 1,) * 2, np.uint8)
            changed = cv2.dilate(_by_tile(np.logical_or, before != self._picture).astype(np.uint8), around) > 0
        self._sigma_px = sigma
        for part in _parts(changed, self.light.shape):
            self._blur(self._picture, part)
        return changed

    def _blur(self, picture: Image, part: Rectangle) -> None:
        reach = math.ceil(_BLUR_REACH * self._sigma_px) + 1
        wide = tuple(slice(max(0, side.start - reach), side.stop + reach) for side in part)
        blurred = cv2.GaussianBlur(
            self._linear[picture[wide]] * self._even[wide], (0, 0), self._sigma_px, borderType=cv2.BORDER_CONSTANT
        )
        inner = tuple(
            slice(side.start - around.start, side.stop - around.start) for side, around in zip(part, wide, strict=True)
        )
        self.light[part] = blurred[inner]

    def map(self, x: Array32, y: Array32, height_m: float) -> Map:
        """Return the projector's pixels that light points x, y (H, W) [m] at a height."""
        points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])
        u, v = np.nan_to_num(self.projector.pixels(points), nan=_NOWHERE).astype(np.float32).T
        return np.ascontiguousarray(u).reshape(x.shape), np.ascontiguousarray(v).reshape(x.shape)


class Projection:
    """The light of all simulated projectors in one camera's image."""

    def __init__(self, config: Config, bus: Bus) -> None:
        """``bus``: of the run that calibrated projectors show, if there is one."""
        simulated = [(each, each.simulated) for each in config.projectors if each.simulated is not None]
        self.projectors = {each.name: SimulatedProjector(each, truth) for each, truth in simulated}
        self._runs = {
            each.name: RunPicture(config, each, truth.rate_hz, bus) for each, truth in simulated if each.calibration
        }
        self._maps: list[list[_TiledMap]] = []  # of each projector, on the floor and at the tags' height
        self.light: tuple[Array32, Array32]  # on both [shares of full light]
        self._sensitivity = 0.0

    def fall_on(self, renderer: SceneRenderer, now_ns: int, sensitivity: float, *, moved: bool) -> None:
        """Light what a renderer draws as at an instant, to a camera of some sensitivity; ``moved``: it hangs anew."""
        projectors = self.projectors.values()
        for name, run in self._runs.items():
            drawn_ns = self.projectors[name].drawn_ns(now_ns)
            if (picture := run.at(drawn_ns)) is not None:
                self.projectors[name].show(picture, drawn_ns)
        anew = moved or not self._maps
        if anew:
            planes = renderer.planes()
            self._maps = [[_TiledMap(projector.map(*plane)) for plane in planes] for projector in projectors]
            self.light = np.zeros_like(planes[0][0]), np.zeros_like(planes[0][0])
        changed = np.zeros(_tiled(self.light[0].shape), np.bool_)
        for projector, maps in zip(projectors, self._maps, strict=True):
            tiles = projector.update(now_ns, renderer.blur_px * maps[0].magnification)
            for each in maps:
                changed |= each.shows(tiles)
        if anew or sensitivity != self._sensitivity:
            changed[:] = True
        self._sensitivity = sensitivity
        parts = _parts(changed, self.light[0].shape)
        for part in parts:
            for plane, light in enumerate(self.light):
                light[part] = sensitivity * sum(
                    maps[plane].light(projector.light, part)
                    for projector, maps in zip(projectors, self._maps, strict=True)
                )
        if parts:
            renderer.project(*self.light, parts)


class _TiledMap:
    """Where a camera's pixels (H, W) are in a projector's picture."""

    def __init__(self, pixels: Map) -> None:
        self._pixels = u, v = pixels
        lit = u > _NOWHERE
        step = np.hypot(np.diff(u, axis=1), np.diff(v, axis=1))[lit[:, 1:] & lit[:, :-1]]
        self.magnification = float(np.median(step)) if step.size else 1.0  # pixels of it in one of the camera's
        ends = [
            _by_tile(end, np.where(lit, axis, np.nan)) // _TILE + late
            for axis in (v, u) for end, late in ((np.fmin, 0), (np.fmax, 1))
        ]  # fmt: skip
        self._ends = np.nan_to_num(np.stack(ends), nan=0.0).astype(np.intp)  # of tiles: top, bottom, left, right

    def shows(self, tiles: Flags) -> Flags:
        """Return which of the camera's tiles show any of a projector's."""
        (top, bottom, left, right), sums = self._ends, cv2.integral(tiles.astype(np.uint8))
        return np.asarray(sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] > 0)

    def light(self, light: Array32, part: Rectangle) -> Array32:
        u, v = self._pixels
        return np.asarray(cv2.remap(light, u[part], v[part], cv2.INTER_LINEAR), np.float32)


def _tiled(shape: tuple[int, ...]) -> tuple[int, int]:
    return -(-shape[0] // _TILE), -(-shape[1] // _TILE)


def _by_tile(reduce: np.ufunc, values: NDArray[Any]) -> NDArray[Any]:
    rows, columns = (np.arange(0, side, _TILE) for side in values.shape)
    return np.asarray(reduce.reduceat(reduce.reduceat(values, rows, axis=0), columns, axis=1))


def _parts(tiles: Flags, shape: tuple[int, ...]) -> list[Rectangle]:
    """Return rectangles that hold tiles of an image."""
    _, _, boxes, _ = cv2.connectedComponentsWithStats(tiles.astype(np.uint8), connectivity=4)
    ends = (_TILE * np.column_stack([boxes[1:, :2], boxes[1:, :2] + boxes[1:, 2:4]])).tolist()
    return [(slice(top, min(bottom, shape[0])), slice(left, min(right, shape[1]))) for left, top, right, bottom in ends]

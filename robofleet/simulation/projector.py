"""The light of a simulated projector where a camera sees it: gamma, black level, vignetting, focus and delay.

Blur of projector and camera together is laid over the picture before it is sampled: so edges lie where they should,
however coarse the camera's pixels are. No robot throws a shadow.
"""

import math
from collections import deque
from collections.abc import Sequence

import cv2
import numpy as np

from robofleet.bus.bus import Bus
from robofleet.config.projectors import ProjectorSettings, SimulatedProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.arrays import Array32, Image
from robofleet.core.clock import S
from robofleet.projection.model import Projector
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.run_picture import RunPicture

_NOWHERE = -1e4  # a pixel that no picture has

Map = tuple[Array32, Array32]  # pixels of a projector, u and v (H, W)


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

    def show(self, picture: Image, now_ns: int) -> None:
        """Take a picture (H, W), whose light comes after the projector's own delay."""
        self._coming.append((now_ns + self._delay_ns, picture))

    def drawn_ns(self, now_ns: int) -> int:
        """Return when the picture was drawn that a run has lit at an instant."""
        return (now_ns - self._delay_ns) // self._period_ns * self._period_ns

    def changes(self, now_ns: int) -> bool:
        """Go on to what is lit at an instant; returns whether that is another picture than before."""
        changed = False
        while self._coming and self._coming[0][0] <= now_ns:
            self._picture, changed = self._coming.popleft()[1], True
        return changed

    def light(self, maps: Sequence[Map], blur_px: float) -> list[Array32]:
        """Return the light (H, W) [shares of full light] at each of several ``maps``, blurred by a camera, too."""
        if self._picture is None:
            return [np.zeros(u.shape, np.float32) for u, _ in maps]
        sigma = math.hypot(self._simulated.focus_px, blur_px)
        shown = self._linear[self._picture] * self._even
        blurred = cv2.GaussianBlur(shown, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        return [np.asarray(cv2.remap(blurred, u, v, cv2.INTER_LINEAR), np.float32) for u, v in maps]

    def map(self, x: Array32, y: Array32, height_m: float) -> Map:
        """Return the projector's pixels that light points x, y (H, W) [m] at a height."""
        points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height_m)])
        u, v = np.nan_to_num(self.projector.pixels(points), nan=_NOWHERE).astype(np.float32).T
        return np.ascontiguousarray(u).reshape(x.shape), np.ascontiguousarray(v).reshape(x.shape)


class Projection:
    """The light of all simulated projectors in one camera's image."""

    def __init__(self, config: Config, bus: Bus) -> None:
        """``bus``: of the run that calibrated projectors show, if there is one."""
        self.projectors = {
            projector.name: SimulatedProjector(projector, projector.simulated)
            for projector in config.projectors
            if projector.simulated is not None
        }
        self._runs = {
            projector.name: RunPicture(config, projector, projector.simulated.rate_hz, bus)
            for projector in config.projectors
            if projector.simulated is not None and projector.calibration is not None
        }
        self._maps: list[list[Map]] = []  # of each projector, on the floor and at the tags' height
        self._sensitivity = 0.0

    def fall_on(self, renderer: SceneRenderer, now_ns: int, sensitivity: float, *, moved: bool) -> None:
        """Light what a renderer draws as at an instant, to a camera of some sensitivity; ``moved``: it hangs anew."""
        projectors = self.projectors.values()
        for name, run in self._runs.items():
            drawn_ns = self.projectors[name].drawn_ns(now_ns)
            if (picture := run.at(drawn_ns)) is not None:
                self.projectors[name].show(picture, drawn_ns)
        changed = [projector.changes(now_ns) for projector in projectors]
        if not (moved or any(changed) or (self._maps and sensitivity != self._sensitivity)):
            return
        if moved or not self._maps:
            planes = renderer.planes()
            self._maps = [[projector.map(*plane) for plane in planes] for projector in projectors]
        self._sensitivity = sensitivity
        lights = [
            projector.light(maps, renderer.blur_px * _magnification(maps[0]))
            for projector, maps in zip(projectors, self._maps, strict=True)
        ]
        floor, tags = (np.asarray(sensitivity * sum(parts), np.float32) for parts in zip(*lights, strict=True))
        renderer.project(floor, tags)


def _magnification(pixels: Map) -> float:
    """Return how many pixels of a projector there are in one of the camera's, typically; 1 where it sees none."""
    u, v = pixels
    step = np.hypot(np.diff(u, axis=1), np.diff(v, axis=1))
    lit = (u[:, 1:] > _NOWHERE) & (u[:, :-1] > _NOWHERE)
    return float(np.median(step[lit])) if lit.any() else 1.0

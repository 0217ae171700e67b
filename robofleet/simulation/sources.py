"""Simulated sources of poses: a rendered camera, and the truth with errors added."""

import math
from collections.abc import Iterator, Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus
from robofleet.bus.messages import TagPose
from robofleet.bus.ticks import TickFollower
from robofleet.config.faults import Complaint
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import MS, Clock, S
from robofleet.simulation.arena import World
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.effects import effects
from robofleet.simulation.projector import Projection
from robofleet.simulation.scene import ScenePlay, scene_renderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.cameras.exposure import nothing_left
from robofleet.tracking.sources import CameraContext, Exposure, ExposureLimits, Frame


class Trigger:
    """Gives mid-exposures one after the other; each is given once."""

    def __init__(self, config: Config, ticks: TickFollower, clock: Clock) -> None:
        self._ticks = ticks
        self._locked = config.camera.trigger == "tick"
        self._lead_ns = round(config.camera.trigger_lead_s * S)
        self._tick_ns = round(config.controller.tick_s * S)
        self._period_ns = round(S / config.camera.rate_hz)
        self._exposed_tick = 0
        self._pending: tuple[int, int] | None = None  # tick that triggered, mid-exposure [ns]: given, not yet read
        self._next_free_ns = clock.now_ns() + self._period_ns

    def next_ns(self) -> int | None:
        """Return the next mid-exposure [ns]; None while the tick that it follows has not come."""
        if not self._locked:
            return self._next_free_ns
        if self._pending is None and self._ticks.newest != self._exposed_tick:
            exposure_ns = self._ticks.newest_stamp_ns + self._tick_ns - self._lead_ns
            self._pending = self._ticks.newest, exposure_ns
        return None if self._pending is None else self._pending[1]

    def fire(self, now_ns: int) -> None:
        """Go on to the exposure after this one; with a clock of its own, those missed until ``now_ns`` are skipped."""
        if self._pending is not None:
            self._exposed_tick, _ = self._pending
            self._pending = None
        self._next_free_ns += self._period_ns * max(1, (now_ns - self._next_free_ns) // self._period_ns)


_POLL_NS = S // 1000
_EXPOSURE_LIMITS = ExposureLimits(Exposure(1e-5, 0.0), Exposure(1.0, 24.0), Exposure(1e-5, 0.1), 1.0)


class Renderer(Protocol):
    """Draws what a calibrated camera sees of N robots: as ``SceneRenderer``."""

    looks: NDArray[np.int64]

    def moved(self, geometry: CameraGeometry) -> None: ...

    def expose(self, exposure_s: float, light: float, noise: float) -> None: ...

    def render(self, poses: Array, velocities: Array | None = None) -> Image: ...

    def rows(self, poses: Array) -> Array: ...


class SimulatedCamera:
    """Renders what an overhead camera would see. A camera like any other: what reads it cannot tell."""

    def __init__(self, context: CameraContext) -> None:
        config, camera = context.config, context.config.camera
        self.identity = camera.model.camera or "simulated"  # it is the camera that is configured
        self._clock, self._ticks = context.clock, context.ticks
        self._world = World(config, config.seen, context.bus)
        self._trigger = Trigger(config, context.ticks, context.clock)
        self._line_ns, self._middle = camera.model.line_time_s * S, (camera.height - 1) / 2
        half_ns = self._line_ns * self._middle  # from the first row to the middle one, and on to the last
        self._readout_ns = max(camera.readout_s * S - half_ns, half_ns)  # no image before its last row was exposed
        self._extra_ns, self._full_s = context.extra_delay_ns, camera.exposure_s
        self._exposure = self._next_exposure = Exposure(
            camera.exposure_s, 0.0
        )  # of the next image, and of those after it
        self._play = ScenePlay(config)
        self._renderer = self.renderer(config, context.rng)
        lit = isinstance(self._renderer, SceneRenderer) and any(projector.simulated for projector in config.projectors)
        self.projection = Projection(config, context.bus) if lit else None
        self._effects = effects(camera.simulated, (camera.width, camera.height), context.rng)
        self._image: NDArray[np.uint8] | None = None

    @staticmethod
    def renderer(config: Config, rng: np.random.Generator) -> Renderer:
        """Return what draws the images."""
        return scene_renderer(config, rng)

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        if config.camera.adjusts_exposure:
            yield from nothing_left(config, _EXPOSURE_LIMITS)
        background = config.projection.background
        lit = any(projector.simulated and projector.calibration for projector in config.projectors)
        if lit and background is not None and not cv2.haveImageReader(background):
            yield "projection.background", f"{background} is no image: name a PNG, JPEG or WebP"

    def ready_ns(self) -> int | None:
        """Return when the next image will be read out; None while its trigger has not come.

        Images of a camera that has stalled are skipped.
        """
        exposure_ns = self._trigger.next_ns()
        while exposure_ns is not None and (stalled_s := self._play.stalled_for(self._since_start(exposure_ns))):
            self._trigger.fire(exposure_ns + round(stalled_s * S))
            exposure_ns = self._trigger.next_ns()
        return None if exposure_ns is None else exposure_ns + self._after_ns()

    def read(self) -> Frame:
        while (ready_ns := self.ready_ns()) is None:
            self._ticks.update()
            self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        self._clock.sleep_until(ready_ns)
        exposure_ns = ready_ns - self._after_ns()
        self._trigger.fire(self._clock.now_ns())
        self._world.update()
        exposure, self._exposure = self._exposure, self._next_exposure
        t = self._since_start(exposure_ns)
        if self._image is None or not self._play.frozen(t):
            self._image = self._picture(exposure_ns, t, exposure)
        return Frame(self._image, exposure_ns, exposure)

    def exposure_limits(self) -> ExposureLimits:
        """Return what it can be set to. Its gain is in decibels."""
        return _EXPOSURE_LIMITS

    def adjust(self, exposure: Exposure) -> None:
        """Expose so from the image after the next one, which may have begun. Mid-exposures stay where they are."""
        self._next_exposure = exposure

    def project(self, projector: str, picture: Image) -> None:
        """Let a simulated projector show a picture (H, W) from now on."""
        assert self.projection is not None, f"{projector} is not simulated"
        self.projection.projectors[projector].show(picture, self._clock.now_ns())

    def close(self) -> None:
        """Nothing to let go of."""

    def _after_ns(self) -> int:
        """Return the time from the next image's mid-exposure until it is there."""
        return round(self._exposure.time_s / 2 * S + self._readout_ns) + self._extra_ns

    def _since_start(self, exposure_ns: int) -> float:
        """Return seconds since the run began; 0 before."""
        began_ns = self._ticks.began_ns
        return max(0.0, (exposure_ns - began_ns) / S) if began_ns else 0.0

    def _picture(self, exposure_ns: int, t: float, exposure: Exposure) -> NDArray[np.uint8]:
        gain = 10.0 ** (exposure.gain / 20.0)
        sensitivity = gain * exposure.time_s / self._full_s
        self._renderer.expose(exposure.time_s, self._play.light(t) * sensitivity, gain)
        half_ns = max(MS, round(exposure.time_s * S / 2))
        geometry = self._play.camera(t)
        if geometry is not None:
            self._renderer.moved(geometry)
        if self.projection is not None and isinstance(self._renderer, SceneRenderer):
            self.projection.fall_on(self._renderer, exposure_ns, sensitivity, moved=geometry is not None)
        self._renderer.looks = self._play.looks(t)
        instants_ns = np.full(len(self._world.tags), exposure_ns)
        poses, velocities = self._world.moving(instants_ns, half_ns)
        if self._line_ns:
            rows = np.nan_to_num(self._renderer.rows(poses), nan=self._middle)
            instants_ns += np.rint((rows - self._middle) * self._line_ns).astype(np.int64)
            poses, velocities = self._world.moving(instants_ns, half_ns)
        image = self._renderer.render(poses, velocities)
        if self._effects:
            image = image.copy()
        for effect in self._effects:
            effect(image, t)
        return image


class VirtualPoses:
    """Poses of robots that no image shows: the truth with noise and dropout, as ``tracker.truth`` has them."""

    def __init__(self, config: Config, robots: Sequence[Robot], bus: Bus, rng: np.random.Generator) -> None:
        self._world, self._rng = World(config, robots, bus), rng
        p = config.tracker.truth
        self._sigma, self._dropout = np.array([p.position_noise_m, p.position_noise_m, p.heading_noise_rad]), p.dropout

    def at(self, exposure_ns: int) -> tuple[TagPose, ...]:
        """Return what an image of that instant would have told; nothing of a robot that does not say where it is."""
        n = len(self._world.tags)
        if not n:
            return ()
        self._world.update()
        noise = self._sigma * self._rng.standard_normal((n, 3))
        dropped = (self._rng.random(n) < self._dropout).tolist()
        poses = (self._world.reported_at(exposure_ns) + noise).tolist()
        return tuple(
            TagPose(tag, 0, 0, x, y, psi)
            for tag, (x, y, psi), drop in zip(self._world.tags, poses, dropped, strict=True)
            if not (drop or math.isnan(x))
        )

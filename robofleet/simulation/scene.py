"""The scene of a configuration, and what happens in it while the camera looks. Time: since the run began [s]."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config import obstacles
from robofleet.config.calibrated import TagOffset
from robofleet.config.camera import Cover, Knock, Outage, SimulatedCameraSettings, TruePrint
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.simulation.camera import Print, SceneRenderer
from robofleet.simulation.effects import shade
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target, floor_targets, robot_targets

_SLOW_STEPS = 20  # in which a slow knock is done
_LIGHT_STEP = 0.02  # by which daylight changes, at least


def scene_renderer(config: Config, rng: np.random.Generator) -> SceneRenderer:
    """Return what draws the configuration's robots, floor tags, posters and obstacles."""
    camera, simulated = config.camera, config.camera.simulated
    true = [_true_print(simulated, robot.id) for robot in config.seen]
    return SceneRenderer(
        CameraGeometry.from_model(camera.model),
        (camera.width, camera.height),
        true_targets(config),
        camera.noise_gray,
        rng,
        exposure_s=camera.exposure_s,
        line_time_s=camera.model.line_time_s,
        prints=lying_prints(config),
        offsets=true_offset_rows(config),
        light=light_at(simulated, 0.0),
        obstacles=[solid.outline for solid in obstacles.standing(config.arena)],
        lens_sigma_px=simulated.lens_sigma_px,
        shade=shade(simulated, (camera.width, camera.height)),
        stretches=np.array([tag.stretch for tag in true]).reshape(-1, 2),
        bows=np.array([tag.bow_m for tag in true]),
    )


def lying_prints(config: Config) -> list[Print]:
    """Return the floor tags and posters."""
    lying = [*config.tracker.floor_tags, *config.camera.simulated.posters]
    return [
        Print(target, tag.x_m, tag.y_m, math.radians(tag.heading_deg))
        for target, tag in zip(floor_targets(config, lying), lying, strict=True)
    ]


def true_offset_rows(config: Config) -> Array:
    """Return ``true_offsets`` (N, 3): forward, left [m], turn [rad]."""
    return np.array([(o.forward_m, o.left_m, math.radians(o.heading_deg)) for o in true_offsets(config)])


def true_offsets(config: Config) -> list[TagOffset]:
    """Return where the tags, or bodies, of the robots that are seen sit: as simulated, else as measured."""
    true = {offset.robot: offset for offset in config.camera.simulated.tag_offsets}
    return [true.get(robot.id, robot.tag_offset) for robot in config.seen]


def true_targets(config: Config) -> list[Target]:
    """Return the robots' tags, at the heights where they lie as simulated."""
    heights = {offset.robot: offset.height_m for offset in config.camera.simulated.tag_offsets}
    return [
        target if (height := heights.get(robot.id)) is None else target._replace(height=height)
        for robot, target in zip(config.seen, robot_targets(config), strict=True)
    ]


def _true_print(settings: SimulatedCameraSettings, robot: str) -> TruePrint:
    """Return a robot's own print, else that of all others."""
    by_robot = {tag.robot: tag for tag in settings.prints}
    return by_robot.get(robot, by_robot.get(None, TruePrint()))


def light_at(settings: SimulatedCameraSettings, t: float) -> float:
    if not settings.daylight:
        return settings.light
    return float(np.interp(t, *np.array([(then.at_s, then.light) for then in settings.daylight]).T))


class ScenePlay:
    """The timed parts of ``camera.simulated``."""

    def __init__(self, config: Config) -> None:
        self._settings = config.camera.simulated
        self._rows = {robot.id: row for row, robot in enumerate(config.seen)}
        self._calibrated = CameraGeometry.from_model(config.camera.model)
        self._light = light_at(self._settings, 0.0)
        self._progress = [0.0] * len(self._settings.knocks)

    def light(self, t: float) -> float:
        """Return the share of full light; daylight changes in small steps."""
        now = light_at(self._settings, t)
        if abs(now - self._light) > _LIGHT_STEP * self._light:
            self._light = now
        return self._light

    def looks(self, t: float) -> NDArray[np.int64]:
        """Return (N,) whose tag each robot carries; N for plain paper."""
        looks = np.arange(len(self._rows))
        for swap in self._settings.swaps:
            if t >= swap.at_s:
                first, other = (self._rows[robot] for robot in swap.robots)
                looks[[first, other]] = looks[[other, first]]
        for cover in self._settings.covers:
            if _remaining(cover, t) > 0.0:
                looks[self._rows[cover.robot]] = len(looks)
        return looks

    def frozen(self, t: float) -> bool:
        return any(outage.kind == "frozen" and _remaining(outage, t) > 0.0 for outage in self._settings.outages)

    def stalled_for(self, t: float) -> float:
        """Return for how long no image will come [s]."""
        stalls = (_remaining(outage, t) for outage in self._settings.outages if outage.kind == "stalled")
        return max(stalls, default=0.0)

    def camera(self, t: float) -> CameraGeometry | None:
        """Return where the camera hangs now, None if it has not moved since the last call."""
        progress, breathing = [_progress(knock, t) for knock in self._settings.knocks], self._settings.breathing
        if progress == self._progress and breathing is None:
            return None
        self._progress = progress
        old = self._calibrated
        K, T = old.K.copy(), old.T_world_camera.copy()
        for knock, share in zip(self._settings.knocks, progress, strict=True):
            K[:2, :2] *= 1.0 + share * (knock.focal_ratio - 1.0)
            T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(share * np.radians(np.array(knock.rotation_deg)))[0]
            T[:3, 3] += share * np.array(knock.shift_m)
        if breathing is not None:
            K[:2, :2] *= math.exp(breathing.ratio * math.sin(math.tau * t / breathing.period_s))
        return CameraGeometry(K, old.distortion, T, old.lens)


def _remaining(event: Outage | Cover, t: float) -> float:
    """Return for how long an event will go on [s]; 0 if it is not under way."""
    return max(0.0, event.at_s + event.duration_s - t) if t >= event.at_s else 0.0


def _progress(knock: Knock, t: float) -> float:
    """Return how much of a knock has happened, in [0, 1]."""
    if t < knock.at_s or knock.over_s == 0.0:
        return float(t >= knock.at_s)
    return min(1.0, math.floor(_SLOW_STEPS * (t - knock.at_s) / knock.over_s) / _SLOW_STEPS)

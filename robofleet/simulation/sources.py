"""Where poses come from when there is no laboratory: a rendered camera, or the truth with errors added."""

from typing import NamedTuple

import numpy as np

from robofleet.clock import Clock, S
from robofleet.comms.bus import Bus, Stream
from robofleet.comms.keys import TRUTH, key
from robofleet.comms.messages import TRUTH as TRUTH_LAYOUT
from robofleet.config.tree import Config
from robofleet.simulation.arena import TruthHistory
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.trigger import Ticks, Trigger
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraContext, Frame

_BLUR_INSTANTS = 3
_HISTORY = 32  # true samples a robot, 10 ms apart
_POLL_NS = S // 1000


class World:
    """The true poses that the simulated drivers publish: all that a simulated source knows."""

    def __init__(self, config: Config, bus: Bus) -> None:
        self.tags = [robot.tag for robot in config.robots]
        self._streams: list[Stream] = [
            bus.stream(key(config.arena.name, TRUTH, robot.id), _HISTORY) for robot in config.robots
        ]
        self._histories = [TruthHistory(_HISTORY) for _ in self._streams]

    def update(self) -> None:
        """Take what the drivers said since the last call."""
        for stream, history in zip(self._streams, self._histories, strict=True):
            for _, payload in stream.drain():
                truth = TRUTH_LAYOUT.decode(payload)
                if truth is not None:
                    history.add(*truth[2:])

    def poses_at(self, instant_ns: int) -> list[tuple[float, float, float] | None]:
        """Return x, y [m], psi [rad] of each robot; None for one that has not spoken yet."""
        return [history.pose_at(instant_ns) for history in self._histories]


class SimulatedCamera:
    """Renders what an overhead camera would see. A camera like any other: what reads it cannot tell."""

    def __init__(self, context: CameraContext) -> None:
        config, camera = context.config, context.config.camera
        self._clock, self._ticks = context.clock, context.ticks
        self._world = World(config, context.bus)
        self._trigger = Trigger(config, context.ticks, context.clock)
        self._after_ns = round((camera.exposure_s / 2 + camera.readout_s) * S) + context.extra_delay_ns
        self._instants_ns = np.linspace(-0.5, 0.5, _BLUR_INSTANTS) * camera.exposure_s * S
        self._renderer = SceneRenderer(
            CameraGeometry.from_model(camera.model),
            (camera.width, camera.height),
            self._world.tags,
            config.tracker.tag_side_m,
            config.tracker.tag_height_m,
            camera.noise_gray,
            context.rng,
        )

    def ready_ns(self) -> int | None:
        """Return when the next image will be read out; None while its trigger has not come."""
        exposure_ns = self._trigger.next_ns()
        return None if exposure_ns is None else exposure_ns + self._after_ns

    def read(self) -> Frame:
        """Wait for the next image, and render it."""
        while (ready_ns := self.ready_ns()) is None:
            self._ticks.update()
            self._clock.sleep_until(self._clock.now_ns() + _POLL_NS)
        self._clock.sleep_until(ready_ns)
        exposure_ns = ready_ns - self._after_ns
        self._trigger.fire(self._clock.now_ns())
        self._world.update()
        poses = np.array(
            [
                [pose or (np.nan, np.nan, np.nan) for pose in self._world.poses_at(int(exposure_ns + offset))]
                for offset in self._instants_ns
            ]
        )
        return Frame(self._renderer.render(poses), exposure_ns)

    def close(self) -> None:
        """Nothing to let go of."""


class TruePoses(NamedTuple):
    """One image's worth of poses that were never an image."""

    exposure_ns: int
    poses: list[tuple[int, float, float, float]]  # tag, x, y [m], psi [rad]


class TruthSource:
    """Poses without pixels: the truth with noise, delay, jitter and dropout."""

    def __init__(self, config: Config, bus: Bus, ticks: Ticks, clock: Clock, rng: np.random.Generator) -> None:
        self._settings = config.tracker.truth
        self._clock, self._rng = clock, rng
        self._world = World(config, bus)
        self._trigger = Trigger(config, ticks, clock)
        n = len(self._world.tags)
        p = self._settings
        self._sigma = np.array([p.position_noise_m, p.position_noise_m, p.heading_noise_rad])
        self._shape = (n, 3)
        self._delay_ns = self._draw_delay()

    def ready_ns(self) -> int | None:
        """Return when the next poses will be there; None while their trigger has not come."""
        exposure_ns = self._trigger.next_ns()
        return None if exposure_ns is None else exposure_ns + self._delay_ns

    def read(self) -> TruePoses:
        """Return the poses that are due."""
        exposure_ns = self._trigger.next_ns()
        assert exposure_ns is not None
        self._trigger.fire(self._clock.now_ns())
        self._delay_ns = self._draw_delay()
        self._world.update()
        noise = (self._sigma * self._rng.standard_normal(self._shape)).tolist()
        dropped = (self._rng.random(self._shape[0]) < self._settings.dropout).tolist()
        poses = []
        for tag, pose, error, drop in zip(
            self._world.tags, self._world.poses_at(exposure_ns), noise, dropped, strict=True
        ):
            if pose is not None and not drop:
                poses.append((tag, pose[0] + error[0], pose[1] + error[1], pose[2] + error[2]))
        return TruePoses(exposure_ns, poses)

    def close(self) -> None:
        """Nothing to let go of."""

    def _draw_delay(self) -> int:
        p = self._settings
        return round((p.delay_s + p.jitter_s * self._rng.random()) * S)

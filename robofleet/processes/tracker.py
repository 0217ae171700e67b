"""The tracker: it owns its camera, finds the tags and publishes one message an image."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from robofleet.clock import MS, Clock, S, SimulatedClock
from robofleet.comms.bus import Bus, MemoryBus, Wake
from robofleet.comms.keys import CAMERA, NEWS, POSES
from robofleet.comms.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TagPose, TrackerNews
from robofleet.comms.ticks import TickFollower
from robofleet.config.tree import Config
from robofleet.plugins import load
from robofleet.simulation.sources import TruthSource
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import Happening
from robofleet.tracking.sources import CameraContext, CameraReader, ScheduledCamera
from robofleet.tracking.targets import floor_targets, robot_targets
from robofleet.tracking.tracker import TagTracker

_EPOCH = 1
_IDLE_NS = 100 * MS


class Observation(NamedTuple):
    """What one image says."""

    exposure_ns: int  # mid-exposure [this host's clock]
    poses: tuple[TagPose, ...]
    refused: int
    happenings: tuple[Happening, ...] = ()


class PoseSource(Protocol):
    """Gives observations as they become ready."""

    def next_ns(self) -> int | None:
        """Return when the next one will be ready [ns]; None: a message or a camera will wake the process."""

    def observe(self, now_ns: int) -> Observation | None:
        """Return the observation that is ready, or None."""

    def close(self) -> None:
        """Let go of the device."""


class Tracker:
    """Observes, says how long after which tick the image was taken, and publishes."""

    def __init__(
        self,
        config: Config,
        bus: Bus,
        clock: Clock,
        wake: Wake,
        rng: np.random.Generator,
        *,
        charge_ns: int = 0,
    ) -> None:
        self._tick_ns = round(config.controller.tick_s * S)
        self._ticks = TickFollower(bus, self._tick_ns, wake)
        self._lead_ns = round(config.camera.trigger_lead_s * S) if config.camera.trigger == "tick" else None
        self._clock = clock
        if config.tracker.source == "truth":
            self._source: PoseSource = _TruthPoses(TruthSource(config, bus, self._ticks, clock, rng))
        else:
            context = CameraContext(config, clock, bus, self._ticks, rng, charge_ns)
            self._source = _CameraPoses(context, wake)
        self._publish = bus.publisher(POSES, CAMERA)
        self._publish_news = bus.publisher(NEWS, CAMERA)
        self._seq = 0
        self._news_seq = 0
        self._refused = 0

    def step(self, now_ns: int) -> int:
        """Publish the observation that is ready, if one is."""
        self._ticks.update()
        observation = self._source.observe(now_ns)
        if observation is not None:
            self._send(observation, self._clock.now_ns() - now_ns)
            self._tell(observation.happenings)
        next_ns = self._source.next_ns()
        return now_ns + _IDLE_NS if next_ns is None else next_ns

    def close(self) -> None:
        """Let go of the camera."""
        self._source.close()

    def _send(self, observation: Observation, work_ns: int) -> None:
        self._seq += 1
        self._refused += observation.refused
        tick, since_ns = self._ticks.newest, 0
        if tick and self._lead_ns is not None:
            # 0: not known, when the first records came late.
            tick = max(0, self._ticks.nearest(observation.exposure_ns + self._lead_ns) - 1)
            since_ns = self._tick_ns - self._lead_ns  # the trigger leaves no other choice
        elif tick:
            since_ns = observation.exposure_ns - self._ticks.instant(tick)
        message = FleetPoses(
            _EPOCH,
            self._seq,
            observation.exposure_ns,
            self._clock.now_ns(),
            tick,
            since_ns,
            work_ns,
            self._refused,
            observation.poses,
        )
        self._publish(FLEET_POSES.encode(message))

    def _tell(self, happenings: tuple[Happening, ...]) -> None:
        for event, tag, value in happenings:
            self._news_seq += 1
            news = TrackerNews(_EPOCH, self._news_seq, self._clock.now_ns(), event, tag, value)
            self._publish_news(TRACKER_NEWS.encode(news))


def compile_kernels(config: Config) -> None:
    """Compile the simulated camera's numba kernels, or load them from the cache, before its first image."""
    if config.tracker.source == "camera" and config.camera.source == "simulated":
        clock = SimulatedClock()
        bus = MemoryBus(config.arena.name, clock, 0)
        Tracker(config, bus, clock, lambda _: None, np.random.default_rng(0))


class _CameraPoses:
    """A camera's images through the detector."""

    def __init__(self, context: CameraContext, wake: Wake) -> None:
        config = context.config
        camera = load("robofleet.cameras", config.camera.source)(context)
        self._camera = camera
        self._scheduled: Callable[[], int | None] | None = None
        self._reader: CameraReader | None = None
        if isinstance(camera, ScheduledCamera):
            self._scheduled = camera.ready_ns
        else:
            self._reader = CameraReader(camera, wake)
        model = config.camera.model
        self._tracker = TagTracker(
            CameraGeometry.from_model(model),
            (model.width, model.height),
            [*robot_targets(config), *floor_targets(config)],
            model.line_time_s,
        )

    def next_ns(self) -> int | None:
        return None if self._scheduled is None else self._scheduled()

    def observe(self, now_ns: int) -> Observation | None:
        if self._reader is not None:
            frame = self._reader.newest()
        else:
            ready_ns = self.next_ns()
            frame = self._camera.read() if ready_ns is not None and ready_ns <= now_ns else None
        if frame is None:
            return None
        sightings = self._tracker.track(frame.image, frame.exposure_ns)
        poses = tuple(
            TagPose(seen.tag, seen.after_ns, seen.coasted_ns, seen.x, seen.y, seen.psi) for seen in sightings.poses
        )
        return Observation(frame.exposure_ns, poses, sightings.refused, sightings.happenings)

    def close(self) -> None:
        self._camera.close()


class _TruthPoses:
    """The truth in an image's place."""

    def __init__(self, source: TruthSource) -> None:
        self._source = source

    def next_ns(self) -> int | None:
        return self._source.ready_ns()

    def observe(self, now_ns: int) -> Observation | None:
        ready_ns = self._source.ready_ns()
        if ready_ns is None or ready_ns > now_ns:
            return None
        exposure_ns, poses = self._source.read()
        return Observation(exposure_ns, tuple(TagPose(tag, 0, 0, *pose) for tag, *pose in poses), 0)

    def close(self) -> None:
        self._source.close()

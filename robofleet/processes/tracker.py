"""The tracker: it owns its camera, finds the tags and publishes one message an image."""

import sys
from functools import partial

import numpy as np

from robofleet.clock import MS, Clock, S, SimulatedClock
from robofleet.comms.bus import Bus, MemoryBus, Wake
from robofleet.comms.keys import CAMERA, NEWS, POSES
from robofleet.comms.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TagPose, TrackerNews
from robofleet.comms.ticks import TickFollower
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.plugins import load
from robofleet.processes.pictures import Pictures
from robofleet.simulation.faults import Schedule
from robofleet.simulation.faulty_poses import FaultyFeed, FaultyPoses
from robofleet.simulation.sources import TruthSource, VirtualPoses
from robofleet.tracking.events import Happening
from robofleet.tracking.sight import FleetSight
from robofleet.tracking.sources import (
    CameraContext,
    CameraPoller,
    CameraReader,
    Feed,
    Lost,
    Observation,
    PoseSource,
    ReopenedCamera,
    ScheduledCamera,
)
from robofleet.tracking.watch import CameraWatch

_IDLE_NS = 100 * MS


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
        faults: Schedule | None = None,
    ) -> None:
        self._tick_ns = round(config.controller.tick_s * S)
        self._ticks = TickFollower(bus, self._tick_ns, wake)
        self._lead_ns = round(config.camera.trigger_lead_s * S) if config.camera.trigger == "tick" else None
        self._clock = clock
        if config.tracker.source == "truth":
            self._source: PoseSource = _TruthPoses(TruthSource(config, bus, self._ticks, clock, rng))
        else:
            context = CameraContext(config, clock, bus, self._ticks, rng, charge_ns)
            self._source = _CameraPoses(context, wake, faults)
        if faults is not None:
            self._source = FaultyPoses(self._source, faults, config)
        self._publish = bus.publisher(POSES, CAMERA)
        self._publish_news = bus.publisher(NEWS, CAMERA)
        self._epoch, self._build = slices.drawn_id(rng, 32), slices.build(config)
        self._pictures = Pictures(config, bus, clock, wake, self._epoch)
        self._seq = 0
        self._news_seq = 0
        self._refused = 0

    def step(self, now_ns: int) -> int:
        """Publish the observation that is ready, if one is; a picture waits until there is none."""
        self._ticks.update()
        self._pictures.answer(now_ns)
        observation = self._source.observe(now_ns)
        if observation is not None:
            self._send(observation, self._clock.now_ns() - now_ns)
            self._pictures.offer(observation.image, observation.exposure_ns, now_ns)
        self._tell(self._source.news())
        if observation is None:
            self._pictures.publish()
        elif self._pictures.waits:
            return now_ns + 1
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
            self._epoch,
            self._seq,
            self._build,
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
            news = TrackerNews(self._epoch, self._news_seq, self._clock.now_ns(), event, tag, value)
            self._publish_news(TRACKER_NEWS.encode(news))


def compile_kernels(config: Config) -> None:
    """Compile the simulated camera's numba kernels, or load them from the cache, before its first image."""
    if config.tracker.source == "camera" and config.camera.source == "simulated":
        clock = SimulatedClock()
        bus = MemoryBus(config.arena.name, clock, 0)
        Tracker(config, bus, clock, lambda _: None, np.random.default_rng(0))


class _CameraPoses:
    """A camera's images through the detector, those that can be believed, and beside each the robots that stand in no
    arena: without an image they are gone too."""

    def __init__(self, context: CameraContext, wake: Wake, faults: Schedule | None) -> None:
        config, camera = context.config, context.config.camera
        open_camera = partial(load("robofleet.cameras", camera.source), context)
        first = open_camera()
        device = ReopenedCamera(first, open_camera, camera.model.camera)
        self._feed: Feed = CameraPoller(device) if isinstance(first, ScheduledCamera) else CameraReader(device, wake)
        if faults is not None:
            self._feed = FaultyFeed(self._feed, faults)
        self._ticks = context.ticks
        self._free = camera.trigger == "free"
        period_s = 1 / camera.rate_hz if self._free else config.controller.tick_s
        self._watch = CameraWatch(
            (camera.width, camera.height), round(period_s * S), camera.noise_gray > 0, context.clock.now_ns()
        )
        self._seen_tick = 0  # the newest one when something came last
        self._why = ""
        self._seen: list[Happening] = []
        self._sight = FleetSight(config)
        self._virtual = VirtualPoses(config, config.virtual, context.bus, context.rng)

    def next_ns(self) -> int | None:
        times = [at_ns for at_ns in (self._feed.next_ns(), self._watch.deadline_ns) if at_ns is not None]
        return min(times, default=None)

    def observe(self, now_ns: int) -> Observation | None:
        taken = self._feed.take(now_ns)
        tick = self._ticks.newest
        if taken is None:
            # One tick without its image may be the last one before the controller stopped.
            self._watch.wait(now_ns, expected=self._free or tick not in (self._seen_tick, self._seen_tick + 1))
            return None
        self._seen_tick = tick
        if isinstance(taken, Lost):
            self._watch.lose(taken.event)
            self._report(taken.why)
            return None
        if not self._watch.look(taken.image, taken.exposure_ns, now_ns):
            return None
        sight = self._sight.see(taken.image, taken.exposure_ns)
        self._seen += sight.happenings
        poses = tuple(TagPose(r.tag, r.after_ns, r.coasted_ns, r.x, r.y, r.psi) for r in sight.robots)
        poses += self._virtual.at(taken.exposure_ns)
        return Observation(taken.exposure_ns, poses, sight.refused, taken.image)

    def news(self) -> tuple[Happening, ...]:
        seen = tuple(self._seen)
        self._seen.clear()
        return self._watch.news() + seen

    def close(self) -> None:
        self._feed.close()

    def _report(self, why: str) -> None:
        """Write to the process's log what an event has no room for."""
        if why and why != self._why:
            print(f"camera: {why}", file=sys.stderr)
        self._why = why


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
        return self._source.read()

    def news(self) -> tuple[Happening, ...]:
        return ()

    def close(self) -> None:
        self._source.close()

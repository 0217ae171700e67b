"""The tracker: it owns its camera, finds the tags and publishes one message an image."""

from collections.abc import Callable

import numpy as np

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.keys import NEWS, POSES
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TrackerNews
from robofleet.bus.ticks import TickFollower
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.core.sentences import listed
from robofleet.nodes.pictures import Pictures
from robofleet.tracking.events import News, Notice, TrackerEvent
from robofleet.tracking.sources import Observation, PoseSource

_IDLE_NS = 100 * MS
_SILENT_NS = 150 * MS  # named before the tracker itself counts as silent
_SAID_NS = 10 * S  # between lines about what is seen
_FIRST_NS = 3 * S  # within which a source that was just opened gives its first poses


class Tracker:
    """Observes, says how long after which tick the image was taken, and publishes."""

    def __init__(
        self, config: Config, bus: Bus, clock: Clock, wake: Wake, rng: np.random.Generator, ticks: TickFollower,
        source: PoseSource, seen: "SeenLog | None" = None,
    ) -> None:  # fmt: skip
        """Publish what ``source`` observes; ``ticks`` are those that both follow. ``seen``: what is logged of it."""
        self._seen = seen
        self._tick_ns = round(config.controller.tick_s * S)
        self._ticks, self._source = ticks, source
        triggered = config.camera.trigger == "tick" and not config.tracker.own_times
        self._lead_ns = round(config.camera.trigger_lead_s * S) if triggered else None
        self._clock = clock
        self._publish = bus.publisher(POSES, config.camera.name)
        self._publish_news = bus.publisher(NEWS, config.camera.name)
        self._epoch, self._build = slices.drawn_id(rng, 32), slices.build(config)
        self._pictures = Pictures(config, bus, clock, wake, self._epoch)
        self._seq = 0
        self._news_seq = 0
        self._refused = 0

    def step(self, now_ns: int) -> int:
        """Publish the observation that is ready; publish a picture only in a step without an observation."""
        self._ticks.update()
        self._pictures.answer(now_ns)
        observation = self._source.observe(now_ns)
        if observation is not None:
            self._send(observation, self._clock.now_ns() - now_ns)
            self._pictures.offer(observation.image, observation.exposure_ns, now_ns)
            if self._seen is not None:
                self._seen.look(observation, now_ns)
        self._tell(self._source.news())
        if observation is None:
            self._pictures.publish()
        elif self._pictures.waits:
            return now_ns + 1
        next_ns = self._source.next_ns()
        return now_ns + _IDLE_NS if next_ns is None else next_ns

    def close(self) -> None:
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
            self._epoch, self._seq, self._build, observation.exposure_ns, self._clock.now_ns(), tick, since_ns, work_ns,
            self._refused, observation.poses,
        )  # fmt: skip
        self._publish(FLEET_POSES.encode(message))

    def _tell(self, happenings: tuple[Notice, ...]) -> None:
        for event, tag, value in happenings:
            self._news_seq += 1
            news = TrackerNews(self._epoch, self._news_seq, self._clock.now_ns(), event, tag, value)
            self._publish_news(TRACKER_NEWS.encode(news))


class SeenLog:
    """Says which tags are seen, when that has changed: to who starts a tracker by itself, and in its log."""

    def __init__(self, config: Config, say: Callable[[str], None]) -> None:
        camera, source = config.camera, config.tracker.source
        self._tags, self._say = [robot.tag for robot in config.seen], say
        self._seen: set[int] | None = None
        self._next_ns = 0
        images = f"{camera.source}, {camera.width} x {camera.height} px" if source == "camera" else source
        say(f"{camera.name}: poses from {images}; looks for tags {listed(self._tags)}")
        if source == "camera" and camera.files is not None and camera.source == "files":
            path = camera.files.path
            say(f"{path}: begins with the controller's first tick; poses without a run: `robofleet track {path}`")

    def look(self, observation: Observation, now_ns: int) -> None:
        """Take what one image says."""
        seen = {pose.tag for pose in observation.poses if not pose.coasted_ns}
        if seen == self._seen or now_ns < self._next_ns:
            return
        self._seen, self._next_ns = seen, now_ns + _SAID_NS
        missing = listed(tag for tag in self._tags if tag not in seen)
        self._say(f"sees tags {listed(seen & {*self._tags}) or 'none'}" + (f"; not {missing}" if missing else ""))


class WatchedPoses:
    """A pose source whose silence is told once, as POSES_SILENT, and its end, as POSES_BACK."""

    def __init__(self, source: PoseSource, now_ns: int) -> None:
        self._source = source
        self._heard_ns = now_ns
        self._deadline_ns: int | None = now_ns + _FIRST_NS
        self._news = News()

    def next_ns(self) -> int | None:
        times = [at_ns for at_ns in (self._source.next_ns(), self._deadline_ns) if at_ns is not None]
        return min(times, default=None)

    def observe(self, now_ns: int) -> Observation | None:
        observation = self._source.observe(now_ns)
        if observation is not None:
            if self._deadline_ns is None:
                self._news.add(Notice(TrackerEvent.POSES_BACK, value=(now_ns - self._heard_ns) / S))
            self._heard_ns, self._deadline_ns = now_ns, now_ns + _SILENT_NS
        elif self._deadline_ns is not None and now_ns >= self._deadline_ns:
            self._deadline_ns = None
            self._news.add(Notice(TrackerEvent.POSES_SILENT, value=(now_ns - self._heard_ns) / S))
        return observation

    def news(self) -> tuple[Notice, ...]:
        return self._source.news() + self._news.take()

    def close(self) -> None:
        self._source.close()

"""Faults of a camera and of its poses."""

from collections import deque
from collections.abc import Callable

import numpy as np

from robofleet.bus.messages import TagPose
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.simulation.faults import Injection, Schedule, struck
from robofleet.tracking.cameras.watch import CameraWatch
from robofleet.tracking.events import News, Notice, TrackerEvent
from robofleet.tracking.sources import Feed, Frame, Lost, Observation, PoseSource

_PRINTS_APART_M = 0.5  # of a tag's two prints


class FaultyFeed:
    """A camera that stalls or freezes: what watches it has to notice by itself."""

    def __init__(self, feed: Feed, schedule: Schedule) -> None:
        self._take, self.next_ns, self.close, self.device = feed.take, feed.next_ns, feed.close, feed.device
        self._stalled, self._frozen = schedule.of("camera_stalled"), schedule.of("camera_frozen")
        self._now_ns = schedule.now_ns
        self._last: Frame | None = None

    def take(self, now_ns: int) -> Frame | Lost | None:
        taken = self._take(now_ns)
        if not isinstance(taken, Frame):
            return taken
        at_ns = self._now_ns()
        if struck(self._stalled, at_ns):
            return None
        frozen = struck(self._frozen, at_ns)
        if frozen and self._last is not None:
            return taken._replace(image=self._last.image)
        self._last = taken
        return taken


class _WatchedTruth:
    """Poses without pixels, behind the watch of a camera: a picture of one pixel that always changes stands in."""

    def __init__(self, source: PoseSource, schedule: Schedule, config: Config) -> None:
        self._source, self._now_ns, self.close = source, schedule.now_ns, source.close
        self._stalled, self._frozen = schedule.of("camera_stalled"), schedule.of("camera_frozen")
        self._watch = CameraWatch((1, 1), round(config.controller.tick_s * S), True, schedule.now_ns())
        self._image = np.zeros((1, 1), np.uint8)

    def next_ns(self) -> int | None:
        times = [at_ns for at_ns in (self._source.next_ns(), self._watch.deadline_ns) if at_ns is not None]
        return min(times, default=None)

    def observe(self, now_ns: int) -> Observation | None:
        seen, at_ns = self._source.observe(now_ns), self._now_ns()
        stalled = struck(self._stalled, at_ns)
        if seen is None or stalled:
            self._watch.wait(now_ns, expected=stalled)
            return None
        if not struck(self._frozen, at_ns):
            self._image = 1 - self._image
        return seen if self._watch.look(self._image, seen.exposure_ns, now_ns) else None

    def news(self) -> tuple[Notice, ...]:
        return self._source.news() + self._watch.news()


class FaultyPoses:
    """A source whose poses are missing, wrong or late."""

    def __init__(self, source: PoseSource, schedule: Schedule, config: Config) -> None:
        self._source = _WatchedTruth(source, schedule, config) if config.tracker.source == "truth" else source
        self._silent = schedule.of("camera_stalled") if config.tracker.own_times else ()
        self._now_ns, self.close = schedule.now_ns, self._source.close
        self._tags = {robot.id: robot.tag for robot in config.robots}
        self._rng = schedule.rng("poses")
        self._faults = schedule.of("pose_dropout", "pose_noise", "duplicate_tag", "id_swap")
        self._delays = schedule.of("pose_delay")
        self._held: deque[tuple[int, Observation]] = deque()
        self._news = News()

    def next_ns(self) -> int | None:
        times = [ready_ns for ready_ns, _ in list(self._held)[:1]]
        next_ns = self._source.next_ns()
        return min(times if next_ns is None else [*times, next_ns], default=None)

    def observe(self, now_ns: int) -> Observation | None:
        observation, at_ns = self._source.observe(now_ns), self._now_ns()
        if struck(self._silent, at_ns):
            observation = None
        if observation is not None:
            for injection in self._faults:
                if injection.strike(at_ns):
                    observation = _ACTS[injection.fault.kind](self, injection, observation, now_ns)
            delay_s = max((i.fault.delay_s for i in self._delays if i.strike(at_ns)), default=0.0)
            if not delay_s and not self._held:
                return observation
            if observation.image is not None:
                observation = observation._replace(image=observation.image.copy())  # the camera writes over it
            last_ns = self._held[-1][0] if self._held else 0
            self._held.append((max(last_ns + 1, now_ns + round(delay_s * S)), observation))
        return self._held.popleft()[1] if self._held and self._held[0][0] <= now_ns else None

    def news(self) -> tuple[Notice, ...]:
        return self._source.news() + self._news.take()

    def _dropout(self, injection: Injection, seen: Observation, _now_ns: int) -> Observation:
        tag = self._tags[injection.fault.robot]
        return seen._replace(poses=tuple(pose for pose in seen.poses if pose.tag != tag))

    def _twice(self, injection: Injection, seen: Observation, now_ns: int) -> Observation:
        self._news.say(TrackerEvent.TAG_TWICE, self._tags[injection.fault.robot], _PRINTS_APART_M, now_ns)
        return self._dropout(injection, seen, now_ns)._replace(refused=seen.refused + 2)

    def _noise(self, injection: Injection, seen: Observation, _now_ns: int) -> Observation:
        tag, fault = self._tags[injection.fault.robot], injection.fault
        dx, dy, dpsi = (self._rng.standard_normal(3) * (fault.sigma_m, fault.sigma_m, fault.sigma_rad)).tolist()
        return _changed(
            seen, lambda p: p if p.tag != tag else p._replace(x_m=p.x_m + dx, y_m=p.y_m + dy, psi_rad=p.psi_rad + dpsi)
        )

    def _swap(self, injection: Injection, seen: Observation, _now_ns: int) -> Observation:
        first, other = (self._tags[robot] for robot in injection.fault.robots)
        worn = {first: other, other: first}
        return _changed(seen, lambda p: p._replace(tag=worn.get(p.tag, p.tag)))


def _changed(seen: Observation, change: Callable[[TagPose], TagPose]) -> Observation:
    return seen._replace(poses=tuple(change(pose) for pose in seen.poses))


_ACTS = {
    "pose_dropout": FaultyPoses._dropout,
    "pose_noise": FaultyPoses._noise,
    "duplicate_tag": FaultyPoses._twice,
    "id_swap": FaultyPoses._swap,
}

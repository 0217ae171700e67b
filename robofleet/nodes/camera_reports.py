"""What the supervisor hears of the cameras: their poses, and what their trackers tell."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Inbox
from robofleet.bus.keys import NEWS, POSES, key
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS, TrackerNews
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.core.kernels import kernel
from robofleet.safety.monitor import LOST_NS, TRACKER_SILENT_NS, UNSEEN_NS
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import NEVER, FleetView
from robofleet.tracking.events import TrackerEvent

if TYPE_CHECKING:
    from robofleet.nodes.views import FloorView

_NEWS_CAPACITY = 64  # between two looks
_MISSED_IMAGES = 3  # without a tag: fewer may be one bad image after some that were lost on their way
_TAG_NUMBERS = 1 << 16  # that a message can name
_UNKNOWN_ROW = -1  # of a tag that is nobody's
_NEVER_SEEN = -1  # as a time since
_DRIVEN_M = 0.05  # by a robot that is not seen any more, before it stands

# What stands until better news comes; each of these kinds for itself.
_DEVICE, _PLACE, _DOUBT, _SOURCE = (
    TrackerEvent.CAMERA_BACK, TrackerEvent.CAMERA_CORRECTED, TrackerEvent.CAMERA_AGREES, TrackerEvent.POSES_BACK,
)  # fmt: skip
_NEWS = {
    TrackerEvent.CAMERA_STALLED: (Event.CAMERA_STALLED, _DEVICE),
    TrackerEvent.CAMERA_FROZEN: (Event.CAMERA_FROZEN, _DEVICE),
    TrackerEvent.CAMERA_UNPLUGGED: (Event.CAMERA_LOST, _DEVICE),
    TrackerEvent.CAMERA_RESIZED: (Event.CAMERA_LOST, _DEVICE),
    TrackerEvent.CAMERA_STRANGE: (Event.CAMERA_LOST, _DEVICE),
    TrackerEvent.CAMERA_ENDED: (Event.CAMERA_LOST, _DEVICE),
    TrackerEvent.CAMERA_MOVED: (Event.CAMERA_MOVED, _PLACE),
    TrackerEvent.CAMERA_DISAGREES: (Event.CAMERA_MOVED, _DOUBT),
    TrackerEvent.POSES_SILENT: (Event.POSES_SILENT, _SOURCE),
}
_TAG_NEWS = {
    TrackerEvent.TAG_TWICE: Event.TAG_TWICE,
    TrackerEvent.TAG_JUMPED: Event.POSE_JUMPED,
    TrackerEvent.TAG_CARRIED: Event.POSE_JUMPED,
}


def stale_ticks(config: Config) -> int:
    """Return for how many ticks an image may be used: its poses' stated latency, and as long as a silence may last."""
    tracker = config.tracker
    stated_s = {"truth": tracker.truth.delay_s, "mocap": tracker.mocap.latency_s}.get(tracker.source, 0.0)
    return math.ceil((stated_s + TRACKER_SILENT_NS / S) / config.controller.tick_s)


class _Camera:
    """What is known of one camera; its robots are in the bodies' order."""

    def __init__(self, config: Config, bus: Bus, name: str, robots: int) -> None:
        self.poses = Inbox(bus.newest(POSES, name), FLEET_POSES.view)
        self.news = bus.stream(key(config.arena.name, NEWS, name), capacity=_NEWS_CAPACITY)
        self._stale_ticks = stale_ticks(config)
        self.heard_ns = NEVER
        self.epoch = self.seq = self.build = self.tick = 0
        self.exposure_ns = 0  # of the newest image
        self.measured_ns = np.zeros(robots, np.int64)  # newest image of each tag, by the images' own stamps
        self.missed = np.zeros(robots, np.int64)  # images since then that came
        self.unseen_ns = np.full(robots, _NEVER_SEEN)  # from that image to the newest one
        self.troubles: dict[TrackerEvent, Event] = {}  # that stand, each by the news that will end it
        self.out_ns: int | None = None  # when it gave no poses that can be used, last

    def newer(self, now_ns: int) -> NDArray[Any] | None:
        """Return the poses (K,) of a new image; None where there is none."""
        if (taken := self.poses.take()) is None:
            return None
        image, poses = taken
        if image.epoch != self.epoch:  # its clock may be another one: what was unseen stays unseen
            self.measured_ns += image.exposure_ns - self.exposure_ns
        elif image.seq <= self.seq:
            return None
        self.exposure_ns, self.heard_ns, self.tick = image.exposure_ns, now_ns, image.echo_tick
        self.epoch, self.seq, self.build = image.epoch, image.seq, image.build
        return poses

    def out(self, now_ns: int, tick: int) -> Event | None:
        """Return why it gives no poses that can be used; None where it does."""
        if self.troubles:
            return next(iter(self.troubles.values()))
        stale = self.tick != 0 and tick - self.tick > self._stale_ticks
        return Event.TRACKER_SILENT if now_ns - self.heard_ns > TRACKER_SILENT_NS or stale else None


class CameraReports:
    """Listens to the trackers. Of several cameras one that gives no poses is named, and costs what no other sees."""

    def __init__(self, config: Config, bus: Bus) -> None:
        robots = config.bodies
        self._build = slices.build(config)
        self._cameras = [_Camera(config, bus, name, len(robots)) for name in config.camera_names]
        self._tags = np.full(_TAG_NUMBERS, _UNKNOWN_ROW)  # the row of each tag
        self._tags[[robot.tag for robot in robots]] = range(len(robots))
        self._looks = 0  # in which an image had come: the number of its images
        self._last = np.zeros(len(robots), np.int64)  # the camera that measured each robot last
        self._reach_m = config.tracker.tag_side_m + _DRIVEN_M
        self._views = _views(config) if len(self._cameras) > 1 else []

    def look(self, robots: NDArray[Any], before: FleetView, now_ns: int) -> tuple[FleetView, tuple[Happening, ...]]:
        """Take what came, write it into the robots' rows; returns the view with it, and the trackers' news."""
        news = self._heard_news()
        if len(self._cameras) == 1:
            return self._look_at_one(robots, before, now_ns), news
        return self._look_at_all(robots, before, now_ns), news

    def _look_at_one(self, robots: NDArray[Any], before: FleetView, now_ns: int) -> FleetView:
        (camera,) = self._cameras
        if (poses := camera.newer(now_ns)) is None:
            return before
        self._take(0, robots, poses, camera.seq, now_ns)
        return before._replace(
            tracker_ns=now_ns, tracker_epoch=camera.epoch, tracker_build=camera.build, image=camera.seq,
            image_tick=camera.tick,
        )  # fmt: skip

    def _look_at_all(self, robots: NDArray[Any], before: FleetView, now_ns: int) -> FleetView:
        came = [camera.newer(now_ns) for camera in self._cameras]
        reasons = [camera.out(now_ns, before.tick) for camera in self._cameras]
        used = [k for k, poses in enumerate(came) if poses is not None and reasons[k] is None]
        self._looks += bool(used)
        for k in used:
            poses = came[k]
            assert poses is not None
            self._take(k, robots, poses, self._looks, now_ns)
        self._unseen(robots, [reason is None for reason in reasons], now_ns)
        for camera, reason in zip(self._cameras, reasons, strict=True):
            camera.out_ns = camera.out_ns if reason is None else now_ns
        self._name_out(robots, [reason is None for reason in reasons], now_ns)
        out = [Happening(reason, NOBODY, k) for k, reason in enumerate(reasons) if reason is not None]
        none_left = len(out) == len(self._cameras)
        if used:
            ticks = min(self._cameras[k].tick for k in used)
            before = before._replace(tracker_ns=now_ns, image=self._looks, image_tick=ticks)
        wrong = [camera.build for camera in self._cameras if camera.heard_ns and camera.build != self._build]
        build, cameras_out = wrong[0] if wrong else self._build, () if none_left else tuple(out)
        return before._replace(tracker_build=build, tracker_epoch=1, cameras_out=cameras_out)

    def _take(self, number: int, robots: NDArray[Any], poses: NDArray[Any], image: int, now_ns: int) -> None:
        camera = self._cameras[number]
        _take_image(
            robots, poses, self._tags, camera.measured_ns, camera.missed, camera.unseen_ns, camera.exposure_ns,
            np.uint64(image), now_ns, self._last, number,
        )  # fmt: skip

    def _unseen(self, robots: NDArray[Any], believed: list[bool], now_ns: int) -> None:
        """Write for how long no camera that gives poses has seen each robot."""
        each = np.array([np.where(camera.unseen_ns < 0, _LONG, camera.unseen_ns) for camera in self._cameras])
        each[~np.array(believed)] = _LONG
        shortest, since = each.min(axis=0), now_ns - robots["seen_ns"]
        known = robots["seen_ns"] != NEVER
        robots["unseen_ns"][known] = np.where(shortest == _LONG, since, np.minimum(shortest, since))[known]

    def _name_out(self, robots: NDArray[Any], believed: list[bool], now_ns: int) -> None:
        """Write of each robot that is not seen the camera that would see it, and is out; whoever has none is lost.

        It is the camera that measured it last; or one that looks at where it was last, at the border of the others'
        views, over which it may have driven. A camera counts as out for a while after it is back: its first images may
        show less.
        """
        robots["camera_out"] = 0
        rows = np.flatnonzero((robots["unseen_ns"] >= UNSEEN_NS) & (robots["seen_ns"] != NEVER))
        away = np.array([c.out_ns is not None and now_ns - c.out_ns < LOST_NS for c in self._cameras])
        if not (len(rows) and away.any() and any(believed)):
            return
        last = self._last[rows]
        robots["camera_out"][rows] = np.where(away[last], 1 + last, 0)
        if not len(rows := rows[~away[last]]):
            return
        places = np.stack([robots["x"][rows], robots["y"][rows]], axis=1)
        whole = [view.sees(places, self._reach_m) for view in self._views]
        for k in np.flatnonzero(away):
            others = np.any([whole[j] for j in np.flatnonzero(~away)], axis=0)
            robots["camera_out"][rows[self._views[k].sees(places) & ~others]] = 1 + k

    def _heard_news(self) -> tuple[Happening, ...]:
        """Return what the trackers told, of the cameras and of our tags, in the run's own words."""
        happenings: list[Happening] = []
        for k, camera in enumerate(self._cameras):
            for _, _, payload in camera.news.drain():
                if (news := TRACKER_NEWS.decode(payload)) is not None:
                    happenings += self._told(k, camera, news)
        return tuple(happenings)

    def _told(self, number: int, camera: _Camera, news: TrackerNews) -> tuple[Happening, ...]:
        row = int(self._tags[news.tag])
        if news.event in _TAG_NEWS and row != _UNKNOWN_ROW:
            return (Happening(_TAG_NEWS[TrackerEvent(news.event)], row, news.value),)
        if news.event in _NEWS:
            trouble, ends = _NEWS[TrackerEvent(news.event)]
            camera.troubles[ends] = trouble
            if all(camera_state.troubles for camera_state in self._cameras):
                return (Happening(trouble, NOBODY, news.value),)
        camera.troubles = {ends: trouble for ends, trouble in camera.troubles.items() if ends != news.event}
        return ()


def _views(config: Config) -> "list[FloorView]":
    """Return what each camera sees of the floor."""
    from robofleet.nodes.views import FloorView  # noqa: PLC0415 - it loads OpenCV

    return [FloorView(config, view.camera) for view in config.views]


_LONG = np.iinfo(np.int64).max


@kernel
def _take_image(  # type: ignore[no-untyped-def]
    robots, poses, tags, measured_ns, missed, unseen_ns, exposure_ns, image, now_ns, last, number
):
    missed += 1
    for pose in poses:
        k = tags[pose.tag]
        if k != _UNKNOWN_ROW:
            measured_ns[k] = exposure_ns - pose.coasted_ns
            missed[k] = _MISSED_IMAGES if pose.coasted_ns else 0  # a tracker that predicts knows how long
            if pose.coasted_ns == 0:
                r = robots[k]
                r.seen_ns, r.image, r.x, r.y, r.psi = now_ns, image, pose.x_m, pose.y_m, pose.psi_rad
                unseen_ns[k], last[k] = 0, number
    for k in range(len(robots)):
        if unseen_ns[k] != _NEVER_SEEN:
            unseen_ns[k] = exposure_ns - measured_ns[k] if missed[k] >= _MISSED_IMAGES else 0
            robots[k].unseen_ns = unseen_ns[k]  # as far as this camera knows


KERNELS = (_take_image,)


def compile_kernels(robots: NDArray[Any]) -> None:
    none = np.zeros(0, np.int64)
    poses = np.ndarray((0,), FLEET_POSES.item_dtype, b"0")
    _take_image(robots, poses, np.full(1, _UNKNOWN_ROW), none, none, none, 0, np.uint64(0), 0, none, 0)

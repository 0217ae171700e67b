"""What the operator's page hears of a run: the newest of everything, and when it came."""

from collections import deque
from typing import NamedTuple

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.keys import BUSY, NEWS, NOTE, PICTURE, POSES, STATE, STATUS, TICK, key
from robofleet.bus.messages import (
    FLEET_POSES,
    TICK_RECORD,
    TRACKER_NEWS,
    BusyMachine,
    FleetPoses,
    Picture,
    RunState,
    TagPose,
    TickRecord,
    TrackerNews,
)
from robofleet.bus.notes import Noted, noted
from robofleet.bus.observer import Observer, RobotObserved, robots_observed
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock
from robofleet.operator.terminal.on_the_way import OnTheWay
from robofleet.recording.run_clock import LiveClock
from robofleet.safety.supervisor import Phase

_WINDOW_IMAGES = 64  # two seconds of a camera, by which its rate is told
_NEWS_CAPACITY = 64
_NOTES_CAPACITY = 256  # of a group's script, between two looks
_POSES_WITHIN_NS = 200 * MS  # of a picture's arrival; it is shown without outlines then


class Shown(NamedTuple):
    """A picture, and the poses of the same image."""

    picture: Picture
    poses: tuple[TagPose, ...]


class CameraHearing:
    """What is heard of one camera."""

    def __init__(self, config: Config, bus: Bus, camera: str) -> None:
        arena = config.arena.name
        self.name = camera
        self._frames = bus.stream(key(arena, POSES, camera), capacity=_WINDOW_IMAGES)
        self._news = bus.stream(key(arena, NEWS, camera), capacity=_NEWS_CAPACITY)
        self._pictures = Observer(bus, [(PICTURE, camera)])
        self._pending: tuple[int, Picture] | None = None  # and when it came
        self.images: deque[FleetPoses] = deque(maxlen=_WINDOW_IMAGES)
        self.heard_ns = 0  # the newest image's arrival; 0: none yet
        self.shown: Shown | None = None

    def hear(self, now_ns: int) -> tuple[list[FleetPoses], list[TrackerNews]]:
        """Take what came; returns the new images and the tracker's news."""
        new = [image for *_, payload in self._frames.drain() if (image := FLEET_POSES.decode(payload)) is not None]
        self.images.extend(new)
        self.heard_ns = now_ns if new else self.heard_ns
        self._show(now_ns)
        news = (TRACKER_NEWS.decode(payload) for *_, payload in self._news.drain())
        return new, [item for item in news if item is not None]

    def _show(self, now_ns: int) -> None:
        """Wait for the poses of a picture's image; they may come after it."""
        for source in self._pictures.update(now_ns):
            self._pending = now_ns, self._pictures[source]
        if self._pending is not None:
            came_ns, picture = self._pending
            same = next((image for image in self.images if image.exposure_ns == picture.exposure_ns), None)
            if same is not None or now_ns - came_ns > _POSES_WITHIN_NS:
                self.shown = Shown(picture, same.poses if same is not None else ())
                self._pending = None


class Hearing:
    """``wake`` is called, from any thread, when a tick's record or a state of the run came."""

    def __init__(self, config: Config, bus: Bus, clock: Clock, wake: Wake) -> None:
        robots, arena, driven = config.bodies, config.arena.name, len(config.members)
        self.now_ns, self._tick_s = clock.now_ns, config.controller.tick_s
        self.tags = {robot.tag: robot.id for robot in robots}
        self._units, self._ids = config.units, [robot.id for robot in robots]
        self.run = Observer(bus, [STATE, BUSY], wake)
        self.run.declare([TICK], self._own_tick)
        self._statuses = Observer(bus, [(STATUS, unit) for unit in config.units])
        self.robots = [RobotObserved()] * len(robots)
        self.state: RunState | None = None
        self.record: TickRecord | None = None
        self.busy: BusyMachine | None = None  # None: nobody was late by the machine's load
        self.cameras = [CameraHearing(config, bus, camera) for camera in config.camera_names]
        self._notes = {
            group: bus.stream(key(arena, NOTE, group), capacity=_NOTES_CAPACITY) for group in groups.scripted(config)
        }
        self.notes: list[tuple[str, Noted]] = []  # that came since the look before, and of which group
        self.overruns = 0  # in this run: what the start of all processes cost does not count
        self._overruns_before = 0
        self.placed = [False] * driven  # it was seen at least once: its estimate is one
        self._parked = {robot.tag: driven + k for k, robot in enumerate(config.bystanders)}
        self.standing: dict[int, TagPose] = {}  # bystanders by their rows, as seen last
        self.way = OnTheWay(config)
        self.reached_s: float | None = None  # the same; stays also when the run is over
        self.over = False  # the run: what was heard last stays in sight
        self.t_s: float | None = None  # of the run; stays while it is held
        self.clock = LiveClock(self._tick_s)  # of the same run, both times

    def hear(self) -> bool:
        """Take what came of the tick and of the run's state; returns whether there is something new to show."""
        before, first = self.state, self.record is None
        updated = self.run.update(self.now_ns())
        self.record, self.state, self.busy = self.run[TICK], self.run[STATE], self.run[BUSY]
        changed = TICK in updated
        if changed and self.record is not None:
            self._take(self.record, first=first)
        if STATE in updated and self.state is not None:
            changed |= before is None or self.state._replace(seq=0) != before._replace(seq=0)
            self.way.hear(self.state.phase)
            if self.state.phase in (Phase.IDLE, Phase.ARMED):
                self.t_s = None
                self.clock.begin()
        return changed

    def hear_the_rest(self) -> list[tuple[str, TrackerNews]]:
        """Take what else came: the robots' words, the images', a picture; returns each camera's news, with its name."""
        now_ns = self.now_ns()
        if self._statuses.update(now_ns):
            self.robots = robots_observed(self._statuses, self._units, self._ids)
        news = []
        for camera in self.cameras:
            images, notices = camera.hear(now_ns)
            news += [(camera.name, item) for item in notices]
            for image in images:
                seen = (pose for pose in image.poses if pose.tag in self._parked and pose.coasted_ns == 0)
                self.standing.update((self._parked[pose.tag], pose) for pose in seen)
        came = ((group, noted(payload)) for group, notes in self._notes.items() for *_, payload in notes.drain())
        self.notes = [(group, note) for group, note in came if note is not None]
        return news

    def controller_silent(self) -> bool:
        """Whether what is known of the tick is of the past."""
        return not (self.over or self.run.alive(TICK, self.now_ns()))

    def _own_tick(self, payload: bytes) -> TickRecord | None:
        """Return a tick of this configuration's robots."""
        record = TICK_RECORD.decode(payload)
        return record if record is not None and len(record.robots) == len(self.placed) else None

    def _take(self, record: TickRecord, *, first: bool) -> None:
        if record.run_tick < 0 or first:
            self._overruns_before = record.overruns
        self.overruns = record.overruns - self._overruns_before
        self.placed = [placed or not robot.lost for placed, robot in zip(self.placed, record.robots, strict=True)]
        self.clock.take(record)
        if record.run_tick >= 0:
            self.t_s = self.reached_s = record.run_tick * self._tick_s

"""What the supervisor hears, gathered into one view: the newest of every message, and all news."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.comms.bus import Bus, Inbox, Wake
from robofleet.comms.keys import CAMERA, NEWS, POSES, RECORDER, TICK, key
from robofleet.comms.messages import (
    FLEET_POSES,
    RECORDER_STATUS,
    TICK_RECORD,
    TRACKER_NEWS,
    UNIT_STATUS,
    RecorderStatus,
)
from robofleet.comms.statuses import Statuses
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.kernels import kernel
from robofleet.safety.rows import ROBOT, Rows
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Happening
from robofleet.safety.view import NEVER, FleetView, Machine
from robofleet.tracking.events import TrackerEvent

_STREAM = 64  # news between two looks
_MISSED = 3  # images without a tag: fewer may be one bad image after some that were lost on their way

_NEWS = {
    TrackerEvent.CAMERA_STALLED: Event.CAMERA_STALLED,
    TrackerEvent.CAMERA_FROZEN: Event.CAMERA_FROZEN,
    TrackerEvent.CAMERA_UNPLUGGED: Event.CAMERA_LOST,
    TrackerEvent.CAMERA_RESIZED: Event.CAMERA_LOST,
    TrackerEvent.CAMERA_STRANGE: Event.CAMERA_LOST,
    TrackerEvent.CAMERA_ENDED: Event.CAMERA_LOST,
    TrackerEvent.CAMERA_MOVED: Event.CAMERA_MOVED,
}
_TAG_NEWS = {
    TrackerEvent.TAG_TWICE: Event.TAG_TWICE,
    TrackerEvent.TAG_JUMPED: Event.POSE_JUMPED,
    TrackerEvent.TAG_CARRIED: Event.POSE_JUMPED,
}
_FAILURES = np.array([event for event in Event if event.name.startswith(("BEHAVIOUR_", "SCRIPT_"))])
_TAGS = 1 << 16  # so many numbers can a message name
_UNKNOWN = -1  # as a row: nobody's tag


class FleetListener:
    """Listens to the drivers, the controller and the tracker; what came late behind something newer is passed over."""

    def __init__(
        self, config: Config, bus: Bus, wake: Wake, free_bytes: Callable[[], int],
        machine: Callable[[int], Machine | None],
    ) -> None:  # fmt: skip
        robots, arena, driven = config.bodies, config.arena.name, len(config.members)
        self._free_bytes, self._machine = free_bytes, machine
        self._daemons, self._build = frozenset(config.daemons), slices.build(config)
        ids = [robot.id for robot in robots]
        self.statuses = Statuses(bus, config.units, ids, by_radio=config.daemons, wake=wake)
        self.newer: list[int] = []  # units, as numbers, of which the newest look found a newer status
        self._ticks = Inbox(bus.newest(TICK), TICK_RECORD.arrays)
        self._poses = Inbox(bus.newest(POSES, CAMERA), FLEET_POSES.arrays)
        self._recorders = Inbox(bus.newest(RECORDER), RECORDER_STATUS.decode)
        self._recorder: RecorderStatus | None = None  # as it said last; lockstep has none
        self._news = bus.stream(key(arena, NEWS, CAMERA), capacity=_STREAM)
        self._tags = np.full(_TAGS, _UNKNOWN)  # the row of each tag
        self._tags[[robot.tag for robot in robots]] = range(len(robots))
        self._robots = np.zeros(len(robots), ROBOT)
        self._robots["battery"], self._robots["driven"] = -1.0, np.arange(len(robots)) < driven
        self._measured_ns = np.zeros(len(robots), np.int64)  # newest image of each tag, by the images' own stamps
        self._missed = np.zeros(len(robots), np.int64)  # images since then that came
        self._exposure_ns = 0  # of the newest image
        self._fleet = FleetView(0, ())

    def look(self, now_ns: int, operator_ns: int) -> FleetView:
        """Return everything that is known now; ``operator_ns`` is the operator's newest sign of life."""
        self.hear_robots(now_ns)
        if (tick := self._ticks.take()) is not None:
            self._take_tick(*tick, now_ns)
        if (image := self._poses.take()) is not None:
            self._take_image(*image, now_ns)
        self._fleet = self._fleet._replace(
            now_ns=now_ns,
            robots=Rows(self._robots.copy()),
            news=self._heard_news(),
            free_bytes=self._room(),
            operator_ns=operator_ns,
            machine=self._machine(now_ns),
        )
        return self._fleet

    def _room(self) -> int:
        """Return the bytes left for the recording; none, where the recorder finds that the disk takes nothing."""
        self._recorder = self._recorders.take() or self._recorder
        return 0 if self._recorder is not None and self._recorder.failed else self._free_bytes()

    def hear_robots(self, now_ns: int) -> None:
        """Take the statuses that came: those of the ``newer`` units."""
        statuses, self.newer = self.statuses, self.statuses.take()
        for unit in self.newer:
            said, part = statuses.newest[unit], statuses.units[unit]
            assert said is not None
            if part.name in self._daemons and said.build != self._build:
                continue  # it has not taken this run's configuration yet
            _take_statuses(self._robots, statuses.robots, part.numbers, now_ns, said.build, np.uint64(said.boot_id))

    def _take_tick(self, head: NDArray[Any], robots: NDArray[Any], now_ns: int) -> None:
        record = dict(zip(TICK_RECORD.head_dtype.names or (), head[0].item(), strict=True))
        if record["epoch"] == self._fleet.controller_epoch and record["tick"] <= self._fleet.tick:
            return
        self._fleet = self._fleet._replace(
            controller_ns=now_ns,
            controller_epoch=record["epoch"],
            controller_build=record["build"],
            tick=record["tick"],
            overruns=record["overruns"],
            arrived=record["phase"] * record["arrived"],
        )
        _take_tick(self._robots, robots, _FAILURES, record["phase"] in MOVING)

    def _take_image(self, head: NDArray[Any], poses: NDArray[Any], now_ns: int) -> None:
        image = dict(zip(FLEET_POSES.head_dtype.names or (), head[0].item(), strict=True))
        exposure_ns = image["exposure_ns"]
        if image["epoch"] != self._fleet.tracker_epoch:  # its clock may be another one: what was unseen stays unseen
            self._measured_ns += exposure_ns - self._exposure_ns
        elif image["seq"] <= self._fleet.image:
            return
        self._exposure_ns = exposure_ns
        self._fleet = self._fleet._replace(
            tracker_ns=now_ns,
            tracker_epoch=image["epoch"],
            tracker_build=image["build"],
            image=image["seq"],
            image_tick=image["echo_tick"],
        )
        _take_image(
            self._robots,
            poses,
            self._tags,
            self._measured_ns,
            self._missed,
            exposure_ns,
            np.uint64(image["seq"]),
            now_ns,
        )

    def _heard_news(self) -> tuple[Happening, ...]:
        """Return what the tracker told, of the camera and of our tags, in the run's own words."""
        heard = []
        for _, _, payload in self._news.drain():
            news = TRACKER_NEWS.decode(payload)
            if news is None:
                continue
            row = int(self._tags[news.tag])
            if news.event in _NEWS:
                heard.append(Happening(_NEWS[TrackerEvent(news.event)], NOBODY, news.value))
            elif news.event in _TAG_NEWS and row != _UNKNOWN:
                heard.append(Happening(_TAG_NEWS[TrackerEvent(news.event)], row, news.value))
        return tuple(heard)


@kernel
def _take_statuses(robots, statuses, rows, now_ns, build, boot_id):  # type: ignore[no-untyped-def]
    for k in rows:
        r, s = robots[k], statuses[k]
        r.heard_ns, r.build, r.boot_id = now_ns, build, boot_id
        r.session, r.latch, r.latch_id, r.faults, r.battery = s.session, s.latch, s.latch_id, s.faults, s.battery
        r.left_angle, r.right_angle, r.left_speed, r.right_speed = (
            s.left_angle_rad, s.right_angle_rad, s.left_rad_s, s.right_rad_s,
        )  # fmt: skip
        r.left_output, r.right_output = s.left_output_rad_s, s.right_output_rad_s
        r.left_told, r.right_told = s.left_told_rad, s.right_told_rad


@kernel
def _take_tick(robots, ticks, failures, moving):  # type: ignore[no-untyped-def]
    for k in range(min(len(robots), len(ticks))):
        r, t = robots[k], ticks[k]
        r.estimate_x, r.estimate_y, r.estimate_psi = t.x_m, t.y_m, t.psi_rad
        r.lost, r.filtered, r.blocked = t.lost > 0.0, int(t.filtered), t.blocked > 0.0
        r.failed = 0
        for event in failures:
            if moving and t.failed == event:
                r.failed = event


@kernel
def _take_image(robots, poses, tags, measured_ns, missed, exposure_ns, image, now_ns):  # type: ignore[no-untyped-def]
    missed += 1
    for pose in poses:
        k = tags[pose.tag]
        if k != _UNKNOWN:
            measured_ns[k] = exposure_ns - pose.coasted_ns
            missed[k] = _MISSED if pose.coasted_ns else 0  # a tracker that predicts knows how long
            if pose.coasted_ns == 0:
                r = robots[k]
                r.seen_ns, r.image, r.x, r.y, r.psi = now_ns, image, pose.x_m, pose.y_m, pose.psi_rad
    for k in range(len(robots)):
        if robots[k].seen_ns != NEVER:
            robots[k].unseen_ns = exposure_ns - measured_ns[k] if missed[k] >= _MISSED else 0


KERNELS = (_take_statuses, _take_tick, _take_image)


def compile_kernels() -> None:
    """Compile, or load from the cache, by messages about one robot."""
    robots, none = np.zeros(1, ROBOT), np.zeros(0, np.int64)
    _take_statuses(robots, np.zeros(1, UNIT_STATUS.item_dtype), np.zeros(0, np.intp), 0, 0, np.uint64(0))
    ticks, poses = (np.ndarray((0,), layout.item_dtype, b"0") for layout in (TICK_RECORD, FLEET_POSES))
    _take_tick(robots, ticks, _FAILURES, True)
    _take_image(robots, poses, np.full(1, _UNKNOWN), none, none, 0, np.uint64(0), 0)

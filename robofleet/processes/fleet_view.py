"""What the supervisor hears, gathered into one view: the newest of every message, and all news."""

from collections.abc import Callable
from typing import Any

from robofleet.comms.bus import Bus, Inbox
from robofleet.comms.keys import CAMERA, NEWS, POSES, RECORDER, TICK, key
from robofleet.comms.messages import (
    FLEET_POSES,
    RECORDER_STATUS,
    TICK_RECORD,
    TRACKER_NEWS,
    FleetPoses,
    RecorderStatus,
    RobotStatus,
    TickRecord,
    UnitStatus,
)
from robofleet.comms.statuses import Statuses
from robofleet.config.tree import Config
from robofleet.safety.supervisor import MOVING, NOBODY, Event, Happening
from robofleet.safety.view import NEVER, FleetView, Machine, RobotView
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
_FAILURES = frozenset(event for event in Event if event.name.startswith("BEHAVIOUR_"))


class FleetListener:
    """Listens to the drivers, the controller and the tracker; what came late behind something newer is passed over."""

    def __init__(
        self, config: Config, bus: Bus, free_bytes: Callable[[], int], machine: Callable[[int], Machine | None]
    ) -> None:
        robots, arena, driven = config.bodies, config.arena.name, len(config.members)
        self._free_bytes, self._machine = free_bytes, machine
        self.statuses = Statuses(bus, config.units, [robot.id for robot in robots])
        self._ticks = Inbox(bus.newest(TICK), TICK_RECORD.decode)
        self._poses = Inbox(bus.newest(POSES, CAMERA), FLEET_POSES.decode)
        self._recorders = Inbox(bus.newest(RECORDER), RECORDER_STATUS.decode)
        self._recorder: RecorderStatus | None = None  # as it said last; lockstep has none
        self._news = bus.stream(key(arena, NEWS, CAMERA), capacity=_STREAM)
        self._rows = {robot.tag: row for row, robot in enumerate(robots)}
        self._robots = [RobotView(driven=row < driven) for row in range(len(robots))]
        self._measured_ns = [0] * len(robots)  # newest image in which each tag was measured, by the images' own stamps
        self._missed = [0] * len(robots)  # images since then that came
        self._exposure_ns = 0  # of the newest image
        self._fleet = FleetView(0, ())

    def look(self, now_ns: int, operator_ns: int) -> FleetView:
        """Return everything that is known now; ``operator_ns`` is the operator's newest sign of life."""
        self.hear_robots(now_ns)
        if (record := self._ticks.take()) is not None:
            self._take_tick(record, now_ns)
        if (image := self._poses.take()) is not None:
            self._take_image(image, now_ns)
        self._fleet = self._fleet._replace(
            now_ns=now_ns,
            robots=tuple(self._robots),
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
        """Take the statuses that came."""
        for unit in self.statuses.take():
            said = self.statuses.newest[unit]
            assert said is not None
            for row in self.statuses.units[unit].rows.tolist():
                self._take_status(row, said, RobotStatus._make(self.statuses.robots[row].item()), now_ns)

    def _take_status(self, row: int, unit: UnitStatus, status: RobotStatus, now_ns: int) -> None:
        self._robots[row] = self._robots[row]._replace(
            heard_ns=now_ns,
            build=unit.build,
            session=status.session,
            boot_id=unit.boot_id,
            latch=status.latch,
            latch_id=status.latch_id,
            faults=status.faults,
            battery=status.battery,
            left_angle=status.left_angle_rad,
            right_angle=status.right_angle_rad,
            left_speed=status.left_rad_s,
            right_speed=status.right_rad_s,
            left_output=status.left_output_rad_s,
            right_output=status.right_output_rad_s,
            left_told=status.left_told_rad,
            right_told=status.right_told_rad,
        )

    def _take_tick(self, record: TickRecord, now_ns: int) -> None:
        if record.epoch == self._fleet.controller_epoch and record.tick <= self._fleet.tick:
            return
        self._fleet = self._fleet._replace(
            controller_ns=now_ns,
            controller_epoch=record.epoch,
            controller_build=record.build,
            tick=record.tick,
            overruns=record.overruns,
            arrived=record.phase * record.arrived,
        )
        for row, robot in enumerate(record.robots[: len(self._robots)]):
            self._robots[row] = self._robots[row]._replace(
                estimate=(robot.x_m, robot.y_m, robot.psi_rad),
                lost=robot.lost > 0.0,
                filtered=int(robot.filtered),
                failed=int(robot.failed) if record.phase in MOVING and robot.failed in _FAILURES else 0,
                blocked=robot.blocked > 0.0,
            )

    def _take_image(self, image: FleetPoses, now_ns: int) -> None:
        if image.epoch != self._fleet.tracker_epoch:  # its clock may be another one: what was unseen stays unseen
            since_ns = image.exposure_ns - self._exposure_ns
            self._measured_ns = [measured_ns + since_ns for measured_ns in self._measured_ns]
        elif image.seq <= self._fleet.image:
            return
        self._exposure_ns = image.exposure_ns
        self._fleet = self._fleet._replace(
            tracker_ns=now_ns,
            tracker_epoch=image.epoch,
            tracker_build=image.build,
            image=image.seq,
            image_tick=image.echo_tick,
        )
        self._missed = [missed + 1 for missed in self._missed]
        seen: dict[int, Any] = {}
        for tag, _, coasted_ns, *pose in image.poses:
            if (row := self._rows.get(tag)) is not None:
                self._measured_ns[row] = image.exposure_ns - coasted_ns
                self._missed[row] = _MISSED if coasted_ns else 0  # a tracker that predicts knows how long
                if coasted_ns == 0:
                    seen[row] = {"seen_ns": now_ns, "image": image.seq, "pose": tuple(pose)}
        for row, robot in enumerate(self._robots):
            if row in seen or robot.seen_ns != NEVER:
                unseen_ns = image.exposure_ns - self._measured_ns[row] if self._missed[row] >= _MISSED else 0
                self._robots[row] = robot._replace(**seen.get(row, {}), unseen_ns=unseen_ns)

    def _heard_news(self) -> tuple[Happening, ...]:
        """Return what the tracker told, of the camera and of our tags, in the run's own words."""
        heard = []
        for _, _, payload in self._news.drain():
            news = TRACKER_NEWS.decode(payload)
            if news is None:
                continue
            row = self._rows.get(news.tag)
            if news.event in _NEWS:
                heard.append(Happening(_NEWS[TrackerEvent(news.event)], NOBODY, news.value))
            elif news.event in _TAG_NEWS and row is not None:
                heard.append(Happening(_TAG_NEWS[TrackerEvent(news.event)], row, news.value))
        return tuple(heard)

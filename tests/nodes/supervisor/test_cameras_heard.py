"""Several cameras, as the supervisor hears them: one that gives no poses costs only what no other sees."""

from pathlib import Path

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import NEWS, POSES
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TagPose, TrackerNews
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.camera_reports import CameraReports
from robofleet.nodes.views import FloorView
from robofleet.safety import monitor
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase
from robofleet.safety.view import ROBOT, FleetView, Rows
from robofleet.tracking.events import NO_TAG, TrackerEvent

EXAMPLE = Path(__file__).parents[3] / "configs" / "two-cameras.yaml"
_LOST = Event.TAG_LOST, Event.BYSTANDER_LOST, Event.CAMERA_OUT
LEFT, RIGHT = "left", "right"


class Hall:
    """Two cameras: the left one sees r1 and r2, the right one r2 and r3."""

    def __init__(self) -> None:
        self.config = load_config(EXAMPLE)
        self.clock = SimulatedClock()
        self.clock.advance_to(10 * S)
        self.bus = MemoryBus(self.config.arena.name, self.clock, 0)
        self.cameras = CameraReports(self.config, self.bus)
        self.robots = np.zeros(len(self.config.bodies), ROBOT)
        self.view, self.news = FleetView(0, ()), ()
        self.sees = {LEFT: (1, 2), RIGHT: (2, 3)}
        self.silent: set[str] = set()
        self.x = {tag: {1: -2.0, 2: 0.0, 3: 1.5}[tag] for tag in (1, 2, 3)}
        self.ticks = {LEFT: 0, RIGHT: 0}
        self.driven = len(self.config.bodies)
        self.seq = 0

    def run(self, ns: int) -> None:
        build = slices.build(self.config)
        for _ in range(ns // (40 * MS)):
            self.clock.advance_to(self.clock.now_ns() + 40 * MS)
            now_ns, self.seq = self.clock.now_ns(), self.seq + 1
            for camera in {LEFT, RIGHT} - self.silent:
                poses = tuple(TagPose(tag, 0, 0, self.x[tag], 0.0, 0.0) for tag in self.sees[camera])
                image = FleetPoses(7, self.seq, build, now_ns, now_ns, self.ticks[camera], 0, 0, 0, poses)
                self.bus.publisher(POSES, camera)(FLEET_POSES.encode(image))
            self.view, self.news = self.cameras.look(self.robots, self.view, now_ns)

    def told(self) -> list[Happening]:
        """Return what the monitor makes of the robots' rows: whom it takes for lost."""
        self.robots["driven"] = np.arange(len(self.robots)) < self.driven
        view = self.view._replace(now_ns=self.clock.now_ns(), robots=Rows(self.robots.copy()))
        _, notices = monitor.watch(monitor.MonitorState(), _settings(self), Phase.RUNNING, view)
        return [notice for notice in notices if notice.event in _LOST]

    def tell(self, camera: str, event: TrackerEvent) -> None:
        self.bus.publisher(NEWS, camera)(TRACKER_NEWS.encode(TrackerNews(1, self.seq, 0, event, NO_TAG, 0.0)))

    def unseen_ms(self) -> list[int]:
        return [int(ns) // MS for ns in self.robots["unseen_ns"][:3]]


@pytest.fixture
def hall() -> Hall:
    made = Hall()
    made.run(200 * MS)
    assert made.view.cameras_out == ()
    assert made.unseen_ms() == [0, 0, 0]
    return made


def test_a_silent_camera_is_named_and_what_only_it_saw_is_unseen(hall: Hall) -> None:
    hall.silent.add(RIGHT)
    hall.run(3 * S)
    assert hall.view.cameras_out == (Happening(Event.TRACKER_SILENT, NOBODY, 1),)
    assert hall.unseen_ms() == [0, 0, 3000]
    assert hall.told() == [Happening(Event.CAMERA_OUT, 2, 1)], "it stands, and the run goes on"
    hall.silent.clear()
    hall.run(80 * MS)
    assert hall.view.cameras_out == ()
    assert hall.unseen_ms() == [0, 0, 0]


def test_without_a_camera_out_a_robot_that_nobody_sees_is_lost(hall: Hall) -> None:
    hall.sees[RIGHT] = (2,)
    hall.run(3 * S)
    assert hall.unseen_ms()[2] >= 2900
    assert hall.told() == [Happening(Event.TAG_LOST, 2)]


def test_a_robot_that_passes_to_the_other_view_is_seen_all_the_time(hall: Hall) -> None:
    hall.sees = {LEFT: (1,), RIGHT: (2, 3)}
    hall.run(S)
    assert hall.unseen_ms() == [0, 0, 0]


@pytest.mark.parametrize(
    ("trouble", "event", "back"),
    [
        (TrackerEvent.CAMERA_UNPLUGGED, Event.CAMERA_LOST, TrackerEvent.CAMERA_BACK),
        (TrackerEvent.CAMERA_DISAGREES, Event.CAMERA_MOVED, TrackerEvent.CAMERA_AGREES),
    ],
)
def test_trouble_of_one_ends_no_run_and_of_all_it_does(
    hall: Hall, trouble: TrackerEvent, event: Event, back: TrackerEvent
) -> None:
    hall.tell(RIGHT, trouble)
    hall.run(40 * MS)
    assert hall.news == ()
    assert hall.view.cameras_out == (Happening(event, NOBODY, 1),)
    hall.tell(LEFT, trouble)
    hall.run(40 * MS)
    assert [happening.event for happening in hall.news] == [event]
    assert hall.view.cameras_out == (), "that is for one of several"
    hall.tell(LEFT, back)
    hall.tell(RIGHT, back)
    hall.run(80 * MS)
    assert hall.news == hall.view.cameras_out == ()


def test_who_is_lost_under_a_camera_that_works_is_lost_though_another_one_is_out(hall: Hall) -> None:
    hall.silent.add(RIGHT)
    hall.sees[LEFT] = (2,)
    hall.run(3 * S)
    assert hall.told() == [Happening(Event.TAG_LOST, 0), Happening(Event.CAMERA_OUT, 2, 1)]
    hall.driven = 0
    assert hall.told() == [Happening(Event.BYSTANDER_LOST, 0)], "of bystanders, too"


def test_who_drives_out_of_a_view_into_that_of_a_camera_that_is_out_stands_there(hall: Hall) -> None:
    hall.silent.add(RIGHT)
    hall.x[1] = _border(hall)
    hall.run(S)
    hall.sees[LEFT] = (2,)
    hall.run(3 * S)
    assert [happening.event for happening in hall.told()] == [Event.CAMERA_OUT] * 2


def test_a_camera_that_is_back_has_two_seconds_to_show_its_robots(hall: Hall) -> None:
    hall.silent.add(RIGHT)
    hall.run(3 * S)
    hall.silent.clear()
    hall.sees[RIGHT] = (2,)
    hall.run(S)
    assert hall.view.cameras_out == ()
    assert hall.told() == [Happening(Event.CAMERA_OUT, 2, 1)]
    hall.run(S + 40 * MS)
    assert hall.told() == [Happening(Event.TAG_LOST, 2)]


def test_a_camera_that_disagreed_is_doubted_until_it_agrees_though_it_was_unplugged(hall: Hall) -> None:
    for event in (TrackerEvent.CAMERA_DISAGREES, TrackerEvent.CAMERA_UNPLUGGED, TrackerEvent.CAMERA_BACK):
        hall.tell(RIGHT, event)
    hall.run(S)
    assert hall.view.cameras_out == (Happening(Event.CAMERA_MOVED, NOBODY, 1),)
    assert hall.unseen_ms()[2] == 1000, "its poses are not used"
    hall.tell(RIGHT, TrackerEvent.CAMERA_AGREES)
    hall.run(80 * MS)
    assert hall.view.cameras_out == ()


def test_a_camera_with_stale_images_holds_nobody_else_and_is_not_believed(hall: Hall) -> None:
    hall.view = hall.view._replace(tick=100)
    hall.ticks = {LEFT: 99, RIGHT: 80}
    hall.x[3] = 2.0
    hall.run(S)
    assert hall.view.cameras_out == (Happening(Event.TRACKER_SILENT, NOBODY, 1),)
    assert (hall.view.image_tick, hall.view.tracker_ns) == (99, hall.clock.now_ns())
    assert hall.robots["x"][2] != 2.0
    hall.ticks[LEFT] = 80
    hall.run(S)
    assert hall.clock.now_ns() - hall.view.tracker_ns >= S, "of none there are poses that can be used"


def _border(hall: Hall) -> float:
    """Return the largest x at which the left camera still has a robot's tag in its image."""
    seen = FloorView(hall.config, hall.config.cameras[0])
    return max(x for x in np.linspace(-1.0, 1.0, 201) if seen.sees(np.array([[x, 0.0]]), 0.06).all())


def _settings(hall: Hall) -> monitor.MonitorSettings:
    n = len(hall.config.bodies)
    return monitor.MonitorSettings(
        build=1,
        body_radius=(0.05,) * n,
        wheel_radius=(0.016,) * n,
        wheel_base=(0.105,) * n,
        arena=hall.config.arena.size_m,
        max_speed=(0.2,) * n,
        attended=False,
        stale_ticks=8,
    )

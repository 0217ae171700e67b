"""The controller's step alone: its grid, what it believes and what it must not believe, and what it says."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, COMMAND, POSES, STATE, STATUS, TICK
from robofleet.bus.messages import FleetPoses, RobotState, RunState, TagPose
from robofleet.config import slices
from robofleet.core.clock import MS, S
from robofleet.nodes.controller import Controller
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.bus.alone import RobotStatus

Make = Callable[..., Any]
TICK_NS = 33 * MS
STRANGER = 99


class Stand:
    """A controller, and the robots standing at their start."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.robots = bench.config.members
        self.origin_ns = bench.now_ns
        self.node = Controller(bench.config, bench.bus, bench.clock, np.random.default_rng(1))
        drawn = np.random.default_rng(1)
        self.session = slices.drawn_id(drawn, 32) << 32 | slices.drawn_id(drawn, 32)  # that the drivers were granted to

    @property
    def tick(self) -> int:
        return int((self.bench.now_ns - self.origin_ns) // TICK_NS)

    @property
    def newest(self) -> Any:
        return self.bench.heard(TICK)[-1]

    def next_tick(self, ticks: float = 1) -> int:
        """Let some ticks' time pass and step once."""
        self.bench.wait(round(ticks * TICK_NS))
        return int(self.node.step(self.bench.now_ns))

    def poses(self, echo_tick: int, since_ns: int = 15 * MS, *, but: str = "") -> None:
        """Say that the robots were seen at their start."""
        seen = [
            TagPose(r.tag, 0, 0, r.start.x_m, r.start.y_m, r.start.psi) for r in self.robots if r.id != but
        ] + [TagPose(STRANGER, 0, 0, 0.0, 0.0, 0.0)]  # fmt: skip
        now_ns = self.bench.now_ns
        self.bench.say(POSES, FleetPoses(1, 1, 1, now_ns, now_ns, echo_tick, since_ns, 0, 0, tuple(seen)), CAMERA)

    def state(self, phase: int) -> None:
        self.bench.say(STATE, RunState(1, 1, phase, Event.NOTHING, NOBODY, 0.0, 0, (RobotState(1, 1, 0),) * 4))

    def status(self, robot: str, nonce: int, session: int | None = None) -> None:
        held = *(1, 1, 1), self.session if session is None else session, *(5, nonce), *(0,) * 9, *(-1, -1)
        message = RobotStatus(*held, *(0.0,) * 8, 1.0)
        self.bench.say(STATUS, message, robot)

    def seen(self, ticks: int, *, but: str = "") -> None:
        """Let ticks pass, each with a fresh image."""
        for _ in range(ticks):
            self.poses(self.tick, but=but)
            self.next_tick()


@pytest.fixture
def stand(bench_of: Make, platoon_of: Make) -> Stand:
    return Stand(bench_of(platoon_of()))


def test_ticks_fall_on_the_grid(stand: Stand) -> None:
    stand.bench.run(stand.node, S)
    records = stand.bench.heard(TICK)
    assert [record.tick for record in records] == list(range(1, S // TICK_NS + 1))
    assert [record.stamp_ns for record in records] == [stand.origin_ns + k * TICK_NS for k in range(1, 31)]
    assert {(record.overruns, record.lateness_ns) for record in records} == {(0, 0)}


def test_missed_ticks_are_counted_and_never_made_up(stand: Stand) -> None:
    stand.next_tick()
    for _ in range(3):  # the same instant again is no tick
        next_ns = stand.next_tick(0)
    assert next_ns == stand.origin_ns + 2 * TICK_NS
    next_ns = stand.next_tick(5.25)
    for _ in range(3):
        assert stand.next_tick(0) == next_ns == stand.origin_ns + 7 * TICK_NS
    late = stand.newest
    assert len(stand.bench.heard(TICK)) == 2
    assert (late.tick, late.overruns) == (6, 4)
    assert late.stamp_ns == stand.origin_ns + 6 * TICK_NS
    assert late.lateness_ns == round(4.25 * TICK_NS)  # since the first tick that was due
    stand.next_tick()
    assert (stand.newest.tick, stand.newest.overruns) == (7, 4)


@pytest.mark.parametrize(("behind", "used"), [(0, True), (1, True), (15, True), (16, False), (90, False), (-1, False)])
def test_poses_that_echo_an_old_tick_are_not_used(stand: Stand, behind: int, used: bool) -> None:
    stand.next_tick(100)
    stand.poses(stand.tick + 1 - behind)
    stand.next_tick()
    assert {robot.measured for robot in stand.newest.robots} == {float(used)}
    assert {robot.lost for robot in stand.newest.robots} == {float(not used)}
    assert (stand.newest.exposure_ns > 0) == used


def test_poses_that_echo_no_tick_are_not_used(stand: Stand) -> None:
    stand.next_tick()
    stand.poses(0)
    stand.next_tick()
    assert {robot.measured for robot in stand.newest.robots} == {0.0}


def test_the_exposure_is_placed_by_the_tick_that_it_echoes(stand: Stand) -> None:
    """The tracker's own stamps are another host's: only the newest tick and the time since count."""
    stand.next_tick(10)
    far = 10**15
    robot = stand.robots[0]
    seen = (TagPose(robot.tag, 0, 0, 0.1, 0.2, 0.3),)
    for stamp_ns in (far, far - S, 1):
        message = FleetPoses(1, 1, 1, stamp_ns, stamp_ns, stand.tick, 15 * MS, 0, 0, seen)
        stand.bench.say(POSES, message, CAMERA)
        stand.next_tick()
        here = stand.newest.robots[0]
        assert (here.measured, here.lost) == (1, 0)
    assert (here.x_m, here.y_m, here.psi_rad) == pytest.approx((0.1, 0.2, 0.3))


def test_robots_are_told_apart_by_their_tags(stand: Stand) -> None:
    stand.seen(5, but="r3")
    measured = [robot.measured for robot in stand.newest.robots]
    assert measured == [1, 1, 0, 1]
    assert [robot.lost for robot in stand.newest.robots] == [0, 0, 1, 0]
    for robot, here in zip(stand.robots, stand.newest.robots, strict=True):
        if robot.id != "r3":
            assert (here.x_m, here.y_m) == pytest.approx((robot.start.x_m, robot.start.y_m))


def test_wheels_turn_in_running_alone_and_only_of_robots_that_are_seen(stand: Stand) -> None:
    def moving() -> list[bool]:
        return [(robot.left_rad_s, robot.right_rad_s) != (0.0, 0.0) for robot in stand.newest.robots]

    stand.seen(5, but="r3")
    assert moving() == [False] * 4
    stand.state(Phase.RUNNING)
    stand.seen(5, but="r3")
    assert moving() == [True, True, False, True]
    stand.next_tick()
    assert any(moving()), "one image may be missed"
    for _ in range(20):
        stand.next_tick()
    assert {robot.lost for robot in stand.newest.robots} == {1.0}
    assert moving() == [False] * 4
    stand.seen(2)
    assert any(moving())
    stand.state(Phase.FAULT)
    stand.seen(1)
    assert moving() == [False] * 4


def test_the_run_counts_from_its_start(stand: Stand) -> None:
    stand.seen(3)
    stand.state(Phase.RUNNING)
    stand.seen(3)
    stand.state(Phase.IDLE)
    stand.seen(1)
    stand.state(Phase.RUNNING)
    stand.seen(2)
    assert [record.run_tick for record in stand.bench.heard(TICK)] == [-1, -1, -1, 0, 1, 2, -1, 0, 1]


def test_commands_echo_the_newest_status(stand: Stand) -> None:
    stand.seen(1)
    assert stand.bench.heard(COMMAND, "r1") == [], "nobody to echo yet"
    stand.status("r1", 10)
    stand.status("r1", 20)
    stand.seen(2)
    stand.status("r1", 30)
    stand.seen(1)
    commands = stand.bench.heard(COMMAND, "r1")
    assert [(command.boot_id, command.nonce) for command in commands] == [(5, 20), (5, 20), (5, 30)]
    assert [command.seq for command in commands] == [1, 2, 3]
    assert stand.bench.heard(COMMAND, "r2") == []


def test_what_is_commanded_is_what_is_recorded(stand: Stand) -> None:
    for robot in stand.robots:
        stand.status(robot.id, 1)
    stand.state(Phase.RUNNING)
    stand.seen(10)
    limit = stand.robots[0].vehicle.max_wheel_speed_rad_s
    for row, robot in enumerate(stand.robots):
        commanded = [(c.left_rad_s, c.right_rad_s) for c in stand.bench.heard(COMMAND, robot.id)]
        recorded = [(r.robots[row].left_rad_s, r.robots[row].right_rad_s) for r in stand.bench.heard(TICK)]
        assert commanded == recorded
        assert 0 < np.abs(commanded).max() < limit


def test_rubbish_disturbs_nothing(stand: Stand) -> None:
    stand.seen(3)
    for topic, name in ((POSES, CAMERA), (STATE, ""), (STATUS, "r1")):
        stand.bench.bus.publisher(topic, name)(b"\x01rubbish")
    stand.next_tick()
    assert [robot.measured for robot in stand.newest.robots] == [0] * 4
    assert stand.newest.phase == Phase.IDLE


def test_every_robot_of_an_image_has_its_own_mid_exposure(stand: Stand) -> None:
    """A rolling shutter: robots at one speed are ahead of their images by as long as these are old."""
    r1, r2 = stand.robots[0], stand.robots[1]
    stand.state(Phase.RUNNING)
    for k in range(20):
        x = 0.001 * k
        ahead = 0.001 / TICK_NS * 8 * MS
        poses = (TagPose(r1.tag, 8 * MS, 0, x + ahead, 0.0, 0.0), TagPose(r2.tag, 0, 0, x, 0.5, 0.0))
        now_ns = stand.bench.now_ns
        stand.bench.say(POSES, FleetPoses(1, 1, 1, now_ns, now_ns, stand.tick, 15 * MS, 0, 0, poses), CAMERA)
        stand.next_tick()
        first, other = stand.newest.robots[:2]
        assert (first.measured, other.measured) == (float(k > 0), float(k > 0))  # the first echoes no tick
    unseen_s = stand.node._estimate.predict(stand.bench.now_ns).unseen_s
    assert unseen_s[1] - unseen_s[0] == pytest.approx(8e-3)


@pytest.mark.parametrize("phase", [99, Phase.POSITIONING, Phase.PARKING])
def test_a_state_that_this_run_cannot_be_in_is_dropped(stand: Stand, phase: int) -> None:
    """Nobody has a place to park, and all begin where they stand."""
    stand.state(phase)
    stand.seen(3)
    assert stand.newest.phase == Phase.IDLE


@pytest.mark.parametrize("since_ns", [10 * S, 2**63 - 1, -(2**63)])
def test_an_image_of_the_future_or_of_no_time_is_used_for_nobody_and_does_not_blind_the_filter(
    stand: Stand, since_ns: int
) -> None:
    stand.next_tick(3)
    for since, used in ((since_ns, False), (15 * MS, True)):
        stand.poses(stand.tick, since)
        stand.next_tick()
        assert {robot.lost for robot in stand.newest.robots} == {float(not used)}
    for robot, seen in zip(stand.robots, stand.newest.robots, strict=True):
        assert (seen.x_m, seen.y_m) == pytest.approx((robot.start.x_m, robot.start.y_m))


@pytest.mark.parametrize(("after_ns", "coasted_ns"), [(2 * TICK_NS, 0), (10**9, 0), (0, 33 * MS)])
def test_a_mid_exposure_that_is_to_come_and_a_coasted_pose_are_no_measurement(
    stand: Stand, after_ns: int, coasted_ns: int
) -> None:
    """One to come would leave the filter blind for this robot until then."""
    stand.seen(3)
    now_ns = stand.bench.now_ns
    pose = TagPose(stand.robots[0].tag, after_ns, coasted_ns, 0.1, 0.2, 0.3)
    stand.bench.say(POSES, FleetPoses(1, 1, 1, now_ns, now_ns, stand.tick, 15 * MS, 0, 0, (pose,)), CAMERA)
    stand.next_tick()
    assert stand.newest.robots[0].measured == 0
    stand.seen(1)
    assert stand.newest.robots[0].measured == 1


def test_who_is_refused_a_robot_says_nothing_and_begins_anew_with_a_record_that_took_nothing(stand: Stand) -> None:
    stand.state(Phase.RUNNING)
    stand.seen(5)
    before = stand.newest
    assert (before.phase, before.run_tick, before.robots[0].measured) == (Phase.RUNNING, 4, 1.0)
    stand.status("r2", 1, session=stand.session + 1)
    stand.state(Phase.RUNNING)
    stand.seen(3)
    assert str(stand.newest) == str(before)  # figures that nobody told are NaN
    stand.status("r2", 2, session=0)
    stand.seen(1)
    first = stand.newest
    assert (first.epoch, first.tick) == (before.epoch, before.tick + 4)
    assert (first.poses_epoch, first.state_epoch, first.phase, first.run_tick) == (0, 0, Phase.IDLE, -1)
    assert {(robot.measured, robot.lost) for robot in first.robots} == {(0.0, 1.0)}
    stand.seen(1)
    assert (stand.newest.phase, stand.newest.run_tick, stand.newest.robots[0].measured) == (Phase.RUNNING, 0, 1.0)


def test_a_commands_session_tells_whose_it_is(stand: Stand) -> None:
    stand.status("r1", 1)
    stand.seen(1)
    (command,) = stand.bench.heard(COMMAND, "r1")
    assert command.session >> 32 == stand.newest.epoch

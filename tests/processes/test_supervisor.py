"""The supervisor's step alone: who may start a run, what ends one, who may move, and who is told."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.clock import MS, S
from robofleet.comms.keys import CAMERA, ENABLE, NEWS, POSES, RECORDER, REQUEST, STATE, STATUS, TICK
from robofleet.comms.messages import FleetPoses, RecorderStatus, RobotTick, TagPose, TickRecord, TrackerNews
from robofleet.safety import arming
from robofleet.safety.arming import ArmingState, Stage
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase
from robofleet.safety.wiggle import PROBE_RAD_S, Wiggle
from robofleet.tracking.events import TrackerEvent
from tests.processes.stand import ROBOTS, Stand

Make = Callable[..., Any]


@pytest.fixture
def stand_of(bench_of: Make, platoon_of: Make, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Stand]:
    monkeypatch.setattr(arming, "step", arming.step)  # put back at the end
    return lambda **keys: Stand(bench_of(platoon_of()), **keys)


@pytest.fixture
def stand(stand_of: Callable[..., Stand]) -> Stand:
    return stand_of()


def test_a_run_starts_when_asked_and_stops_when_asked(stand: Stand) -> None:
    stand.run(S)
    assert (stand.state.phase, max(stand.limits())) == (Phase.IDLE, 0.0)
    assert stand.ask("start") == "ok"
    stand.run(S)
    assert stand.cause == (Phase.RUNNING, Event.PROVED, NOBODY)
    fastest = [robot.vehicle.max_wheel_speed_rad_s for robot in stand.bench.config.platoon]
    assert stand.limits() == fastest
    assert all(robot.permitted == 1 for robot in stand.state.robots)
    assert stand.ask("stop") == "ok"
    assert stand.cause == (Phase.IDLE, Event.STOP_REQUESTED, NOBODY)
    assert stand.limits() == [0.0] * 4


def test_a_held_run_stands_and_goes_on_when_asked(stand: Stand) -> None:
    stand.running()
    assert stand.ask("hold") == "ok"
    assert (stand.state.phase, stand.limits()) == (Phase.HOLD, [0.0] * 4)
    stand.run(S)
    assert stand.state.phase == Phase.HOLD
    assert stand.ask("resume") == "ok"
    assert (stand.state.phase, min(stand.limits()) > 0.0) == (Phase.RUNNING, True)


def test_whoever_asks_again_is_told_that_it_was_done(stand: Stand) -> None:
    assert stand.ask("stop") == "ok"
    stand.running()
    for wish in ("start", "hold", "hold", "resume", "resume", "estop", "estop"):
        assert stand.ask(wish) == "ok"
    assert stand.state.phase == Phase.ESTOP


@pytest.mark.parametrize(
    ("wishes", "last", "way_out"),
    [
        ([], "hold", "start it"),
        ([], "resume", "start it"),
        (["start"], "resume and go", "not one of"),
        (["start", "hold"], "start", "resume it"),
        (["start"], "reset", "stop it"),
        (["start", "hold"], "reset", "stop it"),
        (["estop"], "start", "reset"),
        (["estop"], "stop", "reset"),
        (["estop"], "resume", "reset"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_way_out(
    stand: Stand, wishes: list[str], last: str, way_out: str
) -> None:
    stand.run(S // 5)
    for wish in wishes:
        assert stand.ask(wish) == "ok"
        stand.run(S // 5)
    phase = stand.state.phase
    answer = stand.ask(last)
    assert answer.startswith("refused: ")
    assert way_out in answer
    stand.run(S // 5)
    assert stand.state.phase == phase


@pytest.mark.parametrize("missing", ["r1", "r3", "controller", "tracker"])
def test_a_fleet_that_is_not_whole_waits_for_the_rest(stand: Stand, missing: str) -> None:
    stand.silent.add(missing)
    stand.run(S)
    stand.ask("start")
    stand.run(S)
    assert stand.state.phase == Phase.ARMED
    stand.silent.clear()
    stand.run(S // 5)
    assert stand.state.phase == Phase.RUNNING


@pytest.mark.parametrize(
    ("name", "within_ns", "to"),
    [
        ("r1", 460 * MS, (Phase.FAULT, Event.DRIVER_SILENT, 0)),
        ("r4", 460 * MS, (Phase.FAULT, Event.DRIVER_SILENT, 3)),
        ("controller", 460 * MS, (Phase.FAULT, Event.CONTROLLER_SILENT, NOBODY)),
        ("tracker", 210 * MS, (Phase.HOLD, Event.TRACKER_SILENT, NOBODY)),
    ],
)
def test_whoever_goes_silent_stops_the_run_by_name(
    stand: Stand, name: str, within_ns: int, to: tuple[int, int, int]
) -> None:
    stand.running()
    stand.silent.add(name)
    stand.run(within_ns)
    assert stand.state.phase == Phase.RUNNING
    stand.run(120 * MS)
    assert stand.cause == to
    assert stand.limits() == [0.0] * 4


def test_a_fault_stays_with_its_first_cause_until_a_reset(stand: Stand) -> None:
    stand.running()
    stand.silent.add("r2")
    stand.run(S)
    stand.silent |= {"r1", "controller"}
    stand.run(S)
    stand.silent.clear()
    stand.ask("start")
    stand.run(S)
    assert stand.cause == (Phase.FAULT, Event.DRIVER_SILENT, 1)
    assert stand.ask("reset") == "ok"
    assert stand.state.phase == Phase.IDLE
    stand.running()


def test_a_robot_whose_tag_is_hidden_stands_alone_and_goes_on_when_it_is_seen(stand: Stand) -> None:
    stand.running()
    stand.hidden.add("r3")
    stand.run(60 * MS)
    assert min(stand.limits()) > 0.0
    stand.run(160 * MS)
    assert stand.state.phase == Phase.RUNNING
    assert [limit > 0.0 for limit in stand.limits()] == [True, True, False, True]
    assert [robot.permitted for robot in stand.state.robots] == [1, 1, 0, 1]
    assert stand.state.robots[2].cause == Event.TAG_LATE
    assert stand.said[-1] == "stands: r3: its tag is not seen"
    stand.hidden.clear()
    stand.run(100 * MS)
    assert min(stand.limits()) > 0.0
    assert stand.state.robots[2].cause == Event.NOTHING


def test_a_robot_hidden_for_two_seconds_ends_the_run_and_keeps_its_cause(stand: Stand) -> None:
    stand.running()
    stand.hidden.add("r4")
    stand.run(1900 * MS)
    assert stand.state.phase == Phase.RUNNING
    stand.run(200 * MS)
    assert stand.cause == (Phase.FAULT, Event.TAG_LOST, 3)
    assert stand.state.robots[3].cause == Event.TAG_LOST


def test_a_tag_that_the_tracker_predicts_is_not_seen(stand: Stand) -> None:
    """By the images' own stamps: messages that are late or lost do not make it older."""
    stand.running()
    stand.silent.add("tracker")

    def see(seq: int, coasted_ns: int, age_ns: int) -> list[int]:
        poses = tuple(TagPose(stand.tags[r], 0, coasted_ns * (r == "r2"), *stand.places[r]) for r in ROBOTS)
        at_ns = stand.bench.now_ns - age_ns
        stand.bench.say(POSES, FleetPoses(4, seq, stand.build, at_ns, 0, 0, 0, 0, 0, poses), CAMERA)
        stand.run(40 * MS)
        return [robot.permitted for robot in stand.state.robots]

    assert see(1000, 99 * MS, 60 * MS) == [1, 1, 1, 1]
    assert see(1001, 100 * MS, 0) == [1, 0, 1, 1]
    assert see(1000, 0, 0) == [1, 0, 1, 1], "a message that was overtaken says nothing"
    assert see(1002, 0, 60 * MS) == [1, 1, 1, 1]


def test_a_tag_is_late_when_three_images_that_came_lack_it(stand: Stand) -> None:
    """Images that the network lost say nothing of a tag."""
    stand.running()
    stand.silent.add("tracker")

    def see(seq: int) -> int:
        poses = tuple(TagPose(stand.tags[r], 0, 0, *stand.places[r]) for r in ROBOTS if r != "r2")
        stand.bench.say(POSES, FleetPoses(4, seq, stand.build, stand.bench.now_ns, 0, 0, 0, 0, 0, poses), CAMERA)
        stand.run(40 * MS)
        return int(stand.state.robots[1].permitted)

    stand.run(80 * MS)  # two images are lost
    assert [see(1000), see(1001), see(1002)] == [1, 1, 0]


def test_a_tracker_that_was_restarted_on_another_clock_makes_nobody_seen_or_lost(stand: Stand) -> None:
    stand.running()
    stand.hidden.add("r2")
    stand.run(200 * MS)
    stand.silent.add("tracker")
    poses = tuple(TagPose(stand.tags[r], 0, 0, *stand.places[r]) for r in ROBOTS if r != "r2")
    for seq in (1, 2):
        stand.bench.say(POSES, FleetPoses(9, seq, stand.build, 33 * MS * seq, 0, 0, 0, 0, 0, poses), CAMERA)
    stand.run(40 * MS)
    assert stand.cause == (Phase.HOLD, Event.TRACKER_RESTARTED, NOBODY)
    assert [robot.cause for robot in stand.state.robots] == [0, Event.TAG_LATE, 0, 0]


@pytest.mark.parametrize(
    ("event", "robot", "to"),
    [
        (TrackerEvent.CAMERA_STALLED, None, (Phase.HOLD, Event.CAMERA_STALLED)),
        (TrackerEvent.CAMERA_FROZEN, None, (Phase.HOLD, Event.CAMERA_FROZEN)),
        (TrackerEvent.CAMERA_UNPLUGGED, None, (Phase.FAULT, Event.CAMERA_LOST)),
        (TrackerEvent.CAMERA_RESIZED, None, (Phase.FAULT, Event.CAMERA_LOST)),
        (TrackerEvent.CAMERA_STRANGE, None, (Phase.FAULT, Event.CAMERA_LOST)),
        (TrackerEvent.CAMERA_ENDED, None, (Phase.FAULT, Event.CAMERA_LOST)),
        (TrackerEvent.CAMERA_MOVED, None, (Phase.FAULT, Event.CAMERA_MOVED)),
        (TrackerEvent.TAG_TWICE, "r2", (Phase.HOLD, Event.TAG_TWICE)),
        (TrackerEvent.TAG_JUMPED, "r2", (Phase.FAULT, Event.POSE_JUMPED)),
        (TrackerEvent.TAG_CARRIED, "r2", (Phase.FAULT, Event.POSE_JUMPED)),
        (TrackerEvent.TAG_FOUND, "r2", (Phase.RUNNING, Event.PROVED)),
        (TrackerEvent.CAMERA_CORRECTED, None, (Phase.RUNNING, Event.PROVED)),
        (TrackerEvent.TAG_TWICE, None, (Phase.RUNNING, Event.PROVED)),  # nobody's tag
        (250, "r2", (Phase.RUNNING, Event.PROVED)),  # of another version
    ],
)
def test_the_trackers_news_in_the_runs_words(
    stand: Stand, event: int, robot: str | None, to: tuple[Phase, Event]
) -> None:
    stand.running()
    stand.tell(event, robot, 0.5)
    stand.run(40 * MS)
    assert stand.cause == (*to, NOBODY if robot is None or to[0] is Phase.RUNNING else ROBOTS.index(robot))


def test_a_piece_of_news_behind_another_is_not_lost(stand: Stand) -> None:
    stand.running()
    stand.tell(TrackerEvent.CAMERA_MOVED)
    stand.tell(TrackerEvent.CAMERA_CORRECTED)
    stand.run(40 * MS)
    assert stand.state.phase == Phase.FAULT


@pytest.mark.parametrize("seed", range(2))
def test_a_bad_network_raises_nothing(stand: Stand, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """1 % of what is said is lost, in bursts of up to 60 ms, and one message in a hundred is later than 60 ms."""
    rng = np.random.default_rng(seed)
    say, under_way, burst_end_ns = stand.bench.say, [], dict.fromkeys(["", CAMERA, *ROBOTS], 0)
    lost = 0

    def say_badly(topic: Any, message: Any, name: str = "") -> None:
        nonlocal lost
        now_ns = stand.bench.now_ns
        if rng.random() < 0.005:
            burst_end_ns[name] = now_ns + int(rng.integers(60 * MS))
        if now_ns < burst_end_ns[name]:
            lost += 1
        else:
            late_ns = 2 * MS * np.exp(rng.standard_normal() * np.log(30) / 2.33)
            under_way.append((now_ns + late_ns, topic, message, name))

    def deliver() -> None:
        due = sorted((m for m in under_way if m[0] <= stand.bench.now_ns), key=lambda m: m[0])
        under_way[:] = [m for m in under_way if m[0] > stand.bench.now_ns]
        for _, topic, message, name in due:
            say(topic, message, name)

    stand.others = [(5 * MS, deliver)]
    stand.running()
    monkeypatch.setattr(stand.bench, "say", say_badly)
    stand.run(20 * S)
    assert lost > 20
    assert stand.state.phase == Phase.RUNNING
    assert stand.said[1:] == ["ARMED -> RUNNING: every check passed"]


def test_a_run_is_not_resumed_into_what_held_it(stand: Stand) -> None:
    stand.running()
    stand.silent.add("tracker")
    stand.run(S // 2)
    assert stand.state.phase == Phase.HOLD
    answer = stand.ask("resume")
    assert answer.startswith("refused: the tracker went silent")
    assert stand.state.phase == Phase.HOLD
    stand.silent.clear()
    stand.run(S // 5)
    assert stand.ask("resume") == "ok"


def test_a_run_is_not_resumed_while_a_robot_is_lost_but_while_one_is_late(stand: Stand) -> None:
    stand.running()
    stand.ask("hold")
    stand.hidden.add("r1")
    stand.run(3 * S)
    assert "r1: the tracker lost the robot" in stand.ask("resume")
    stand.hidden.clear()
    stand.run(S // 5)
    stand.hidden.add("r1")
    stand.run(S // 2)
    assert stand.ask("resume") == "ok"
    assert [limit > 0.0 for limit in stand.limits()] == [False, True, True, True]


def test_a_latched_robot_is_not_started_and_a_reset_lets_it(stand: Stand) -> None:
    stand.robots["r2"].latch, stand.robots["r2"].latch_id = Latch.EMERGENCY_STOP, 8
    stand.run(S // 5)
    answer = stand.ask("start")
    assert answer.startswith("refused: r2: ")
    assert "reset" in answer
    assert stand.ask("reset", S // 5) == "ok"
    assert stand.robots["r2"].latch is Latch.NONE
    stand.running()


def test_the_probed_robot_alone_may_move_while_armed(stand_of: Callable[..., Stand]) -> None:
    probe = ArmingState(Stage.WIGGLE, wiggle=Wiggle(robot=2, stroke=1))
    stand = stand_of(prove=lambda *_: (probe, None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    assert (stand.state.stage, stand.state.probed, stand.state.stroke) == (Stage.WIGGLE, 2, 1)
    assert stand.limits() == [0.0, 0.0, PROBE_RAD_S, 0.0]
    assert [robot.permitted for robot in stand.state.robots] == [0, 0, 1, 0]
    stand.hidden.add("r3")
    stand.run(S // 5)
    assert stand.limits() == [0.0] * 4
    stand.ask("stop")
    assert (stand.state.stage, stand.state.probed, stand.state.stroke) == (Stage.CHECKS, NOBODY, 0)


def test_a_drill_latches_every_gate_and_clears_it_again(stand_of: Callable[..., Stand]) -> None:
    wanted = [ArmingState(Stage.DRILL, latch=Latch.DRILL)]
    stand = stand_of(prove=lambda *_: (wanted[0], None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.DRILL}
    wanted[0] = ArmingState(Stage.DRILL)
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.DRILL}, "not before it is asked"
    wanted[0] = ArmingState(Stage.DRILL, clear=True)
    stand.run(S // 5)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.NONE}
    assert stand.state.phase == Phase.ARMED


def test_a_drill_that_was_broken_off_leaves_nothing_behind_and_clears_no_e_stop(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(prove=lambda *_: (ArmingState(Stage.DRILL, latch=Latch.DRILL), None))
    stand.run(S // 5)
    stand.ask("start")
    stand.run(S // 5)
    stand.ask("stop")
    stand.robots["r4"].latch, stand.robots["r4"].latch_id = Latch.EMERGENCY_STOP, 2
    stand.run(S // 5)
    assert [robot.latch for robot in stand.robots.values()] == [0, 0, 0, Latch.EMERGENCY_STOP]


def test_the_checks_can_refuse_a_fleet_by_name(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(prove=lambda state, *_: (state, Happening(Event.WHEELS_SWAPPED, 1)))
    stand.run(S // 5)
    stand.ask("start")
    assert stand.cause == (Phase.FAULT, Event.WHEELS_SWAPPED, 1)
    assert stand.said[-1] == "ARMED -> FAULT: r2: its wheels are swapped"


def test_a_start_begins_the_checks_anew(stand_of: Callable[..., Stand]) -> None:
    seen: list[ArmingState] = []
    stand = stand_of(prove=lambda state, *_: (seen.append(state), (state._replace(stage=Stage.WIGGLE), None))[1])
    for _ in range(2):
        stand.run(S // 5)
        stand.ask("start")
        started_ns = stand.bench.now_ns
        stand.run(S // 5)
        assert Stage.WIGGLE in [state.stage for state in seen]
        assert (seen[0].stage, seen[0].since_ns) == (Stage.CHECKS, started_ns)
        stand.ask("stop")
        seen.clear()


def test_blocked_robots_and_missed_ticks_hold_the_run(stand: Stand) -> None:
    stand.running()
    stand.stopped = {"blocked": 1.0}
    stand.run(100 * MS)
    assert stand.cause == (Phase.HOLD, Event.DEADLOCKED, 0)
    stand.stopped = {}
    stand.run(100 * MS)
    stand.ask("resume")
    head = (3, stand.build, 10**6, -1, stand.bench.now_ns, *[0] * 6, 0, 3, 0, 0)
    stand.bench.say(TICK, TickRecord(*head, (RobotTick(*[0.0] * 18),) * 4))
    stand.node.step(stand.bench.now_ns)
    assert stand.cause == (Phase.HOLD, Event.TICKS_OVERRUN, NOBODY)
    assert stand.state.detail == 3.0


def test_a_full_disk_holds_the_run_until_there_is_room(stand: Stand) -> None:
    stand.running()
    stand.free_bytes = 0
    stand.run(40 * MS)
    assert stand.cause == (Phase.HOLD, Event.DISK_FULL, NOBODY)
    assert stand.ask("resume") == "refused: the disk is full: mend it, then resume, or stop"
    stand.free_bytes = 1 << 40
    stand.run(40 * MS)
    assert stand.ask("resume") == "ok"


def test_a_recorder_that_cannot_write_is_a_full_disk_whatever_the_disk_says(stand: Stand) -> None:
    stand.running()
    for failed in (0, 1):
        stand.bench.say(RECORDER, RecorderStatus(1, 1 + failed, 100, 0, failed))
        stand.run(1000 * MS)
        assert stand.cause[:2] == ((Phase.HOLD, Event.DISK_FULL) if failed else (Phase.RUNNING, Event.PROVED))
    stand.bench.say(RECORDER, RecorderStatus(1, 3, 100, 50, 0))
    stand.run(40 * MS)
    assert stand.ask("resume") == "ok"


def test_a_tick_of_another_fleet_is_another_build_and_no_end(stand: Stand) -> None:
    stand.running()
    stand.bench.say(TICK, TickRecord(3, 1, 10**6, -1, 0, *[0] * 6, 200, 0, 0, 0, (RobotTick(*[0.0] * 18),) * 9))
    stand.node.step(stand.bench.now_ns)
    assert stand.cause == (Phase.FAULT, Event.OTHER_BUILD, NOBODY)


def test_a_restarted_driver_ends_the_run_and_numbers_of_another_version_do_not_end_the_supervisor(
    stand: Stand,
) -> None:
    stand.running()
    stand.robots["r1"].says = {"boot_id": 4711, "latch": 99, "gate": 77}
    stand.run(100 * MS)
    assert stand.cause == (Phase.FAULT, Event.GATE_LATCHED, 0) or stand.state.cause == Event.DRIVER_RESTARTED
    assert "r1" in stand.ask("status")


def test_a_status_that_was_overtaken_says_nothing(stand: Stand) -> None:
    stand.running()
    old = stand.robots["r1"].status(stand.bench.now_ns - 30 * MS, stand.build)._replace(latch=Latch.EMERGENCY_STOP)
    stand.bench.say(STATUS, old, "r1")
    stand.node.step(stand.bench.now_ns)
    assert stand.state.phase == Phase.RUNNING


def test_a_driver_whose_clock_began_anew_is_heard(stand: Stand) -> None:
    stand.running()
    stand.robots["r1"].boot_id, stand.robots["r1"].clock_ns = 4711, stand.bench.now_ns
    stand.run(100 * MS)
    assert stand.cause == (Phase.FAULT, Event.DRIVER_RESTARTED, 0)


def test_a_restarted_controller_ends_the_run(stand: Stand) -> None:
    stand.running()
    stand.epoch, stand.tick = 8, 0
    stand.run(100 * MS)
    assert stand.cause == (Phase.FAULT, Event.CONTROLLER_RESTARTED, NOBODY)


def test_a_tick_that_was_overtaken_says_nothing(stand: Stand) -> None:
    stand.running()
    head = (3, stand.build, stand.tick - 1, -1, 0, *[0] * 10)
    stand.bench.say(TICK, TickRecord(*head, (RobotTick(*[0.0] * 18)._replace(blocked=1.0),) * 4))
    stand.node.step(stand.bench.now_ns)
    assert stand.state.phase == Phase.RUNNING


def test_a_tag_that_is_only_predicted_gives_no_place(stand: Stand) -> None:
    stand.running()
    outside = TagPose(stand.tags["r1"], 0, 33 * MS, 9.0, 0.0, 0.0)
    stranger = TagPose(999, 0, 0, 9.0, 0.0, 0.0)
    seen = tuple(TagPose(stand.tags[r], 0, 0, *stand.places[r]) for r in ROBOTS[1:])
    stand.bench.run(stand.node, 10 * MS)
    image = FleetPoses(4, 10**6, stand.build, stand.bench.now_ns, 0, 0, 0, 0, 0, (outside, stranger, *seen))
    stand.bench.say(POSES, image, CAMERA)
    stand.bench.say(NEWS, TrackerNews(1, 1, 0, TrackerEvent.CAMERA_MOVED, 0, float("nan")), CAMERA)  # malformed
    stand.bench.run(stand.node, 50 * MS)
    assert stand.state.phase == Phase.RUNNING


def test_a_supervisor_that_stood_still_ends_the_run(stand: Stand) -> None:
    stand.running()
    stand.bench.wait(700 * MS)
    stand.run(100 * MS)
    assert stand.cause == (Phase.FAULT, Event.SUPERVISOR_STALLED, NOBODY)


def test_a_new_supervisor_begins_in_idle_and_leaves_latches_as_they_are(stand: Stand) -> None:
    stand.running()
    stand.ask("estop")
    stand.run(S // 5)
    successor = Stand(stand.bench)
    successor.robots = stand.robots
    successor.run(S)
    assert successor.state.phase == Phase.IDLE
    assert {robot.latch for robot in successor.robots.values()} == {Latch.EMERGENCY_STOP}
    assert successor.ask("start").startswith("refused: r1, r2, r3, r4: the gate is latched")


def test_status_says_where_the_run_is_and_whom_something_holds(stand: Stand) -> None:
    stand.running()
    assert stand.ask("status") == "ok: RUNNING: every check passed"
    stand.hidden.add("r3")
    stand.run(S // 5)
    assert stand.ask("status") == "ok: RUNNING: every check passed; r3: its tag is not seen"


def test_every_change_is_a_line_in_the_log(stand: Stand) -> None:
    stand.running()
    stand.ask("hold")
    stand.ask("stop")
    assert stand.said == [
        "IDLE -> ARMED: start requested",
        "ARMED -> RUNNING: every check passed",
        "RUNNING -> HOLD: hold requested",
        "HOLD -> IDLE: stop requested",
    ]


def test_enables_echo_the_newest_nonce_and_the_epoch_of_the_lease(stand: Stand) -> None:
    stand.robots["r2"].says = {"epoch": 9}
    stand.running()
    for robot in ROBOTS:
        enable = stand.enable(robot)
        assert (enable.boot_id, enable.phase) == (stand.robots[robot].boot_id, Phase.RUNNING)
        assert enable.epoch == (9 if robot == "r2" else 1)
        assert 0 <= stand.robots[robot].nonce - enable.nonce <= 40 * MS
    stand.silent.add("r1")
    stand.run(S // 5)
    assert stand.enable("r1").nonce == stand.robots["r1"].nonce, "an old nonce is never made fresh"


def test_nobody_is_enabled_before_it_was_heard(stand: Stand) -> None:
    stand.silent.add("r3")
    stand.run(S // 5)
    assert stand.bench.heard(ENABLE, "r3") == []
    assert stand.bench.heard(ENABLE, "r2")


def test_a_state_every_40_ms_and_at_once_when_it_changes(stand: Stand) -> None:
    at: list[int] = []
    stand.bench.bus.tap(lambda said: at.append(stand.bench.now_ns) if said[0].endswith("/state") else None)
    stand.run(S)
    assert set(np.diff(at)) == {40 * MS}
    stand.bench.wait(5 * MS)
    before, enables = len(at), len(stand.bench.heard(ENABLE, "r1"))
    stand.ask("estop")
    assert len(at) == before + 1
    assert len(stand.bench.heard(ENABLE, "r1")) == enables + 1
    sequence = [state.seq for state in stand.bench.heard(STATE)]
    assert sequence == list(range(1, len(sequence) + 1))


def test_a_request_wakes_it(stand: Stand) -> None:
    stand.bench.bus.ask(REQUEST, "supervisor", b"estop")
    assert stand.woken == [stand.bench.now_ns]


def test_missed_periods_are_not_made_up(stand: Stand) -> None:
    stand.run(S // 5)
    before = len(stand.bench.heard(STATE))
    stand.bench.wait(S)
    for _ in range(5):
        assert 0 < stand.node.step(stand.bench.now_ns) - stand.bench.now_ns <= 40 * MS
    assert len(stand.bench.heard(STATE)) == before + 1
    assert stand.node.step(stand.bench.now_ns - S) <= stand.bench.now_ns - S + 40 * MS, "a clock that went back"

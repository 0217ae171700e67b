"""The supervisor's run: who may start it, what holds or ends it, and how it goes on."""

import pytest

from robofleet.bus.keys import RECORDER, STATUS, TICK
from robofleet.bus.messages import RecorderStatus, RobotTick, TickRecord
from robofleet.core.clock import MS, S
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.nodes.stand import Stand


def test_a_run_starts_when_asked_and_stops_when_asked(stand: Stand) -> None:
    stand.run(S)
    assert (stand.state.phase, max(stand.limits())) == (Phase.IDLE, 0.0)
    assert stand.ask("start") == "ok"
    stand.run(S)
    assert stand.cause == (Phase.RUNNING, Event.PROVED, NOBODY)
    fastest = [robot.vehicle.max_wheel_speed_rad_s for robot in stand.bench.config.members]
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
    for request in ("start", "hold", "hold", "resume", "resume", "estop", "estop"):
        assert stand.ask(request) == "ok"
    assert stand.state.phase == Phase.ESTOP


@pytest.mark.parametrize(
    ("requests", "last", "way_out"),
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
    stand: Stand, requests: list[str], last: str, way_out: str
) -> None:
    stand.run(S // 5)
    for request in requests:
        assert stand.ask(request) == "ok"
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


def test_blocked_robots_and_missed_ticks_hold_the_run(stand: Stand) -> None:
    stand.running()
    stand.stopped = {"blocked": 1.0}
    stand.run(100 * MS)
    assert stand.cause == (Phase.HOLD, Event.DEADLOCKED, 0)
    stand.stopped = {}
    stand.run(100 * MS)
    stand.ask("resume")
    head = (3, stand.build, 10**6, -1, stand.bench.now_ns, *[0] * 6, 0, 0, 3, 0, 0)
    stand.bench.say(TICK, TickRecord(*head, (RobotTick(*[0.0] * 15),) * 4, ()))
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
    stand.bench.say(TICK, TickRecord(3, 1, 10**6, -1, 0, *[0] * 6, 200, 0, 0, 0, 0, (RobotTick(*[0.0] * 15),) * 9, ()))
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
    head = (3, stand.build, stand.tick - 1, -1, 0, *[0] * 11)
    stand.bench.say(TICK, TickRecord(*head, (RobotTick(*[0.0] * 15)._replace(blocked=1.0),) * 4, ()))
    stand.node.step(stand.bench.now_ns)
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

"""Stops: the latched emergency stop and its way out, the operator who went away, a gate that closes, a robot's halt."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus import bus
from robofleet.bus.keys import COMMAND, ENABLE, LEASE, REQUEST, SAFE_REQUEST, STATUS, Topic
from robofleet.bus.messages import LEASE_REQUEST, LeaseRequest
from robofleet.core.clock import MS, S
from robofleet.safety.gate import LeaseAction
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from robofleet.vehicles.interface import STOP, WIRED_STOP, RobotFault
from tests.bus.alone import Enable, WheelCommand
from tests.nodes.stand import ROBOTS, Stand

Make = Callable[..., Any]


def emergency(stand: Stand) -> None:
    stand.running()
    assert stand.ask("estop") == "ok"
    stand.run(100 * MS)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


def test_an_emergency_stop_reaches_every_gate_at_once_and_is_acknowledged(stand: Stand) -> None:
    stand.running()
    stand.ask("estop")
    for robot in ROBOTS:
        enable = stand.enable(robot)
        assert (enable.latch, enable.limit_rad_s) == (Latch.EMERGENCY_STOP, 0.0)
    assert [robot.acknowledged for robot in stand.state.robots] == [0, 0, 0, 0]
    stand.run(100 * MS)
    assert stand.cause == (Phase.ESTOP, Event.ESTOP_REQUESTED, NOBODY)
    assert [robot.acknowledged for robot in stand.state.robots] == [1, 1, 1, 1]
    stand.run(S)
    assert not [line for line in stand.lines if "acknowledged" in line]


@pytest.mark.parametrize("order", [b"reset", b"resume", b"start"])
@pytest.mark.parametrize("first", [REQUEST, SAFE_REQUEST], ids=["the order first", "the stop first"])
def test_of_an_order_and_a_stop_that_came_together_the_stop_counts(stand: Stand, order: bytes, first: Topic) -> None:
    """A supervisor that stood still finds both: no order of before undoes a stop."""
    stand.running()
    requests = {REQUEST: order, SAFE_REQUEST: b"estop"}
    for topic in sorted(requests, key=lambda topic: topic is not first):
        stand.bench.bus.ask(topic, "supervisor", requests[topic])
    stand.run(S)
    assert stand.cause[0] == Phase.ESTOP
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


@pytest.mark.parametrize("order", [b"reset", b"resume", b"start"])
def test_an_operators_order_and_stop_that_came_together_leave_the_stop(stand: Stand, order: bytes) -> None:
    stand.running()
    for what in (b"estop", order, b"hold"):
        stand.bench.bus.ask(REQUEST, "supervisor", what)
    stand.run(S)
    assert stand.cause[0] == Phase.ESTOP
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


@pytest.mark.parametrize("deaf", [("r2",), ("r1", "r4")])
def test_who_has_not_acknowledged_after_200_ms_is_named(stand: Stand, deaf: tuple[str, ...]) -> None:
    stand.running()
    for robot in deaf:
        stand.robots[robot].deaf = True
    stand.ask("estop")
    stand.run(190 * MS)
    assert "not acknowledged" not in stand.lines[-1]
    stand.run(60 * MS)
    assert stand.lines[-1] == f"the emergency stop is not acknowledged by {', '.join(deaf)}"
    assert [robot.acknowledged for robot in stand.state.robots] == [int(robot not in deaf) for robot in ROBOTS]
    assert stand.ask("status").endswith(f"not acknowledged by {', '.join(deaf)}")
    stand.run(S)
    assert sum("not acknowledged" in line for line in stand.lines) == 1


def test_a_driver_that_comes_back_later_is_stopped_too(stand: Stand) -> None:
    stand.running()
    stand.silent.add("r3")
    stand.robots["r3"].deaf = True
    stand.ask("estop")
    stand.run(5 * S)
    assert stand.robots["r3"].latch is Latch.NONE
    stand.robots["r3"].boot_id, stand.robots["r3"].deaf = 999, False
    stand.silent.clear()
    stand.run(100 * MS)
    assert stand.robots["r3"].latch is Latch.EMERGENCY_STOP
    assert stand.state.robots[2].acknowledged == 1


@pytest.mark.parametrize("phase", ["IDLE", "RUNNING", "HOLD", "FAULT"])
def test_a_robots_own_e_stop_stops_them_all_whatever_the_run_does(stand: Stand, phase: str) -> None:
    if phase != "IDLE":
        stand.running()
    if phase == "HOLD":
        stand.ask("hold")
    if phase == "FAULT":
        stand.epoch, stand.tick = 8, 0  # another controller
    stand.run(100 * MS)
    assert stand.state.phase == Phase[phase]
    stand.robots["r2"].says = {"faults": WIRED_STOP}
    stand.run(100 * MS)
    assert stand.cause == (Phase.ESTOP, Event.WIRED_STOP, 1)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


def test_a_reset_clears_the_latches_and_moves_nothing(stand: Stand) -> None:
    emergency(stand)
    stand.run(S)
    before = len(stand.bench.heard(ENABLE, "r1"))
    assert stand.ask("reset", S // 5) == "ok"
    stand.run(S)
    assert stand.cause == (Phase.IDLE, Event.RESET, NOBODY)
    assert {robot.latch for robot in stand.robots.values()} == {Latch.NONE}
    for robot in ROBOTS:
        assert {enable.limit_rad_s for enable in stand.bench.heard(ENABLE, robot)[before:]} == {0.0}
    stand.running()


def test_a_reset_clears_no_latch_that_came_later(stand: Stand) -> None:
    emergency(stand)
    stand.ask("reset")
    stand.robots["r1"].latch, stand.robots["r1"].latch_id = Latch.DRIVER_FAILED, 2
    stand.run(S)
    assert [robot.latch for robot in stand.robots.values()] == [Latch.DRIVER_FAILED, 0, 0, 0]


def test_a_reset_that_a_gate_does_not_follow_is_refused_by_name(stand: Stand) -> None:
    emergency(stand)
    stand.robots["r4"].deaf = True
    assert stand.ask("reset", 480 * MS) == "no answer"
    assert stand.ask("reset", 100 * MS).startswith("refused: r4: ")


def test_an_emergency_stop_during_a_reset_wins(stand: Stand) -> None:
    from robofleet.bus.keys import REQUEST

    emergency(stand)
    reset = stand.bench.bus.ask(REQUEST, "supervisor", b"reset")
    assert stand.ask("estop") == "ok"
    stand.run(S // 5)
    assert (reset.take() or b"").startswith(b"refused: the emergency stop is latched")
    assert stand.state.phase == Phase.ESTOP
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


@pytest.mark.parametrize(
    ("says", "why"),
    [
        ({"left_rad_s": 0.06}, "r3 is not at rest"),
        ({"right_rad_s": -0.06}, "r3 is not at rest"),
        ({"left_output_rad_s": 0.06}, "r3 is not at rest"),
        ({"right_output_rad_s": -0.06}, "r3 is not at rest"),
        ({"faults": WIRED_STOP}, "r3: its own e-stop is pressed"),
        ({"faults": RobotFault.UNREACHABLE, "left_rad_s": 3.0}, "r3: its driver has lost the connection to it"),
        ({"latch": Latch.NONE}, "r3 has not acknowledged"),
        ({"latch": Latch.DRILL}, "r3 has not acknowledged"),
    ],
)
def test_a_reset_is_refused_with_a_reason(stand: Stand, says: dict[str, Any], why: str) -> None:
    emergency(stand)
    stand.robots["r3"].says = says
    stand.run(100 * MS)
    assert stand.ask("reset").startswith(f"refused: {why}")
    stand.run(S)
    assert stand.state.phase == Phase.ESTOP
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}
    stand.robots["r3"].says = {}
    stand.run(100 * MS)
    assert stand.ask("reset", S // 5) == "ok"


def test_a_robot_that_is_gone_does_not_keep_the_others_from_a_reset(stand: Stand) -> None:
    stand.running()
    stand.silent.add("r3")
    stand.robots["r3"].deaf = True
    stand.ask("estop")
    stand.run(400 * MS)
    assert stand.ask("reset").startswith("refused: r3 has not acknowledged")
    stand.run(200 * MS)
    assert stand.ask("reset", S // 5) == "ok"
    assert stand.state.phase == Phase.IDLE


def test_a_reset_of_what_is_clear_is_answered_at_once(stand: Stand) -> None:
    stand.run(S // 5)
    assert stand.ask("reset") == "ok"
    assert stand.state.phase == Phase.IDLE


@pytest.mark.parametrize("phase", ["ARMED", "RUNNING", "HOLD"])
def test_a_run_whose_operator_went_away_is_stopped_for_good(stand_of: Callable[..., Stand], phase: str) -> None:
    stand = stand_of(attended=True)
    if phase == "ARMED":
        stand.silent.add("r1")  # the checks wait for it
        stand.run(S // 5)
        stand.ask("start")
        stand.run(3 * S)
    else:
        stand.running()
        stand.run(3 * S)
    if phase == "HOLD":
        stand.ask("hold")
    stand.silent.add("operator")
    stand.run(S - 200 * MS)
    assert stand.state.phase == Phase[phase]
    stand.run(300 * MS)
    assert stand.cause == (Phase.ESTOP, Event.OPERATOR_LOST, NOBODY)


def test_an_operator_who_asks_for_a_start_has_a_second_to_be_there(stand_of: Callable[..., Stand]) -> None:
    stand = stand_of(attended=True)
    stand.silent |= {"operator", "r1"}
    stand.run(3 * S)
    assert stand.state.phase == Phase.IDLE
    stand.ask("start")
    stand.run(900 * MS)
    assert stand.state.phase == Phase.ARMED
    stand.run(200 * MS)
    assert stand.cause == (Phase.ESTOP, Event.OPERATOR_LOST, NOBODY)


def test_a_run_that_needs_no_operator_goes_on_without_one(stand: Stand) -> None:
    stand.silent.add("operator")
    stand.running()
    stand.run(3 * S)
    assert stand.state.phase == Phase.RUNNING


def test_the_stop_is_repeated_while_the_gate_is_closed(
    bench_of: Make, platoon_of: Make, recorded: Make, fake_driver: Any, driver_of: Make
) -> None:
    bench = bench_of(platoon_of(*recorded(0)))
    node = driver_of(bench, "r1")
    bench.run(node, S // 10)
    bench.bus.ask(LEASE, "r1", LEASE_REQUEST.encode(LeaseRequest(5, LeaseAction.ACQUIRE)))
    bench.run(node, S // 10)
    seen = bench.heard(STATUS, "r1")[-1]
    bench.say(COMMAND, WheelCommand(seen.epoch, 1, 5, seen.boot_id, seen.nonce, 0, 3.0, 3.0), "r1")
    bench.say(ENABLE, Enable(seen.epoch, 1, seen.boot_id, seen.nonce, Phase.RUNNING, 0, 0, 5.0), "r1")
    bench.run(node, 50 * MS)
    driver = fake_driver.instances["r1"]
    assert driver.target != STOP
    bench.run(node, 250 * MS)  # nobody says anything any more
    stops = [at for at, wheels in driver.writes if wheels == STOP and at > seen.nonce + 120 * MS]
    assert len(stops) >= 10
    assert max(np.diff(stops)) <= 10 * MS


def test_a_camera_that_is_too_slow_stops_the_run_by_name(truth: Make) -> None:
    figures = truth("run.duration_s=3", "camera.trigger=free", "camera.rate_hz=1")
    assert figures["outcome"] == "fault"
    assert figures["cause"].startswith(("the tracker went silent", "r1: the tracker lost the robot"))


@pytest.mark.parametrize("what", ["a line", "an answer"])
def test_a_stop_is_published_before_anything_is_said(stand: Stand, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    """A full disk, or a reader of the log that is gone, must not come between a stop and the gates."""
    stand.running()
    instants: list[int] = []

    def fails(*_: object) -> None:
        instants.append(stand.enable("r4").latch)
        raise OSError("no space left on device")

    if what == "a line":
        monkeypatch.setattr(stand.node, "_say", fails)
    else:
        monkeypatch.setattr(bus._MemoryRequest, "reply", fails)
    with pytest.raises(OSError, match="no space"):
        stand.ask("estop")
    assert instants == [Latch.EMERGENCY_STOP]
    assert stand.cause == (Phase.ESTOP, Event.ESTOP_REQUESTED, NOBODY)
    assert {stand.enable(robot).latch for robot in ROBOTS} == {Latch.EMERGENCY_STOP}

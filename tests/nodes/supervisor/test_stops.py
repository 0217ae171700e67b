"""Stops: the latched emergency stop and its way out, the operator who went away, a gate that closes, a robot's halt."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.bus import bus
from robofleet.bus.keys import COMMAND, ENABLE, LEASE, REQUEST, STATUS
from robofleet.bus.messages import LEASE_REQUEST, LeaseRequest
from robofleet.core.clock import MS, S
from robofleet.safety.gate import LeaseAction
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from robofleet.vehicles.interface import STOP
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

    emergency(stand)
    reset = stand.bench.bus.ask(REQUEST, "supervisor", b"reset")
    assert stand.ask("estop") == "ok"
    stand.run(S // 5)
    assert (reset.take() or b"").startswith(b"refused: the emergency stop is latched")
    assert stand.state.phase == Phase.ESTOP
    assert {robot.latch for robot in stand.robots.values()} == {Latch.EMERGENCY_STOP}


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

"""Several robots in one driver process: none pays for another one's robot."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from robofleet.bus.keys import STATUS
from robofleet.core.clock import MS, S
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, WIRED_STOP, DriverReading, RobotFault, WheelSpeeds
from tests.runs.realrun import wait

Make = Callable[..., Any]
FORWARD = WheelSpeeds(3.0, 4.0)


def test_a_slow_robot_gives_its_neighbour_no_time(stand: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    stand.acquire("r1")
    issued_ns = stand.newest("r2").nonce
    stand.command("r1", "r2")
    stand.enable("r1", "r2")
    with monkeypatch.context() as context:
        context.setattr(stand.made["r1"], "write", lambda _: stand.bench.wait(130 * MS))
        stand.node.step(stand.bench.now_ns)
    assert stand.bench.now_ns - issued_ns >= 130 * MS
    stand.bench.run(stand.node, 30 * MS)
    assert {wheels for _, wheels in stand.made["r2"].writes} == {STOP}
    assert stand.newest("r2").rejected == 2


def test_a_robot_that_cannot_be_given_a_gate_is_closed_too(
    bench_of: Make, platoon_of: Make, recorded: Make, fake_driver: Any, driver_of: Make
) -> None:
    class Nowhere:
        def load(self, robot: str) -> Any:
            raise MemoryError(robot)

    with pytest.raises(MemoryError, match="r1"):
        driver_of(bench_of(platoon_of(*recorded(0))), "r1", state_store=Nowhere())
    assert fake_driver.instances["r1"].closed == 1


@pytest.mark.parametrize("how", ["unwritable", "unreadable"])
def test_a_robot_that_fails_is_latched_alone(stand: Any, fake_driver: Any, how: str) -> None:
    stand.run(S // 5, robot="r1")
    stand.run(S // 5, robot="r2")
    getattr(fake_driver, how).add("r1")
    drive_both(stand, S // 5)
    first, other = stand.newest("r1"), stand.newest("r2")
    assert (first.gate, first.latch, first.latch_id) == (GateStatus.LATCHED, Latch.DRIVER_FAILED, 1)
    assert (other.gate, other.latch) == (GateStatus.OPEN, Latch.NONE)
    assert stand.made["r2"].target == FORWARD


@pytest.mark.parametrize(
    "reading",
    [
        DriverReading(math.nan, 0.0, 0.0, 0.0, 0.5, 0),
        DriverReading(0.0, 0.0, 0.0, math.inf, 0.5, 0),
        DriverReading(0.0, 0.0, 0.0, 0.0, 0.5, -1),
        DriverReading(0.0, 0.0, 0.0, 0.0, 0.5, 1 << 32),
        None,
    ],
)
def test_a_reading_that_says_nothing_is_a_failure(
    stand: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], reading: Any
) -> None:
    stand.run(S // 5)
    robot = stand.made["r1"]
    monkeypatch.setattr(robot, "read", lambda: reading)
    stand.run(S // 5)
    assert stand.newest("r1").latch == Latch.DRIVER_FAILED  # and its status can be read
    assert wait(lambda: robot.closed, 1.0)
    assert capsys.readouterr().err.count("r1: its driver failed") == 1


def test_a_wired_stop_acts_within_a_loop_and_holds(stand: Any) -> None:
    stand.run(S // 5)
    pressed_ns, stand.made["r1"].faults = stand.bench.now_ns, WIRED_STOP
    stand.run(S // 5)
    falls = [at for at, wheels in stand.made["r1"].writes if at > pressed_ns and wheels != FORWARD]
    assert falls[0] - pressed_ns <= 10 * MS
    status = stand.newest("r1")
    assert (status.latch, status.faults) == (Latch.WIRED_STOP, WIRED_STOP)
    stand.enable("r1", clear=status.latch_id)  # still pressed
    stand.run(S // 5)
    assert (stand.newest("r1").latch, stand.newest("r1").latch_id) == (Latch.WIRED_STOP, status.latch_id)
    stand.made["r1"].faults = 0
    stand.run(S // 5)
    assert (stand.newest("r1").gate, stand.newest("r1").faults) == (GateStatus.LATCHED, 0)  # it is pressed no more
    stand.enable("r1", clear=status.latch_id)
    stand.run(S // 5)
    assert stand.newest("r1").gate == GateStatus.OPEN


@pytest.mark.slow_after_first
@pytest.mark.parametrize("fault", [*set(RobotFault) - {RobotFault.WIRED_STOP}, RobotFault.OWN << 3])
def test_a_fault_stops_its_robot_within_a_loop_and_is_said_until_a_reset(stand: Any, fault: RobotFault) -> None:
    for name in ("r1", "r2"):
        stand.run(S // 5, robot=name)
    stand.made["r1"].faults, felt_ns = fault, stand.bench.now_ns
    stand.bench.run(
        stand.node, 10 * MS, (33 * MS, partial(stand.command, "r1")), (40 * MS, partial(stand.enable, "r1"))
    )
    stand.made["r1"].faults = 0  # shorter than a status takes
    drive_both(stand, S // 5)
    falls = [at for at, wheels in stand.made["r1"].writes if at > felt_ns and wheels != FORWARD]
    assert falls[0] - felt_ns <= 10 * MS
    assert stand.made["r1"].target == STOP
    status = stand.newest("r1")
    assert (status.gate, status.latch, status.faults) == (GateStatus.LATCHED, Latch.ROBOT_FAULT, fault)
    assert (stand.newest("r2").gate, stand.newest("r2").faults) == (GateStatus.OPEN, 0)
    stand.enable("r1", clear=status.latch_id)
    stand.run(S // 5)
    states = [
        (reported_status.latch, reported_status.faults)
        for reported_status in stand.bench.heard(STATUS, "r1")
        if reported_status.nonce > felt_ns
    ]
    assert set(states[1:]) == {(Latch.ROBOT_FAULT, fault), (Latch.NONE, 0)}  # never the one without the other
    assert stand.newest("r1").gate == GateStatus.OPEN


def drive_both(stand: Any, ns: int) -> None:
    acts = [(33 * MS, partial(stand.command, name)) for name in ("r1", "r2")]
    acts += [(40 * MS, partial(stand.enable, name)) for name in ("r1", "r2")]
    stand.bench.run(stand.node, ns, *acts)

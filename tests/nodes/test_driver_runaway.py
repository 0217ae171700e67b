"""A wheel that turns though its gate gives zero: the driver latches and says so, in every state of its gate."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.bus.keys import STATUS
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from robofleet.vehicles.interface import DriverReading

Make = Callable[..., Any]
FAST = 6.1


def reads(stand: Any, monkeypatch: pytest.MonkeyPatch, left: float, right: float) -> None:
    monkeypatch.setattr(stand.made["r1"], "read", lambda: DriverReading(1.0, 1.0, left, right, 0.5, 0))


@pytest.mark.parametrize("wheels", [(FAST, 0.0), (0.0, -FAST)])
def test_it_is_latched_and_named_once(
    stand: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], wheels: tuple[float, float]
) -> None:
    reads(stand, monkeypatch, *wheels)
    stand.bench.run(stand.node, 2 * S)
    statuses = stand.bench.heard(STATUS, "r1")
    assert {status.latch for status in statuses} == {Latch.NONE, Latch.RUNAWAY}
    first = next(status for status in statuses if status.latch)
    assert 800 * MS <= first.stamp_ns - statuses[0].stamp_ns <= 850 * MS
    (line,) = capsys.readouterr().err.splitlines()
    wheel, speed = ("left", FAST) if wheels[0] else ("right", -FAST)
    assert line == f"r1: its {wheel} wheel turns by itself, at {speed} rad/s: switch off its power"
    assert stand.newest("r2").latch == Latch.NONE


def test_it_is_kept_and_cleared_only_at_rest(stand: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    reads(stand, monkeypatch, FAST, FAST)
    stand.bench.run(stand.node, S)
    clear = stand.newest("r1").latch_id
    for _ in range(3):
        stand.enable("r1", clear=clear)
        stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.RUNAWAY
    reads(stand, monkeypatch, 0.0, 0.0)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.RUNAWAY
    stand.enable("r1", clear=clear)
    stand.bench.run(stand.node, 25 * MS)
    assert stand.newest("r1").latch == Latch.NONE


def test_a_reading_of_a_robot_that_is_gone_says_nothing(
    stand: Any, fake_driver: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads(stand, monkeypatch, FAST, FAST)
    stand.bench.run(stand.node, 100 * MS)
    monkeypatch.undo()
    fake_driver.unreadable.add("r1")
    stand.bench.run(stand.node, 2 * S)
    assert stand.newest("r1").latch == Latch.DRIVER_FAILED


RUNS = "{kind: motor_runs, robot: r2, wheel: left, speed_rad_s: %s, at_s: %s, duration_s: 6.0}"


def played(platoon_of: Make, at: float | None, request: bytes | None, speed: float = FAST) -> tuple[Lockstep, float]:
    """Return a lockstep run in which r2's left wheel runs away, and how long until that was the run's cause [s]."""
    fault = RUNS % (speed, "null" if at is None else at)
    config: Config = platoon_of("tracker.source=truth", f"faults=[{fault}]")
    run = Lockstep(config)
    if at is not None:
        run.request(b"start")
        assert run.advance(60.0, lambda: run.status.phase is Phase.RUNNING)
        if request is not None:
            run.advance(at - 0.5)
            run.request(request)
            run.advance(0.5)
        else:
            run.advance(at)
    began_ns = run.clock.now_ns()
    run.advance(5.0, lambda: run.status.cause is Event.RUNAWAY)
    return run, (run.clock.now_ns() - began_ns) / S


@pytest.mark.slow
@pytest.mark.parametrize(("at", "request_"), [(1.0, b"hold"), (1.0, b"stop"), (None, None)])
def test_it_ends_in_an_emergency_stop_from_hold_and_from_idle(
    platoon_of: Make, at: float | None, request_: bytes | None
) -> None:
    run, after_s = played(platoon_of, at, request_)
    assert run.status.phase is Phase.ESTOP
    assert run.status.robot == 1
    assert after_s < 1.0
    run.advance(0.2)
    answer = run.request(b"reset")
    run.advance(0.2)
    assert answer.take() == b"refused: r2: a wheel turns by itself: switch off its power, then reset"
    run.advance(7.0)
    run.request(b"reset")
    run.advance(1.0)
    assert run.status.phase is Phase.IDLE
    run.close()


@pytest.mark.slow
@pytest.mark.parametrize("speed", [-3.0, 11.0])
def test_it_ends_in_an_emergency_stop_while_its_robot_drives(platoon_of: Make, speed: float) -> None:
    run, after_s = played(platoon_of, 3.0, None, speed)
    assert (run.status.phase, run.status.robot) == (Phase.ESTOP, 1)
    assert after_s < 2.0
    run.close()

"""Simulated robots in arrays, compiled, say the same bytes as robots that have a gate and a driver each, plain."""

from typing import Any

import pytest

from robofleet.config.load import load_config
from robofleet.nodes.unit import drivers
from robofleet.nodes.unit.driver import DriverProcess
from robofleet.nodes.unit.gated_robot import GatedRobots
from robofleet.nodes.unit.simulated_robots import SimulatedRobots
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from tests.process_fixtures import PLATOON

WHEN = "at_s: 0.3, duration_s: 0.6"
HEALTHY = ("tracker.source=truth",)
OTHER_BODIES = tuple(
    f"robots.{row}.vehicle.simulated.{change}"
    for row, change in (
        (1, "loop_period_s=0.015"), (1, "slip_s_per_rad=0.1"), (1, "battery_life_s=30"), (2, "actuation_delay_s=0.025"),
        (2, "motor_lag_s=0"), (2, "speed_quantum_rad_s=0"), (3, "wheel_gain_error=0.02"),
    )
)  # fmt: skip


def told(monkeypatch: pytest.MonkeyPatch, *changes: str, arrays: bool) -> tuple[str, list[Any], set[Any]]:
    """Return a run's hash, what its gates got and decided, and its phases; every lease is also released once."""
    if not arrays:
        monkeypatch.setattr(drivers, "in_arrays", lambda *_: False)
    witnessed: list[Any] = []
    run = Lockstep(load_config(PLATOON, [*HEALTHY, *changes]), probe=lambda *what: witnessed.append(what))
    made = {type(node._robots) for node in run.nodes.values() if isinstance(node, DriverProcess)}
    assert made == {SimulatedRobots if arrays else GatedRobots}
    phases = set()
    run.request(b"start")
    run.advance(30.0, lambda: run.status.phase is Phase.RUNNING)
    phases.add(run.status.phase)
    for request in (b"", b"hold", b"resume", b"estop", b"reset"):
        if request:
            run.request(request)
        run.advance(1.0 if not request else 0.4)
        phases.add(run.status.phase)
    run.close()
    return run.recording.trace_hash, witnessed, phases


FAULTS = {
    "a wheel that runs": (f"{{kind: motor_runs, robot: r2, wheel: left, speed_rad_s: 4, {WHEN}}}",),
    "a driver's clock": (f"{{kind: clock_step, process: driver-r1, step_s: -0.05, {WHEN}}}",),
    "a full disk": (f"{{kind: disk_full, {WHEN}}}",),
    "bad links": (
        f"{{kind: lost, topics: [cmd, enable, status], share: 0.3, burst_s: 0.3, {WHEN}}}",
        f"{{kind: not_a_number, topics: [cmd], share: 0.2, {WHEN}}}",
        f"{{kind: reordered, topics: [enable, cmd], share: 0.3, {WHEN}}}",
    ),
}  # fmt: skip


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", FAULTS)
def test_the_same_bytes_and_the_same_decisions(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    changes = [f"faults=[{', '.join(FAULTS[name])}]"]
    arrays = told(monkeypatch, *changes, arrays=True)
    alone = told(monkeypatch, *changes, arrays=False)
    for first, other in zip(arrays[1], alone[1], strict=False):
        assert first == other
    assert arrays == alone
    assert Phase.ESTOP in arrays[2]


@pytest.mark.slow
def test_the_same_in_units_of_any_grouping_and_order(monkeypatch: pytest.MonkeyPatch) -> None:
    changes = ["robots.0.unit=b", "robots.2.unit=a", "robots.3.unit=b", *OTHER_BODIES]
    arrays = told(monkeypatch, *changes, arrays=True)
    assert arrays == told(monkeypatch, *changes, arrays=False)
    assert Phase.RUNNING in arrays[2]

"""A whole fleet in lockstep is armed: a healthy one runs, every faulty wiring is named and nobody runs."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import STATE, STATUS, TICK, key
from robofleet.bus.messages import RUN_STATE, TICK_RECORD
from robofleet.config.load import load_config
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.arming import Stage
from robofleet.safety.supervisor import Event, Phase
from robofleet.safety.wiggle import BACK, FORTH, STAND
from tests.command import robofleet
from tests.process_fixtures import PLATOON

Make = Callable[..., Any]
PLANT = "robots.2.vehicle.simulated"
FAULTS = {
    f"{PLANT}.wiring=swapped": "r3: its wheels are swapped",
    f"{PLANT}.wiring=left_reversed": "r3: its left wheel turns backwards",
    f"{PLANT}.wiring=right_reversed": "r3: its right wheel turns backwards",
    f"{PLANT}.wiring=both_reversed": "r3: both its wheels turn backwards",
    f"{PLANT}.wheel_gain_error=0.2": "r3: it travels 1.",
    f"{PLANT}.wheel_gain_error=-0.2": "r3: it travels 0.",
}


def armed(*overrides: str) -> Lockstep:
    """Return a run of one tick without pixels, done."""
    run = Lockstep(
        load_config(
            PLATOON, ["tracker.source=truth", "run.duration_s=0.033", "drivers.robots_per_process=1", *overrides]
        )
    )
    run.run()
    return run


def states(run: Lockstep) -> list[Any]:
    return [RUN_STATE.decode(payload) for payload in run.recording.messages[key("platoon", STATE)]]


@pytest.mark.slow_after_first
@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_robot_is_named_and_nobody_runs(truth: Make, fault: str) -> None:
    s = truth(fault)
    assert s["outcome"] == "fault"
    assert FAULTS[fault] in s["cause"]
    assert s["ticks"] == 0


def test_only_the_robots_of_the_rounds_up_to_the_faulty_one_ever_turned_a_wheel() -> None:
    """The second and the third stand close: the one wiggles before the other."""
    run = armed("robots.1.vehicle.simulated.wiring=swapped")
    turned = {
        robot: bool(np.any(run.recording.of_robot(STATUS, robot)["left_angle_rad"]))
        for robot in ("r1", "r2", "r3", "r4")
    }
    assert turned == {"r1": False, "r2": True, "r3": False, "r4": True}


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("change", "within_s"),
    [("run.seed=7", 4.0), ("camera.trigger=free", 4.0), ("tracker.truth.dropout=0.3", 5.5)],
)
def test_a_healthy_fleet_is_armed_in_time_round_by_round(change: str, within_s: float) -> None:
    run = armed(change)
    state_rows = states(run)
    assert Phase.RUNNING in {state.phase for state in state_rows}
    wiggled = [state for state in state_rows if state.stage == Stage.WIGGLE]
    strokes = dict.fromkeys(tuple(robot.stroke for robot in state.robots) for state in wiggled)
    assert {stroke for each in strokes for stroke in each} == {STAND, FORTH, BACK}
    assert all(robot.permitted == (robot.stroke != STAND) for state in wiggled for robot in state.robots)
    assert not any(each[1] and each[2] for each in strokes), "they stand close"
    ticks = [TICK_RECORD.decode(payload) for payload in run.recording.messages[key("platoon", TICK)]]
    assert 0.033 * sum(tick.phase == Phase.ARMED for tick in ticks) <= within_s


@pytest.mark.slow
@pytest.mark.parametrize("change", ["max_wheel_speed_rad_s=4.0", "max_speed_m_s=0.06"])
def test_a_slow_robot_is_tried_as_fast_as_it_may_go(change: str) -> None:
    run = armed(f"robots.0.vehicle.{change}")
    assert states(run)[-1].cause == Event.STOP_REQUESTED
    statuses, others = (run.recording.of_robot(STATUS, robot) for robot in ("r1", "r2"))
    assert statuses["rejected"][-1] == others["rejected"][-1]  # no command for the speed that it asks for
    armed_only = statuses["left_output_rad_s"][:-60]  # then it runs for a tick and rests for a second
    assert 3.5 < armed_only.max() <= 4.7


@pytest.mark.slow
def test_the_operator_is_told_and_the_exit_code_is_1(tmp_path: Path) -> None:
    arguments = ["run", str(PLATOON), "--lockstep", "--json", "--out", str(tmp_path / "run")]
    result = robofleet(
        *arguments, "--set", "tracker.source=truth", "--set", "robots.0.vehicle.simulated.wiring=swapped"
    )
    assert result.exit_code == 1
    assert "r1: its wheels are swapped" in json.loads(result.stdout)["cause"]

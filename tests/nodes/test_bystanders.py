"""Robots that a run does not drive: bodies that stand there, or that a hand moves, and that nobody may hit."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robofleet.behaviours.platoon import Platoon
from robofleet.bus.keys import STATUS, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.recording.run import Run
from robofleet.reports.metrics import summary
from robofleet.runs.check import load_checked, refusals
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Phase
from tests.bus.alone import ROBOT_STATUS
from tests.shipped import PLATOON

Make = Callable[..., Config]
TRUTH = "tracker.source=truth"
GAP_MM = 10.0  # controller.barrier.gap_m
LOST = "it is a bystander, and the tracker no longer sees it"


def parked(x_m: float, y_m: float, **fields: Any) -> str:
    """Return what adds a robot to the fleet, and not to its group."""
    robots = yaml.safe_load(PLATOON.read_text())["robots"]
    start = {"x_m": x_m, "y_m": y_m, "heading_deg": 30.0}
    return f"robots={json.dumps([*robots, {'id': 'p1', 'tag': 9, 'vehicle': 'gternal', 'start': start, **fields}])}"


def beside(config: Config, sigma: float, left_m: float) -> tuple[float, float]:
    """Return a place so far to the left of the path."""
    path, at = Platoon.Settings.model_validate(config.groups[0].settings).path.path(), np.array([sigma])
    (x, y), (along, across) = path.position(at)[0], path.tangent(at)[0]
    return round(float(x - left_m * across), 4), round(float(y + left_m * along), 4)


def driven(config: Config) -> dict[str, Any]:
    run = Lockstep(config)
    outcome, cause = run.run()
    return summary(run.recording, name="x", mode="lockstep", outcome=outcome, cause=cause)


def hand(config: Config, speed: float, at_s: float, duration_s: float) -> str:
    """Return what pushes the robot towards the path from its right side."""
    (tangent,) = Platoon.Settings.model_validate(config.groups[0].settings).path.path().tangent(np.array([0.5]))
    velocity = (speed * np.array([-tangent[1], tangent[0]])).round(4).tolist()
    return f"faults=[{{kind: pushed, robot: p1, velocity_m_s: {velocity}, at_s: {at_s}, duration_s: {duration_s}}}]"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("left_m", "how"),
    [
        *[(left_m, (TRUTH,)) for left_m in (0.0, -0.06, -0.15)],
        *[pytest.param(left_m, (), marks=pytest.mark.long) for left_m in (0.0, -0.06, -0.15)],
        *[pytest.param(left_m, ("reality",), marks=pytest.mark.long) for left_m in (0.0, -0.06, -0.15)],
    ],
)
def test_nobody_hits_a_robot_that_is_parked_on_the_path(platoon_of: Make, how: tuple[str, ...], left_m: float) -> None:
    pose = beside(platoon_of(), 0.5, left_m)
    fields = {"reality": "simulated"} if how == ("reality",) else {}
    keys = [key for key in how if key != "reality"]
    s = driven(platoon_of(parked(*pose, **fields), "run.duration_s=17", *keys))
    assert (s["robots"], s["bystanders"]) == (["r1", "r2", "r3", "r4"], ["p1"])
    assert s["min_gap_mm"] >= GAP_MM
    assert s["filtered_fraction"] > 0.05, "they did come near"
    assert s["min_centre_distance_mm"] < 210, "and it is counted"


@pytest.mark.slow
@pytest.mark.parametrize("source", [TRUTH, pytest.param("tracker.source=camera", marks=pytest.mark.long)])
@pytest.mark.parametrize(("speed", "duration_s"), [(0.03, 10.0), (0.1, 3.0)])
def test_nobody_hits_a_robot_that_a_hand_pushes_onto_the_path(
    platoon_of: Make, speed: float, duration_s: float, source: str
) -> None:
    config = platoon_of()
    push = hand(config, speed, 12.0 - duration_s, duration_s)  # the leader is there then
    s = driven(platoon_of(parked(*beside(config, 0.5, -0.3)), "run.duration_s=17", source, push))
    assert s["min_gap_mm"] >= GAP_MM
    assert s["filtered_fraction"] > 0.05, "they did come near"


@pytest.mark.slow
@pytest.mark.parametrize(("hidden_s", "held"), [(1.9, False), (2.3, True)])
def test_who_is_not_seen_for_two_seconds_holds_the_run(platoon_of: Make, hidden_s: float, held: bool) -> None:
    hide = f"faults=[{{kind: pose_dropout, robot: p1, at_s: 2, duration_s: {hidden_s}}}]"
    run = Lockstep(platoon_of(parked(1.0, 0.0), "run.duration_s=6", TRUTH, hide))
    run.request(b"start")
    assert run.advance(60, lambda: run.status.phase is Phase.RUNNING)
    assert run.advance(5, lambda: run.status.phase is not Phase.RUNNING) == held
    if held:
        assert run.status.phase is Phase.HOLD
        assert run.status.describe(("r1", "r2", "r3", "r4", "p1")) == f"p1: {LOST}"
        run.advance(1)
        run.request(b"resume")  # it is seen again
        assert run.advance(1, lambda: run.status.phase is Phase.RUNNING)
    run.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pose", "fault", "cause"),
    [
        ((1.0, 0.0), "{kind: pose_dropout, robot: p1}", "p1: the tracker lost the robot"),
        ((1.0, 0.0), "{kind: wired_stop, robot: p1}", "p1: the robot's own e-stop"),
        ((-1.408, -0.348), "", "r4: it is too close to p1"),
        ((1.0, 0.0), "{kind: pushed, robot: p1, velocity_m_s: [0.1, 0.0]}", "p1: it is not at rest"),
    ],
)
def test_a_fleet_beside_it_is_not_started(platoon_of: Make, pose: tuple[float, float], fault: str, cause: str) -> None:
    s = driven(platoon_of(parked(*pose), "run.duration_s=2", TRUTH, f"faults=[{fault}]"))
    assert (s["outcome"], s["ticks"]) == ("fault", 0)
    assert s["cause"].startswith(cause)


@pytest.mark.slow
@pytest.mark.parametrize("pose", [(1.57, 0.0), (1.0, 0.0)])
@pytest.mark.parametrize("fault", ["", "{kind: low_battery, robot: p1}", "{kind: killed, process: driver-p1, at_s: 1}"])
def test_what_concerns_only_itself_stops_nobody(platoon_of: Make, pose: tuple[float, float], fault: str) -> None:
    """Beyond the arena's edge, its battery empty, its driver gone."""
    s = driven(platoon_of(parked(*pose), "run.duration_s=5", TRUTH, f"faults=[{fault}]"))
    assert (s["outcome"], s["stops"]) == ("completed", [])


@pytest.mark.slow
def test_the_fleet_drives_as_if_it_were_not_there_where_it_is_far_away(platoon_of: Make) -> None:
    """The same ticks, to the last bit."""
    exact = (TRUTH, "tracker.truth={}", "run.duration_s=5")
    ticks = []
    for config in (platoon_of(*exact), platoon_of(*exact, parked(1.0, 0.0))):
        run = Lockstep(config)
        run.run()
        columns = Run(run.recording).items
        ticks.append([columns[name] for name in TICK_RECORD.item_dtype.names])
    assert all(np.array_equal(*pair) for pair in zip(*ticks, strict=True))


@pytest.mark.slow
def test_the_emergency_stop_latches_it_too_and_a_reset_clears_it(platoon_of: Make) -> None:
    run = Lockstep(platoon_of(parked(1.0, 0.0), TRUTH))
    run.request(b"start")
    assert run.advance(60, lambda: run.status.phase is Phase.RUNNING)

    def latch() -> int:
        status = ROBOT_STATUS.decode(run.recording.messages[key("platoon", STATUS, "p1")][-1])
        assert status is not None
        return status.latch

    assert latch() == Latch.NONE
    assert Latch.DRILL not in run.recording.of_robot(STATUS, "p1")["latch"]
    run.request(b"estop")
    assert run.advance(0.2, lambda: latch() == Latch.EMERGENCY_STOP)
    run.advance(2)
    run.request(b"reset")
    assert run.advance(1, lambda: run.status.phase is Phase.IDLE and latch() == Latch.NONE)
    rows = run.recording.of_robot(STATUS, "p1")
    assert not rows["left_output_rad_s"].any()
    run.close()


def test_check_accepts_it_where_nobody_comes(platoon_of: Make) -> None:
    assert refusals(platoon_of(parked(0.0, 0.0))) == []


@pytest.mark.parametrize(("left_m", "refused"), [(0.0, True), (-0.18, True), (-0.2, False)])
def test_check_refuses_it_too_near_to_the_path(platoon_of: Make, left_m: float, refused: bool) -> None:
    pose = beside(platoon_of(), 0.35, left_m)
    found = [(at, text) for at, text in refusals(platoon_of(parked(*pose))) if "from the path" in text]
    assert [at for at, _ in found] == ["robots.4.start"] * refused
    assert all("so park p1 further away" in text for _, text in found)
    excitation = platoon_of(parked(*pose), "groups.0.behaviour=excitation", "groups.0.settings={}")
    assert not [text for _, text in refusals(excitation) if "from the path" in text], "it follows no path"


@pytest.mark.parametrize(("gap_m", "refused"), [(0.009, True), (0.011, False)])
def test_check_refuses_it_within_reach_of_a_wiggle(platoon_of: Make, gap_m: float, refused: bool) -> None:
    config = platoon_of()
    robot = config.robots[3]
    away = 2 * robot.vehicle.body_radius_m + gap_m
    found = refusals(platoon_of(parked(robot.start.x_m, round(robot.start.y_m - away, 4))))
    assert any("r4's wheels are tried before a start, so move p1 away from it" in text for _, text in found) == refused


def test_check_names_its_place_in_the_file(tmp_path: Path) -> None:
    text, robot = (
        PLATOON.read_text(),
        "  - {id: p1, tag: 9, vehicle: gternal, start: {x_m: -1.212, y_m: 0.7, heading_deg: 0}}",
    )
    file = tmp_path / "parked.yaml"
    file.write_text(text.replace("groups:", f"{robot}\ngroups:"))
    with pytest.raises(ConfigError) as refused:
        load_checked(file, lockstep=True)
    line = 1 + file.read_text().split("\n").index(robot)
    assert f"parked.yaml:{line}:47: robots.4.start: the distance of a robot that is not in the group" in str(
        refused.value
    )


@pytest.mark.slow
def test_nobody_hits_a_cart_that_is_pushed_into_a_platoon_s_way(platoon_of: Make) -> None:
    cart = "arena.moving=[{name: cart, tag: 40, radius_m: 0.12, start: {x_m: 0.0, y_m: 0.3, heading_deg: 0}}]"
    push = "faults=[{kind: pushed, robot: cart, velocity_m_s: [0.0, 0.05], at_s: 2.0, duration_s: 10.0}]"
    s = driven(platoon_of(cart, push, TRUTH, "run.duration_s=13"))
    assert s["bystanders"] == ["cart"]
    assert s["min_gap_mm"] >= GAP_MM
    assert s["filtered_fraction"] > 0.05, "they did come near"

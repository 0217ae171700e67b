"""A storm finds what is wrong with a gate or with a supervisor, and nothing where nothing is."""

import math
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.bus.messages import UNIT_TRUTH
from robofleet.config.load import load_config
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.runs.check import refusals
from robofleet.studies.engine import Local
from robofleet.studies.storm.bodies import apart, at_goals
from robofleet.studies.storm.episode import play
from robofleet.studies.storm.schedule import KINDS, WINDOW_S, plan
from robofleet.studies.storm.tally import SOME, Tally
from robofleet.studies.storm.tally import storm as played

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="module")
def fleet(platoon_of: Callable[..., Config]) -> Config:
    return platoon_of("tracker.source=truth")


def test_the_same_seed_plans_the_same_storm_and_another_seed_another_one(fleet: Config) -> None:
    assert plan(fleet, 7) == plan(fleet, 7)
    assert plan(fleet, 7) != plan(fleet, 8)


@pytest.mark.slow
def test_every_fault_heals_by_the_time_that_the_plan_names_and_every_kind_comes(fleet: Config) -> None:
    plans = [plan(fleet, seed) for seed in range(1, 81)]
    for storm in plans:
        ends = [fault.at_s + fault.duration_s for fault in storm.faults]
        assert max(ends) <= storm.healed_s <= WINDOW_S
    assert {fault.kind for storm in plans for fault in storm.faults} == set(KINDS)
    assert any(_overlap(storm.faults) for storm in plans)
    assert any(math.isinf(storm.outside_s) for storm in plans)
    assert any(not math.isinf(storm.outside_s) for storm in plans)


@pytest.mark.slow
def test_storms_park_robots_where_check_accepts_them_before_and_after_a_hand_pushed_them(fleet: Config) -> None:
    plans = [storm for seed in range(1, 41) if (storm := plan(fleet, seed)).parked]
    pushes = 0
    for storm in plans:
        for hand in (None, *(fault for fault in storm.faults if fault.kind == "pushed")):
            pushes += hand is not None
            robots = [_moved(robot, hand) for robot in storm.parked]
            assert refusals(fleet.model_copy(update={"robots": (*fleet.robots, *robots)}), lockstep=True) == []
    assert 0.2 < len(plans) / 40 < 0.6
    assert pushes > 3


def _moved(robot: Robot, hand: Any) -> Robot:
    if hand is None or hand.robot != robot.id:
        return robot
    x_m, y_m = (v * hand.duration_s for v in hand.velocity_m_s)
    start = robot.start.model_copy(update={"x_m": robot.start.x_m + x_m, "y_m": robot.start.y_m + y_m})
    return robot.model_copy(update={"start": start})


def test_a_robot_that_touches_a_bystander_is_found(fleet: Config) -> None:
    """A storm judges by where the bodies were; the summary, the barrier and the supervisor have no say."""
    robot = fleet.robots[0]
    start = robot.start.model_copy(update={"x_m": 1.0, "y_m": 0.0})
    parked = robot.model_copy(update={"id": "p1", "tag": 9, "start": start})
    config = fleet.model_copy(update={"robots": (parked, *fleet.robots)})
    times = np.array([1e9, 2e9])
    for gap, found in ((1e-4, []), (-1e-4, ["the body touches p1's"])):
        truths = []
        for row in range(5):
            at = np.zeros(2, dtype=UNIT_TRUTH.item_dtype)
            at["x_m"] = 1.0 if row == 4 else 0.3 * row - 0.6
            truths.append(at)
        truths[2]["x_m"] = 1.0 - 2 * robot.vehicle.body_radius_m - gap
        truths[3]["y_m"] = 0.5
        assert [violation.invariant for violation in apart(config, [times] * 5, truths, 3e9)] == found


def _overlap(faults: Iterable[Any]) -> bool:
    times = sorted((fault.at_s, fault.at_s + fault.duration_s) for fault in faults)
    return any(later[0] < earlier[1] for earlier, later in pairwise(times))


@pytest.mark.slow
def test_two_storms_leave_every_invariant_standing(fleet: Config) -> None:
    tally = played(fleet, range(1, 3), Local(1), lambda _tally, _episode: None)
    assert [(e.seed, *e.violations[:2]) for e in tally.failed] == []
    assert list(tally.shortfalls()) == []
    assert tally.seeds == 2


@pytest.mark.slow
def test_a_storm_that_never_brought_what_it_planned_proves_too_little(fleet: Config) -> None:
    tally = Tally()
    done = play(fleet, 1)
    tally.add(done)
    assert list(tally.shortfalls()) == []
    tally.injected.clear()
    kinds = {fault.kind for fault in done.plan.faults}
    tally.scheduled = Counter(kinds)
    assert list(tally.shortfalls()) == [], "one may come while the fleet stands"
    tally.scheduled = Counter(dict.fromkeys(kinds, SOME))
    assert {line.split()[0] for line in tally.shortfalls()} == kinds


@pytest.mark.parametrize(
    ("off_m", "off_deg", "is_free"), [(0.0, 0.0, True), (0.0039, 1.7, True), (0.0041, 0.0, False), (0.0, 2.0, False)]
)
@pytest.mark.parametrize("assignment", ["labelled", "nearest"])
def test_a_robot_is_at_its_goal_by_where_it_truly_is(
    off_m: float, off_deg: float, is_free: bool, assignment: str
) -> None:
    """A robot that has arrived need not turn again, and one that is elsewhere must."""
    config = load_config(CONFIGS / "go-to.yaml", [f"groups.0.settings.assignment={assignment}"])
    goal = config.groups[0].settings["goals"]["r1"]
    psi = math.radians(goal["heading_deg"] + off_deg)
    poses = {"r1": (goal["x_m"] + off_m, goal["y_m"], psi), "r2": (0.0, 0.0, 0.0)}
    assert at_goals(config, poses) == ({"r1"} if is_free else set())
    elsewhere = {"r2": poses["r1"]}
    assert at_goals(config, elsewhere) == ({"r2"} if is_free and assignment == "nearest" else set())


@pytest.mark.long
@pytest.mark.parametrize("name", ["script", "teleop", "ros2"])
def test_groups_that_somebody_else_drives_run_again_after_a_storm(name: str) -> None:
    config = load_config(CONFIGS / f"{name}.yaml", ["tracker.source=truth"])
    assert play(config, 50000).violations == ()


@pytest.mark.long
def test_a_fleet_that_stopped_beside_an_obstacle_starts_again() -> None:
    config = load_config(CONFIGS / "obstacles.yaml", ["tracker.source=truth"])
    assert play(config, 50029).violations == ()


@pytest.mark.long
def test_a_robot_that_lets_others_by_is_not_dead() -> None:
    config = load_config(CONFIGS / "go-to.yaml", ["tracker.source=truth"])
    assert play(config, 50032).violations == ()

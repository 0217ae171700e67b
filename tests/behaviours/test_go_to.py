"""go_to: robots come to their poses in spite of what happens, and what cannot be is refused."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robofleet.behaviours.go_to import GoTo
from robofleet.behaviours.interface import Past, Situation, Team
from robofleet.config import groups
from robofleet.safety.supervisor import Event
from robofleet.vehicles.differential_drive import arc, body_from_wheels, feasible_ratio, wheels_from_body
from tools.measure.behaviours.go_to_trials import configuration, go, places

Array = np.ndarray
Poses = list[tuple[float, float, float]]

NOBODY = np.zeros((0, 3))


def team(n: int) -> Team:
    config = configuration(n)
    return replace(groups.team(config, config.groups[0]), rng=np.random.default_rng(0))


def made(goals: Poses, group: Team | None = None, **more: Any) -> GoTo:
    named = {f"r{k}": {"x_m": x, "y_m": y, "heading_deg": math.degrees(psi)} for k, (x, y, psi) in enumerate(goals, 1)}
    return GoTo(GoTo.Settings.model_validate({"goals": named, **more}), group or team(len(goals)))


class Floor:
    """Robots that do at once what they are asked for."""

    def __init__(self, behaviour: GoTo, starts: Poses) -> None:
        self.behaviour, self.poses = behaviour, np.array(starts)
        self.driving, self.others, self.t = np.ones(len(starts), dtype=np.bool_), NOBODY, 0.0
        self.figures: Mapping[str, Any] = {}
        self.holds: list[float] = []  # when the run was to be held
        self.references: Array | None = None  # points of the virtual robots
        self.starts_rad_s = 0.0  # a wheel stands that is asked for less

    def tick(self) -> None:
        team, n = self.behaviour.team, len(self.poses)
        now = Situation(
            t=self.t, poses=self.poses.copy(), driving=self.driving, disturbance=np.zeros((n, 2)), others=self.others
        )
        decision = self.behaviour.decide(now)
        assert decision.of == "body"
        assert np.isfinite(decision.velocities).all()
        if decision.hold is not None:
            assert decision.hold is Event.BEHAVIOUR_NO_WAY
            self.holds.append(self.t)
        u = np.zeros((n, 2))
        for i, velocity in enumerate(decision.velocities.tolist()):
            d, psi = team.drives[i], float(self.poses[i, 2])
            wheels = wheels_from_body(*velocity, d.wheel_radius, d.wheel_base)
            ratio = feasible_ratio(*wheels, d.wheel_radius, d.max_wheel_speed, d.max_speed) * self.driving[i]
            turning = [ratio * wheel if abs(ratio * wheel) >= self.starts_rad_s else 0.0 for wheel in wheels]
            v, omega = body_from_wheels(*turning, d.wheel_radius, d.wheel_base)
            c, s = math.cos(psi), math.sin(psi)
            u[i] = c * v - s * team.point_ahead * omega, s * v + c * team.point_ahead * omega
            self.poses[i] = arc(*self.poses[i].tolist(), v, omega, team.tick)
        self.behaviour.changed(u)
        self.references = decision.references
        self.figures, self.t = decision.figures, self.t + team.tick

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def until(self, seconds: float) -> bool:
        """Go on until all have arrived; False if they have not after so long."""
        end = self.t + seconds
        while self.t < end and not self.behaviour.arrived:
            self.tick()
        return self.behaviour.arrived

    def gap(self) -> float:
        pairs = np.triu_indices(len(self.poses), 1)
        return float(np.linalg.norm(self.poses[pairs[0], :2] - self.poses[pairs[1], :2], axis=1).min())


CROSSING: Poses = [(-0.6, 0.0, 0.0), (0.6, 0.0, math.pi), (0.0, -0.6, 1.0)]
OPPOSITE: Poses = [(0.6, 0.0, 2.0), (-0.6, 0.0, -1.0), (0.0, 0.6, math.pi)]


def test_robots_that_cross_arrive_and_keep_apart() -> None:
    floor = Floor(made(OPPOSITE), CROSSING)
    gaps = []
    while not floor.behaviour.arrived and floor.t < 30.0:
        floor.tick()
        gaps.append(floor.gap())
    assert floor.behaviour.arrived
    assert np.abs((floor.poses - OPPOSITE)[:, :2]).max() < 0.003
    assert np.abs(np.sin(floor.poses - OPPOSITE)[:, 2]).max() < math.radians(1.5)
    assert np.max(floor.figures["distance_to_goal"]) < 0.004
    assert min(gaps) > 0.15


def test_who_is_there_stays_there() -> None:
    floor = Floor(made(CROSSING), CROSSING)
    assert floor.until(3.0)
    assert np.array_equal(floor.poses, CROSSING)


@pytest.mark.parametrize("seed", [2, 6])
def test_a_robot_that_comes_to_rest_elsewhere_than_its_model_is_corrected(seed: int) -> None:
    """Its motors are half as quick as believed: so it coasts further."""
    config, rng = configuration(1, "robots.0.vehicle.simulated.motor_lag_s=0.16"), np.random.default_rng(seed)
    came = go(config, places(config, 1, rng), places(config, 1, rng), seed, 30.0)
    assert came.arrived
    assert came.position < 0.0025, "2 mm, and what the camera does not see"
    assert came.heading < math.radians(1.2), "0.9 degrees, and as much"


def test_who_cannot_be_as_accurate_as_it_should_is_left_where_it_is_after_a_while_and_named() -> None:
    floor = Floor(made([(0.6, 0.0, 1.0)], heading_accuracy_deg=0.3, slowest_wheel_rad_s=2.0), [(-0.2, 0.0, 0.0)])
    figures = []
    while not floor.behaviour.arrived and floor.t < 25.0:
        floor.tick()
        figures.append([floor.figures[figure.name] for figure in GoTo.figures])
    assert floor.behaviour.arrived
    past = recorded(figures)
    off = floor.behaviour.summary(past)["not_at_goal"]["r1"]
    assert 0.3 < off["heading_error_deg"] < 0.6
    assert off["distance_to_goal_mm"] < 2.0


def test_nobody_is_named_where_all_are_at_their_goals() -> None:
    at_goal = recorded([[(0.001, 0.0019), (0.01, 0.0), (0.0, 0.0)]] * 20)
    assert made(CROSSING[:2]).summary(at_goal)["not_at_goal"] == {}
    assert made(CROSSING[:2]).summary(recorded([[(np.nan,) * 2] * 3] * 20))["not_at_goal"] is None


def recorded(figures: Sequence[Any]) -> Past:
    """Return what became of a group of which nothing but its figures, (K, 3, N), is known."""
    columns = np.array(figures, dtype=np.float64)
    ticks, robots = len(columns), columns.shape[2]
    nowhere, known = np.full((ticks, robots, 3), np.nan), np.zeros(robots, dtype=np.bool_)
    values = {figure.name: columns[:, k] for k, figure in enumerate(GoTo.figures)}
    counts = np.ones(ticks, dtype=np.bool_)
    return Past(
        t=np.arange(ticks) * 0.033, poses=nowhere, points=nowhere[..., :2], known=known, settled=counts, spaced=counts,
        references=nowhere[..., :2], figures=values,
    )  # fmt: skip


def test_a_robot_that_stands_is_waited_for_and_then_all_arrive() -> None:
    floor = Floor(made(OPPOSITE), CROSSING)
    floor.ticks(60)
    floor.driving[0] = False
    stood = floor.poses[0].copy()
    assert not floor.until(15.0)
    assert np.array_equal(floor.poses[0], stood)
    assert floor.gap() > 0.15
    floor.driving[0] = True
    assert floor.until(30.0)


@pytest.mark.slow_after_first
@pytest.mark.parametrize(  # the last: its point is there
    ("along", "beside", "turned"), [(0.013, 0.0, 0.0), (0.0, 0.013, 0.0), (-0.008, -0.01, -0.14), (0.002, -0.016, 0.2)]
)
def test_a_robot_that_is_not_quite_where_it_waits_comes_there_though_its_wheels_stick(
    along: float, beside: float, turned: float
) -> None:
    """Else it would count as late, and who waits for it would wait until there is another plan."""
    floor = Floor(made(OPPOSITE), CROSSING)
    floor.starts_rad_s = 0.7
    floor.driving[0] = False
    floor.ticks(300)
    waiting = floor.poses[1].copy()
    floor.tick()
    assert np.array_equal(floor.poses[1], waiting)
    assert floor.references is not None
    psi = float(waiting[2])
    c, s = math.cos(psi), math.sin(psi)
    x, y = floor.references[1] - floor.behaviour.team.point_ahead * np.array([c, s])
    floor.poses[1] = x + c * along - s * beside, y + s * along + c * beside, psi + turned
    floor.ticks(150)
    assert math.dist(floor.poses[1, :2], (x, y)) < 0.009
    stands = floor.poses[1].copy()
    floor.tick()
    assert np.array_equal(floor.poses[1], stands)
    floor.driving[0] = True
    assert floor.until(30.0)


@pytest.mark.parametrize("noticed", [True, False])
def test_a_robot_that_was_moved_gets_another_plan(noticed: bool) -> None:
    floor = Floor(made(OPPOSITE), CROSSING)
    floor.ticks(100)
    if noticed:
        floor.poses[0] = -1.2, 0.7, 1.0
        floor.behaviour.carried(0)
    else:
        floor.poses[1, :2] += 0.0, 0.3
    assert floor.until(40.0)


def test_around_what_came_to_stand_in_the_way_another_way_is_found() -> None:
    floor = Floor(made([(0.8, 0.0, 0.0)]), [(-0.8, 0.0, 0.0)])
    floor.ticks(45)
    obstacle = np.array([0.3, 0.0])
    floor.others = np.array([(*obstacle, 0.055)])
    gaps = []
    while not floor.behaviour.arrived and floor.t < 40.0:
        floor.tick()
        gaps.append(float(np.hypot(*(floor.poses[0, :2] - obstacle))))
    assert floor.behaviour.arrived
    assert min(gaps) > 0.16


def test_where_there_is_no_way_robots_stand_until_there_is_one() -> None:
    floor = Floor(made([(0.8, 0.0, 0.0)]), [(-0.8, 0.0, 0.0)])
    wall = np.array([(0.3, y, 0.055) for y in np.arange(-1.0, 1.01, 0.15)])
    floor.others = wall
    assert not floor.until(4.0)
    assert floor.poses[0, 0] == -0.8
    assert not floor.holds
    assert not floor.until(24.0)
    assert len(floor.holds) == 2, "where no way is found for long the run is held, and again after it was resumed"
    floor.others = NOBODY
    assert floor.until(30.0)


def test_nearest_goals_are_shared_out() -> None:
    """Labelled, both would have to cross the arena."""
    floor = Floor(
        made([(0.6, 0.1, 0.0), (-0.6, 0.1, 0.0)], assignment="nearest"), [(-0.6, -0.1, 0.0), (0.6, -0.1, 0.0)]
    )
    assert floor.until(10.0)
    assert floor.poses[:, 0] == pytest.approx([-0.6, 0.6], abs=0.004)


def test_the_same_seed_decides_the_same_to_the_bit() -> None:
    ends = []
    for _ in range(2):
        floor = Floor(made(OPPOSITE, replace(team(3), rng=np.random.default_rng(5))), CROSSING)
        floor.until(30.0)
        ends.append(floor.poses)
    assert np.array_equal(*ends)


def test_a_restart_begins_from_where_robots_stand() -> None:
    floor = Floor(made(OPPOSITE), CROSSING)
    assert floor.until(30.0)
    floor.behaviour.restart()
    assert not floor.behaviour.arrived
    floor.poses[:] = CROSSING
    assert floor.until(30.0)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("seed", [1, 2])
def test_with_the_plants_errors_and_the_barrier_all_arrive(seed: int) -> None:
    """Two goals are 1.3 body diameters apart, the robots face each other, and one of them passes the other's start."""
    starts = np.array([(-0.8, 0.0, 0.0), (-0.657, 0.0, math.pi), (0.8, 0.1, 2.0)])
    goals = np.array([(0.5, 0.0, 0.0), (0.643, 0.0, math.pi), (-0.9, 0.0, 0.0)])
    found = go(configuration(3), starts, goals, seed, 60.0)
    assert found.arrived, found
    assert found.gap >= 0.01


def broken(behaviour: GoTo) -> list[str]:
    return [bound.path for bound in behaviour.bounds() if not bound.holds]


@pytest.mark.parametrize(
    ("goals", "robots", "more", "key", "words"),
    [
        (OPPOSITE, 2, {}, "settings.goals.r3", "r1, r2"),
        (OPPOSITE[:2], 3, {}, "settings.goals", "r3"),
        (OPPOSITE[:2], 3, {"assignment": "nearest"}, "settings.goals", "as many goals as the group has robots"),
    ],
)
def test_goals_and_robots_belong_together(goals: Poses, robots: int, more: Any, key: str, words: str) -> None:
    assert not list(made(OPPOSITE, **more).refusals())
    ((found, message),) = made(goals, team(robots), **more).refusals()
    assert found == key and words in message


def test_goals_outside_the_arena_and_too_near_each_other_are_refused() -> None:
    assert not broken(made(OPPOSITE))
    assert broken(made([(1.56, 0.0, 0.0), (0.0, 0.0, 0.0)])) == ["settings.goals.r1"]
    assert broken(made([(0.5, 0.0, 0.0), (0.5 + 0.143, 0.0, math.pi)])) == []  # 1.3 diameters
    assert broken(made([(0.5, 0.0, 0.0), (0.5 + 0.125, 0.0, math.pi)])) == ["settings.goals.r2"]
    assert broken(made(OPPOSITE, speed_m_s=0.3)) == ["settings.speed_m_s"] * 3

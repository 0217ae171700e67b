"""Joint plans: from every start to every goal, clear at every step, and waiting that never runs in a circle."""

import itertools
from collections.abc import Generator

import numpy as np
import pytest

from robofleet.control import planning, precedence
from robofleet.control.planning import Problem
from robofleet.control.precedence import Plan
from robofleet.vehicles.solids import Solid, distances

Array = np.ndarray

HALF, DISTANCE, CELL = (1.52, 0.92), 0.19, 0.05
NOTHING = np.zeros((0, 3))


def result(work: Generator[None, None, Plan | None]) -> Plan | None:
    while True:
        try:
            next(work)
        except StopIteration as done:
            found: Plan | None = done.value
            return found


def drawn(rng: np.random.Generator, count: int, apart: float = 0.143) -> Array:
    found: list[Array] = []
    while len(found) < count:
        at = rng.uniform((-1.52, -0.92), (1.52, 0.92))
        if all(np.hypot(*(at - other)) >= apart for other in found):
            found.append(at)
    return np.array(found)


def random_problem(seed: int, n: int) -> Problem:
    rng = np.random.default_rng(seed)
    return Problem(drawn(rng, n), drawn(rng, n), NOTHING, HALF, DISTANCE, CELL)


def made(problem: Problem, seed: int = 0) -> Plan:
    found = result(precedence.plan(problem, np.random.default_rng(seed)))
    assert found is not None
    return found


def least_clearance(problem: Problem, places: Array, others: Array) -> float:
    """Return the least of |x - y| - rho_i(x) - rho_j(y) over steps, of robots at ``places`` and ``others`` [m]."""
    rho = planning.clearance(problem)
    least = np.inf
    for i, j in itertools.permutations(range(len(places)), 2):
        for x, y in zip(places[i], others[j], strict=True):
            kept = planning.rho(*x, rho.places[i], rho.radii[i], rho.most)
            kept += planning.rho(*y, rho.places[j], rho.radii[j], rho.most)
            least = min(least, float(np.hypot(*(x - y))) - kept)
    return least


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("seed", "n"), [(1, 4), (2, 10), (3, 20), (4, 20)])
def test_a_plan_leads_from_the_starts_to_the_goals_and_robots_are_clear(seed: int, n: int) -> None:
    problem = random_problem(seed, n)
    plan = made(problem)
    assert np.array_equal(plan.places[:, 0], problem.starts)
    assert np.array_equal(plan.places[:, -1], problem.goals)
    assert least_clearance(problem, plan.places, plan.places) >= -1e-6
    assert least_clearance(problem, plan.places[:, 1:], plan.places[:, :-1]) >= -1e-6  # where others were before


def test_under_way_robots_keep_their_distance() -> None:
    starts = np.array([(-1.0, 0.0), (1.0, 0.0)])
    plan = made(Problem(starts, starts[::-1].copy(), NOTHING, HALF, DISTANCE, CELL))
    gaps = np.linalg.norm(plan.places[0] - plan.places[1], axis=1)
    assert gaps.min() >= DISTANCE - 1e-6
    assert plan.length[:, -1].max() < 2.15  # two ways of 2 m that pass each other


def test_the_same_seed_gives_the_same_plan() -> None:
    problem = random_problem(5, 10)
    assert np.array_equal(made(problem, 7).places, made(problem, 7).places)


def test_a_robot_at_its_goal_makes_room_for_who_must_pass() -> None:
    """In a corridor that two fit beside each other only just."""
    starts, goals = np.array([(-1.0, 0.0), (0.0, 0.0)]), np.array([(1.0, 0.0), (0.0, 0.0)])
    plan = made(Problem(starts, goals, NOTHING, (1.2, 0.12), DISTANCE, CELL))
    assert np.array_equal(plan.places[:, -1], goals)
    assert plan.length[1, -1] > 0.1


def test_ways_lead_around_obstacles() -> None:
    obstacle = np.array([(0.0, 0.0, 0.4)])
    starts, goals = np.array([(-1.0, 0.0)]), np.array([(1.0, 0.0)])
    plan = made(Problem(starts, goals, obstacle, HALF, DISTANCE, CELL))
    assert np.linalg.norm(plan.places[0], axis=1).min() >= 0.4 - 1e-9


def test_where_no_way_leads_to_a_goal_there_is_no_plan() -> None:
    wall = np.array([(0.0, y, 0.15) for y in np.arange(-1.0, 1.01, 0.1)])
    problem = Problem(np.array([(-1.0, 0.0)]), np.array([(1.0, 0.0)]), wall, HALF, DISTANCE, CELL)
    assert result(precedence.plan(problem, np.random.default_rng(0))) is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_executed_in_any_order_nobody_waits_for_ever_and_all_stay_clear(seed: int) -> None:
    """Robots go on one step at a time, whoever is drawn; what a robot waits for is all that holds it."""
    problem, rng = random_problem(seed, 10), np.random.default_rng(seed)
    plan = made(problem)
    rho, last = planning.clearance(problem), plan.places.shape[1] - 1
    step = np.zeros(10, dtype=np.int64)
    while (step < last).any():
        may = [i for i in range(10) if step[i] < last and (step >= plan.needed[i, step[i] + 1]).all()]
        assert may, "nobody may go on"
        i = int(rng.choice(may[: 1 + int(rng.integers(len(may)))]))  # the first ones run far ahead
        step[i] += 1
        at = plan.places[np.arange(10), step]
        for j in range(10):
            if j != i:
                kept = planning.rho(*at[i], rho.places[i], rho.radii[i], rho.most)
                kept += planning.rho(*at[j], rho.places[j], rho.radii[j], rho.most)
                assert np.hypot(*(at[i] - at[j])) >= kept - 1e-3


def test_a_robot_that_stands_is_waited_for_by_who_must_pass_behind_it() -> None:
    """The second robot drives to where the first stands."""
    starts, goals = np.array([(0.0, 0.0), (-1.0, 0.0)]), np.array([(1.0, 0.0), (0.0, 0.0)])
    plan = made(Problem(starts, goals, NOTHING, HALF, DISTANCE, CELL))
    assert plan.needed[1, -1, 0] > 0


def brute_force(distances: Array) -> tuple[float, float]:
    n = len(distances)
    return min(
        (max(float(distances[i, p[i]]) for i in range(n)), sum(float(distances[i, p[i]]) for i in range(n)))
        for p in itertools.permutations(range(n))
    )


@pytest.mark.parametrize("seed", range(20))
def test_goals_are_shared_out_with_the_longest_way_shortest_and_then_the_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    distances = rng.uniform(0.0, 2.0, (n, n)).round(seed % 3 + 1)  # with equal ones
    found = planning.assign(distances)
    assert sorted(found) == list(range(n))
    chosen = distances[np.arange(n), found]
    longest, total = brute_force(distances)
    assert (chosen.max(), chosen.sum()) == pytest.approx((longest, total))


BESIDE = 0.08
BOX = Solid("box", ((-0.2, -0.92), (0.2, -0.92), (0.2, 0.6), (-0.2, 0.6)))  # leaves a way at the top
PILLAR = Solid("pillar", ((0.7, 0.2),), 0.12)
NOTCH = Solid("notch", ((-1.2, -0.1), (-0.6, -0.1), (-0.6, 0.3), (-0.7, 0.3), (-0.7, 0.0), (-1.2, 0.0)))


@pytest.mark.parametrize("seed", range(4))
def test_a_plan_keeps_its_distance_from_solids_between_its_steps_too(seed: int) -> None:
    solids, rng = (BOX, PILLAR, NOTCH), np.random.default_rng(seed)
    starts, goals = (
        np.array([at for at in drawn(rng, 40, 0.2) if distances(solids, at[None]).min() > BESIDE][:6]) for _ in range(2)
    )
    plan = made(Problem(starts, goals, NOTHING, HALF, DISTANCE, CELL, solids, BESIDE), seed)
    between = np.linspace(plan.places[:, :-1], plan.places[:, 1:], 20).reshape(-1, 2)
    assert np.array_equal(plan.places[:, -1], goals)
    assert distances(solids, between).min() >= BESIDE - 0.0025


def test_a_goal_nearer_to_a_solid_is_come_to_and_the_rest_of_the_way_keeps_its_distance() -> None:
    starts, goals = np.array([(-0.8, 0.8)]), np.array([(0.7, 0.2 + 0.12 + 0.06)])
    plan = made(Problem(starts, goals, NOTHING, HALF, DISTANCE, CELL, (PILLAR,), BESIDE))
    between = np.linspace(plan.places[:, :-1], plan.places[:, 1:], 20).reshape(-1, 2)
    assert distances((PILLAR,), between).min() >= 0.06 - 0.0025
    assert distances((PILLAR,), between[np.linalg.norm(between - goals[0], axis=1) > 0.05]).min() >= BESIDE - 0.0025


def test_who_cannot_come_to_its_goal_is_named() -> None:
    cage = [(0.3, 0.3), (1.1, 0.3), (1.1, 0.8), (0.3, 0.8)]
    walls = tuple(
        Solid(f"wall{k}", ((*a,), (*b,), (b[0] + 0.01, b[1] + 0.01)))
        for k, (a, b) in enumerate(zip(cage, cage[1:] + cage[:1], strict=True))
    )
    starts, goals = np.array([(-1.0, 0.0), (-0.5, 0.5)]), np.array([(-0.5, -0.5), (0.7, 0.55)])
    problem = Problem(starts, goals, NOTHING, HALF, DISTANCE, CELL, walls, BESIDE)
    assert planning.unreachable(problem) == [1]
    assert result(precedence.plan(problem, np.random.default_rng(0))) is None
    assert planning.unreachable(Problem(starts, goals, NOTHING, HALF, DISTANCE, CELL, walls[:3], BESIDE)) == []

"""The barrier beside obstacles, and on a floor that is a polygon: nobody touches anything, whatever is asked for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.safety.barrier import Barrier
from robofleet.safety.distances import from_edge
from robofleet.vehicles.differential_drive import arc
from robofleet.vehicles.solids import Solid, distances
from tests.safety.barrier_scenes import BODY, GTERNAL, KEEPOUT, Array, body, feasible, stop_point, velocities

TICK, PARTS = KEEPOUT.tick, 3
FLOOR = Solid("floor", ((-1.5, -0.9), (1.5, -0.9), (1.5, 0.2), (0.3, 0.2), (0.3, 0.9), (-1.5, 0.9)), floor=True)
LAPSED = 1e-3  # of a distance within a tick, as a row holds at its beginning [m]


def drawn(rng: np.random.Generator) -> tuple[Solid, ...]:
    """Return a disc, a star that is not convex, a thin wall and a floor that is not convex."""
    angle = np.sort(rng.uniform(0.0, math.tau, 9))
    reach = rng.uniform(0.05, 0.25, 9)
    star = np.array([-0.8, 0.3]) + reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    x, y = rng.uniform((0.3, -0.6), (0.9, -0.4))
    c, s = math.cos(x * 40), math.sin(x * 40)
    wall = [(x + 0.3 * c - w * s, y + 0.3 * s + w * c) for w in (-0.005, 0.005)]
    wall += [(x - 0.3 * c - w * s, y - 0.3 * s + w * c) for w in (0.005, -0.005)]
    disc = Solid("disc", (tuple(rng.uniform((-0.6, -0.6), (-0.2, -0.3)).tolist()),), float(rng.uniform(0.02, 0.2)))
    return disc, Solid("star", tuple(map(tuple, star.tolist()))), Solid("wall", tuple(wall)), FLOOR


def left(solids: tuple[Solid, ...], points: Array) -> Array:
    """Return what each point has left of what is kept from each solid (R, M) [m]."""
    kept = np.array([from_edge(KEEPOUT, BODY) for solid in solids])
    return distances(solids, points) - kept[:, None]


def after(pose: Array, turning: Array, wheels: Array, seconds: float) -> tuple[Array, Array]:
    """Return pose and wheels' speeds after a command, whose lag is of first order."""
    steps = 8
    for _ in range(steps):
        share = math.exp(-seconds / steps / GTERNAL.motor_lag)
        mean = wheels + (turning - wheels) * (1 - share) / (seconds / steps / GTERNAL.motor_lag)
        pose = np.array(arc(*pose.tolist(), *body(mean), seconds / steps))
        turning = wheels + (turning - wheels) * share
    return pose, turning


@pytest.mark.slow_after_first
@pytest.mark.parametrize("seed", range(12))
def test_nobody_comes_nearer_than_is_kept_whatever_is_asked_for(seed):
    rng = np.random.default_rng(seed)
    solids = drawn(rng)
    barrier, n = Barrier(replace(KEEPOUT, solids=solids), (BODY,) * 3), 3
    poses = np.empty((n, 3))
    for i, low in enumerate(((-1.4, -0.8), (-0.4, -0.1), (0.1, -0.8))):  # far from each other
        while True:
            at = rng.uniform(low, np.array(low) + 0.4)
            poses[i] = *at, rng.uniform(-math.pi, math.pi)
            if left(solids, stop_point(poses[i], np.zeros(2))[None]).min() > 0.0:
                break
    turning, setpoints = np.zeros((n, 2)), np.zeros((n, 2))
    for k in range(200):
        if k % 15 == 0:
            setpoints = np.array([feasible(row) for row in rng.uniform(-14.0, 14.0, (n, 2)) + rng.choice([-8, 8])])
        everybody = np.ones(n, np.bool_)
        wheels = barrier.filter(poses, turning, np.zeros(n), everybody, setpoints, velocities(poses, setpoints)).wheels
        for i in range(n):
            for _ in range(PARTS):
                poses[i], turning[i] = after(poses[i], turning[i], wheels[i], TICK / PARTS)
            q = stop_point(poses[i], turning[i])
            assert left(solids, q[None]).min() > -LAPSED
            gaps = distances(solids, poses[i : i + 1, :2])[:, 0] - BODY.radius
            assert gaps[:3].min() >= KEEPOUT.gap and gaps[3] >= 0.0


def test_a_robot_that_is_too_near_withdraws_from_an_obstacle():
    solid = Solid("box", ((0.0, -0.2), (0.3, -0.2), (0.3, 0.2), (0.0, 0.2)))
    barrier = Barrier(replace(KEEPOUT, solids=(solid,)), (BODY,))
    pose = np.array([(-BODY.radius - 0.005, 0.0, 0.0)])
    wheels = np.array([(5.0, 5.0)])
    got = barrier.filter(pose, np.zeros((1, 2)), np.zeros(1), np.ones(1, np.bool_), wheels, velocities(pose, wheels))
    assert body(got.wheels[0])[0] < -0.01


@pytest.mark.parametrize("speed", [5.0, 12.0])
def test_along_a_wall_a_robot_is_not_slowed(speed):
    """Also past the corners between walls that are one straight line."""
    wall = Solid("wall", ((1.0, 0.0), (0.5, 0.0), (0.0, 0.0), (-1.0, 0.0), (-1.0, -0.1), (1.0, -0.1)))
    kept = from_edge(KEEPOUT, BODY)
    for x in np.linspace(-0.9, 0.9, 19):
        barrier = Barrier(replace(KEEPOUT, solids=(wall,)), (BODY,))
        pose, wheels = np.array([(x, kept + 1e-4, 0.0)]), np.array([feasible(np.array((speed, speed)))])
        got = barrier.filter(pose, wheels, np.zeros(1), np.ones(1, np.bool_), wheels, velocities(pose, wheels))
        assert got.wheels == pytest.approx(wheels)


def test_solids_far_away_change_nothing():
    far = Solid("far", ((1.2, 0.7), (1.4, 0.7), (1.4, 0.9), (1.2, 0.9)))
    rng = np.random.default_rng(3)
    for _ in range(50):
        pose = np.array([(*rng.uniform((-1.4, -0.8), (0.6, 0.4)), rng.uniform(-3, 3))])
        turning, wheels = (np.array([feasible(rng.uniform(-14, 14, 2))]) for _ in range(2))
        answers = []
        for solids in ((), (far,)):
            barrier, u = Barrier(replace(KEEPOUT, solids=solids), (BODY,)), velocities(pose, wheels)
            answers.append(barrier.filter(pose, turning, np.zeros(1), np.ones(1, np.bool_), wheels, u).wheels)
        assert (answers[0] == answers[1]).all()


def test_a_rectangular_floor_is_kept_as_the_arena_s_edge_is():
    rectangle = Solid("floor", ((-1.6, -1.0), (1.6, -1.0), (1.6, 1.0), (-1.6, 1.0)), floor=True)
    rng = np.random.default_rng(5)
    for _ in range(100):
        at = rng.uniform(0.85, 0.9) * np.array([1.0, rng.uniform(-1, 1)]) * (1.6, 1.0)
        pose = np.array([(*at, rng.uniform(-3, 3))])
        turning, wheels = (np.array([feasible(rng.uniform(-14, 14, 2))]) for _ in range(2))
        answers = []
        for keepout in (KEEPOUT, replace(KEEPOUT, arena=(99.0, 99.0), solids=(rectangle,))):
            barrier, u = Barrier(keepout, (BODY,)), velocities(pose, wheels)
            answers.append(barrier.filter(pose, turning, np.zeros(1), np.ones(1, np.bool_), wheels, u).wheels)
        assert answers[0] == pytest.approx(answers[1], abs=1e-9)

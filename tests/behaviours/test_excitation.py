"""The calibrating drive: it does what is asked of it, near others and near the edge, and touches nothing."""

import math
from itertools import combinations

import numpy as np
import pytest

from robofleet.testing.behaviours import ARENA, TICK
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.behaviours.excited import RADIUS, Excited
from tests.robots import GTERNAL

# as configs/platoon.yaml has them: the nearest two are 0.19 m apart
PLATOON = [(-1.212, 0.5, 0.93), (-1.382, 0.254, 0.7), (-1.478, 0.091, 1.4), (-1.408, -0.23, 1.82)]

Pose = tuple[float, float, float]


class Floor:
    """Robots that do as they are told, with a motor lag, and everything that became of it."""

    def __init__(self, poses: list[Pose], seed: int = 1) -> None:
        self.drive = Excited(len(poses), seed)
        self.poses, self._wheels = list(poses), np.zeros((len(poses), 2))
        self.driving = np.ones(len(poses), dtype=np.bool_)
        self.track: list[list[Pose]] = []
        self.commands: list[np.ndarray] = []
        self.held: list[np.ndarray] = []

    def run(self, duration: float | None = None) -> None:
        for k in range(round((duration or float(self.drive.ends[-1]) + 1.0) / TICK)):
            commands, held = self.drive.tick(k * TICK, np.array(self.poses), self.driving)
            self.commands.append(commands)
            self.held.append(held)
            for _ in range(3):
                self._wheels += (commands - self._wheels) * -math.expm1(-TICK / 3 / GTERNAL.motor_lag)
                for row, (left, right) in enumerate(self._wheels.tolist()):
                    body = body_from_wheels(left, right, GTERNAL.wheel_radius, GTERNAL.wheel_base)
                    self.poses[row] = arc(*self.poses[row], *body, TICK / 3)
            self.track.append(list(self.poses))

    @property
    def gap(self) -> float:
        """Smallest distance between two bodies, or of one to the edge."""
        at = np.array(self.track)[..., :2]
        edge = (np.array(ARENA) / 2 - np.abs(at)).min() - RADIUS
        pairs = combinations(range(at.shape[1]), 2)
        between = [np.linalg.norm(at[:, i] - at[:, j], axis=1).min() - 2 * RADIUS for i, j in pairs]
        return float(min([edge, *between]))


@pytest.fixture(scope="module")
def platoon() -> Floor:
    floor = Floor(PLATOON)
    floor.run()
    return floor


def test_robots_drive_one_after_the_other_and_rest_at_the_end(platoon: Floor) -> None:
    assert platoon.gap > 0.02, "nothing is touched"
    moving = (np.array(platoon.commands) != 0.0).any(axis=2)
    assert (moving.sum(axis=1) <= 1).all()
    ends = (platoon.drive.ends / TICK).astype(int)
    for row, (start, end) in enumerate(zip([0, *ends], ends, strict=False)):
        assert moving[start:end, row].mean() > 0.75
        assert not moving[end + 1 :, row].any()


def test_every_robot_spins_both_ways_and_drives_forth_and_back(platoon: Floor) -> None:
    track = np.array(platoon.track)
    for row in range(4):
        psi = np.unwrap(track[:, row, 2])
        turn = np.diff(psi)
        assert turn[turn > 0].sum() > 2 * math.pi
        assert -turn[turn < 0].sum() > 2 * math.pi
        way = np.diff(track[:, row, :2], axis=0)
        along = np.cos(psi[1:]) * way[:, 0] + np.sin(psi[1:]) * way[:, 1]
        straight = np.abs(turn) < 1e-4
        assert along[straight & (along > 0)].sum() > 0.1
        assert along[straight & (along < 0)].sum() < -0.1


def test_wheel_speeds_keep_their_limits_and_change_all_the_time(platoon: Floor) -> None:
    wheels = np.array(platoon.commands)
    assert np.abs(wheels).max() <= GTERNAL.max_wheel_speed
    assert GTERNAL.wheel_radius * np.abs(wheels.mean(axis=2)).max() <= GTERNAL.max_speed
    for row in range(4):
        for side in range(2):
            assert (np.diff(wheels[:, row, side]) != 0.0).sum() > 100


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_touched_anywhere(seed: int) -> None:
    """A crowd in a corner: robots a few centimetres apart, and at the edge."""
    rng = np.random.default_rng(seed)
    corner = np.array([1.6 - RADIUS - 0.031, 1.0 - RADIUS - 0.031])
    places = [corner - (a, b) for a in (0.0, 0.145) for b in (0.0, 0.145)]
    floor = Floor([(float(x), float(y), float(rng.uniform(-3, 3))) for x, y in places], seed)
    floor.run()
    assert floor.gap > 0.01


def test_a_robot_without_room_is_held_and_says_so() -> None:
    ring = [(0.0, 0.0, 0.3)] + [
        (0.135 * math.cos(a), 0.135 * math.sin(a), 0.0) for a in np.linspace(0.0, math.tau, 6, endpoint=False)
    ]
    floor = Floor(ring)
    floor.run(float(floor.drive.ends[0]))
    held = np.array(floor.held)
    assert held[:, 0].sum() * TICK > 3.0
    assert not held[:, 1:].any()
    assert floor.gap > 0.01
    free = Floor([(0.0, 0.0, 0.3)])
    free.run()
    assert not np.array(free.held).any()


@pytest.mark.parametrize("seed", range(2))
def test_random_motion_stays_in_its_place(seed: int) -> None:
    floor = Floor([(0.0, 0.0, 0.3)], seed)
    floor.run()
    random = np.array(floor.track)[-round(21.0 / TICK) :, 0, :2]
    away = np.linalg.norm(random - random[0], axis=1)
    assert 0.03 < away.max() < 0.12


def test_a_robot_that_is_lost_stands_still() -> None:
    floor = Floor(PLATOON)
    floor.driving[0] = False
    floor.run(10.0)
    assert not np.array(floor.commands).any()


@pytest.mark.slow
def test_the_same_seed_is_the_same_drive_and_a_restart_begins_anew() -> None:
    def wheels(floor: Floor) -> np.ndarray:
        floor.run(45.0)
        return np.array(floor.commands)

    first, again, other = (Floor(PLATOON, seed) for seed in (1, 1, 2))
    expected = wheels(first)
    assert np.array_equal(expected, wheels(again))
    assert not np.array_equal(expected, wheels(other))
    first.drive.restart()
    first.poses, first._wheels, first.commands = list(PLATOON), np.zeros((4, 2)), []
    assert np.array_equal(expected, wheels(first))

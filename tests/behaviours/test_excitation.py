"""The calibrating drive: it does what is asked of it, near others and near the edge, and touches nothing."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import pytest

from robofleet.behaviours.excitation import LONGEST_LINE_M, Excitation, Manoeuvre
from robofleet.testing import team
from robofleet.testing.behaviours import ARENA, TICK
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.behaviours.excited import RADIUS, Excited
from tests.robots import GTERNAL

# as configs/platoon.yaml has them: the nearest two are 0.19 m apart
PLATOON = [(-1.212, 0.5, 0.93), (-1.382, 0.254, 0.7), (-1.478, 0.091, 1.4), (-1.408, -0.23, 1.82)]

Pose = tuple[float, float, float]

RAMP = Manoeuvre(left_rad_s=-1.5, right_rad_s=1.5, duration_s=3.0, ramp=True)
STEPS = Manoeuvre(left_rad_s=3.0, right_rad_s=1.0, duration_s=0.2, times=3)
TOO_FAST = Manoeuvre(left_rad_s=30.0, right_rad_s=30.0, duration_s=0.1)


class Floor:
    """Robots that do as they are told, with a motor lag, and everything that became of it."""

    def __init__(self, poses: list[Pose], manoeuvres: Mapping[str, Sequence[Manoeuvre]] | None = None) -> None:
        self.drive = Excited(len(poses), manoeuvres or {})
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
        assert moving[start:end, row].mean() > 0.65
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
    floor = Floor([(float(x), float(y), float(rng.uniform(-3, 3))) for x, y in places])
    floor.run()
    assert floor.gap > 0.01


@pytest.mark.slow
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


def test_it_stays_where_it_was_but_for_its_free_line() -> None:
    floor = Floor([(0.0, 0.0, 0.3)])
    floor.run()
    away = np.linalg.norm(np.array(floor.track)[:, 0, :2], axis=1)
    assert 0.25 < away.max() < LONGEST_LINE_M + 0.03
    assert away[-1] < 0.03


def test_manoeuvres_are_driven_as_they_are_written() -> None:
    """There and back, a ramp up and down again, nothing faster than the robot."""
    floor = Floor([(0.0, 0.0, 0.3)], manoeuvres={"r1": [RAMP, STEPS, TOO_FAST]})
    floor.run()
    left, right = np.array(floor.commands)[:, 0].T
    assert floor.drive.ends[0] == pytest.approx(0.5 + (2 * 3.0 + 2 * 0.5) + (6 * 0.2 + 0.5) + (2 * 0.1 + 2 * 0.5))
    t = TICK * np.arange(len(left))
    ramp = (t > 0.5) & (t < 3.5)
    assert left[ramp] == pytest.approx(-right[ramp])
    assert right[ramp] == pytest.approx(1.5 * (1.0 - np.abs((t[ramp] - 2.0) / 1.5)), abs=1e-9)
    assert (right[(t > 4.1) & (t < 6.9)] < 0.0).all()
    signs = np.sign(left[(t > 7.5) & (t < 8.7)])
    assert np.abs(np.diff(signs)).sum() == 2 * 5
    fast = (t > 9.2) & (t < 10.4)
    assert np.abs(left[fast]).max() == pytest.approx(GTERNAL.max_speed / GTERNAL.wheel_radius)


def test_a_robot_that_is_lost_stands_still() -> None:
    floor = Floor(PLATOON)
    floor.driving[0] = False
    floor.run(10.0)
    assert not np.array(floor.commands).any()


@pytest.mark.slow
def test_a_restart_begins_anew() -> None:
    floor = Floor(PLATOON)
    floor.run(45.0)
    first = np.array(floor.commands)
    floor.drive.restart()
    floor.poses, floor._wheels, floor.commands = list(PLATOON), np.zeros((4, 2)), []
    floor.run(45.0)
    assert np.array_equal(first, np.array(floor.commands))


def test_the_free_line_is_what_others_and_the_edge_leave() -> None:
    def free_m(*starts: Pose) -> float:
        return Excitation(Excitation.Settings(), team(len(starts), starts)).free_line_m(0)

    assert free_m((0.0, 0.0, 0.0)) == pytest.approx(LONGEST_LINE_M, abs=0.021)
    ring = [(0.135 * math.cos(a), 0.135 * math.sin(a), 0.0) for a in np.linspace(0.0, math.tau, 6, endpoint=False)]
    assert free_m((0.0, 0.0, 0.0), *ring) == 0.0

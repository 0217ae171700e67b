"""Who is held by others turns aside after half a second, and is blocked after three."""

import math

import numpy as np
import pytest

from robofleet.safety.barrier import CHANGED, Barrier
from robofleet.safety.distances import Body, apart
from robofleet.vehicles.differential_drive import arc, wheels_from_body
from tests.robots import GTERNAL
from tests.safety.barrier_scenes import (
    KEEPOUT,
    L,
    Scene,
    answer,
    body,
    face_to_face,
    feasible,
    nearest,
    rows,
)

TICKS_3_S = 91
BODY = Body(GTERNAL, 0.055, 1e-6 - KEEPOUT.age - GTERNAL.motor_lag)  # next to nothing is believed at any speed
D = apart(KEEPOUT, BODY, BODY)


@pytest.mark.parametrize("bearing_deg", [0, 20, 40, 60, 75])
def test_who_turns_aside_keeps_its_rows_too(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    poses = np.array([(0.0, 0.0, 0.0), (D * math.cos(bearing), D * math.sin(bearing), 0.0)])
    s, barrier = Scene(poses, np.zeros((2, 2)), np.array([(8.0, 8.0), (0.0, 0.0)])), Barrier(KEEPOUT, (BODY,) * 2)
    r = rows(s, 0, D)
    for _ in range(40):
        got = answer(s, barrier)
        v, omega = body(got.wheels[0])
        assert got.change[0] == CHANGED
        assert (r.a @ (v, L * omega) <= r.b + 1e-5).all()


def test_two_robots_that_face_each_other_pass_on_the_right_after_half_a_second() -> None:
    s, barrier = face_to_face(D + 2 * KEEPOUT.ahead), Barrier(KEEPOUT, (BODY,) * 2)
    waiting = [body(answer(s, barrier).wheels[0])[1] for _ in range(TICKS_3_S)]
    assert waiting == pytest.approx([0.0] * TICKS_3_S, abs=1e-9), "who asks for little waits"
    s = s._replace(wheels=np.full((2, 2), 8.0))
    turns = [body(answer(s, barrier).wheels[0])[1] for _ in range(20)]
    first = next(k for k, omega in enumerate(turns) if omega < -0.1)
    assert first == 15
    assert turns[:first] == pytest.approx([0.0] * first, abs=1e-9)


def test_a_robot_that_is_held_for_three_seconds_is_blocked_until_it_gets_on() -> None:
    n = 7  # one in the middle of six
    ring = [(D * math.cos(k), D * math.sin(k), 0.0) for k in np.arange(6) * math.tau / 6]
    s = Scene(np.array([(0.0, 0.0, 0.0), *ring]), np.zeros((n, 2)), np.array([(8.0, 8.0)] + [(0.0, 0.0)] * 6))
    barrier = Barrier(KEEPOUT, (BODY,) * n)
    blocked = [bool(answer(s, barrier).blocked[0]) for _ in range(TICKS_3_S + 10)]
    assert blocked.index(True) == TICKS_3_S - 1
    assert all(blocked[TICKS_3_S - 1 :])
    free = s._replace(poses=s.poses * (5, 5, 1))
    for _ in range(TICKS_3_S + 10):
        got = answer(free, barrier)
    assert not got.blocked.any()


def blocked_way(wheels: tuple[float, float], left_m: float = 0.0) -> Scene:
    """Return a robot, and one ahead of it that leaves it so much."""
    poses = np.array([(0.0, 0.0, 0.0), (D + left_m, 0.0, 0.0)])
    return Scene(poses, np.zeros((2, 2)), np.array([wheels, (0.0, 0.0)]))


def ticks_until_it_turns(s: Scene, barrier: Barrier) -> int:
    straight = answer(s, barrier).wheels[0]
    return 1 + next(k for k in range(99) if np.abs(answer(s, barrier).wheels[0] - straight).max() > 0.1)


@pytest.mark.parametrize("wheels", [(8.0, 8.0), (7.0, 9.5), (9.5, 7.0)])
def test_held_for_half_a_second_it_asks_for_the_same_speed_eighty_degrees_to_the_right(
    wheels: tuple[float, float],
) -> None:
    s, barrier = blocked_way(wheels), Barrier(KEEPOUT, (BODY,) * 2)
    v, omega = body(s.wheels[0])
    z, right = np.array([v, L * omega]), math.radians(80.0)
    aside = np.array([[math.cos(right), math.sin(right)], [-math.sin(right), math.cos(right)]]) @ z
    for wish in [z] * 15 + [aside] * 5:
        expected = nearest(rows(s, 0, D), wish)
        assert expected is not None
        got_v, got_omega = body(answer(s, barrier).wheels[0])
        assert (got_v, L * got_omega) == pytest.approx(expected.tolist(), abs=2e-4)


def test_time_that_it_was_not_held_counts_against_time_that_it_was() -> None:
    held, free = blocked_way((8.0, 8.0)), blocked_way((8.0, 8.0), 1.0)
    for free_ticks, more in ((0, 5), (3, 8), (10, 15), (30, 15)):
        barrier = Barrier(KEEPOUT, (BODY,) * 2)
        for s in [held] * 10 + [free] * free_ticks:
            answer(s, barrier)
        assert ticks_until_it_turns(held, barrier) == more


def test_who_did_not_drive_was_not_held() -> None:
    held, barrier = blocked_way((8.0, 8.0)), Barrier(KEEPOUT, (BODY,) * 2)
    for _ in range(10):
        answer(held, barrier)
    answer(held._replace(wheels=np.zeros((2, 2))), barrier, driving=np.zeros(2, dtype=np.bool_))
    assert ticks_until_it_turns(held, barrier) == 15


@pytest.mark.parametrize(("size", "turns"), [(0.105, True), (0.095, False)])
def test_who_asks_for_more_than_half_its_top_speed_is_held_turning_included(size: float, turns: bool) -> None:
    """A robot beside it keeps its point from where it asks to go: forwards and sideways."""
    towards = np.array([0.1, math.sqrt(0.99)])
    row = towards * (1.0, KEEPOUT.ahead / L)
    v, sideways = size * row / np.linalg.norm(row)
    wheels = wheels_from_body(v, sideways / L, GTERNAL.wheel_radius, GTERNAL.wheel_base)
    poses = np.array([(0.0, 0.0, 0.0), (*(D * towards), 0.0)])
    s, barrier = Scene(poses, np.zeros((2, 2)), np.array([wheels, (0.0, 0.0)])), Barrier(KEEPOUT, (BODY,) * 2)
    straight = answer(s, barrier).wheels[0]
    assert any(np.abs(answer(s, barrier).wheels[0] - straight).max() > 0.1 for _ in range(20)) is turns


def test_who_gets_half_of_what_it_asks_for_is_not_held() -> None:
    s, barrier = blocked_way((8.0, 8.0), 2 * 0.064 / KEEPOUT.rate), Barrier(KEEPOUT, (BODY,) * 2)
    for _ in range(TICKS_3_S + 5):
        got = answer(s, barrier)
        assert not got.blocked.any()
        assert body(got.wheels[0]) == pytest.approx((0.064, 0.0), abs=1e-6)


def test_whose_way_a_wall_of_standing_robots_bars_from_edge_to_edge_is_blocked() -> None:
    n = 13
    wall = [(0.5, y, 0.0) for y in np.linspace(-0.93, 0.93, n - 1)]
    poses = np.array([(0.2, 0.0, 0.0), *wall])
    wheels, barrier = np.zeros((n, 2)), Barrier(KEEPOUT, (BODY,) * n)
    turning = np.zeros((n, 2))
    flags: list[bool] = []
    for _ in range(round(60.0 / KEEPOUT.tick)):
        psi = poses[0, 2]
        v, omega = 0.15 * math.cos(psi), -0.15 * math.sin(psi) / L  # the point ahead is to go along x
        wheels[0] = feasible(np.array(wheels_from_body(v, omega, GTERNAL.wheel_radius, GTERNAL.wheel_base)))
        got = answer(Scene(poses, turning, wheels), barrier)
        flags.append(bool(got.blocked[0]))
        turning[0] = got.wheels[0]
        poses[0] = arc(*poses[0].tolist(), *body(got.wheels[0]), KEEPOUT.tick)
    assert any(flags)
    assert poses[0, 0] < 0.5


def test_two_that_press_each_other_and_both_wait_are_not_blocked() -> None:
    n = 7  # each of six in a ring presses the one in the middle, which presses one of them
    size = D + KEEPOUT.ahead
    ring = [(size * math.cos(k), size * math.sin(k), k + math.pi) for k in np.arange(6) * math.tau / 6]
    s = Scene(np.array([(-KEEPOUT.ahead, 0.0, 0.0), *ring]), np.zeros((n, 2)), np.full((n, 2), 8.0))
    barrier = Barrier(KEEPOUT, (BODY,) * n)
    for _ in range(3 * TICKS_3_S):
        s.poses[:, 1] += 0.002  # all drift together: nobody stalls
        assert not answer(s, barrier).blocked[0]

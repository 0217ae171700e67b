"""The barrier's command: safe by its own rows, nearest to what was asked, and no other where that was safe."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety.barrier import CHANGED, LEFT_ALONE, NO_ANSWER, Barrier, Filtered
from robofleet.safety.distances import Body, apart, apart_at_rest, from_edge
from robofleet.vehicles.differential_drive import DifferentialDrive
from tests.robots import GTERNAL
from tests.safety import barrier_scenes
from tests.safety.barrier_scenes import (
    BODY,
    KEEPOUT,
    D,
    L,
    Rows,
    Scene,
    answer,
    body,
    face_to_face,
    nearest,
    rows,
    scene,
    stop_point,
    velocities,
)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_the_answer_is_the_nearest_that_keeps_all_rows(seed: int) -> None:
    s = scene(seed)
    given_ = answer(s)
    for i in range(s.n):
        r, (v, omega) = rows(s, i), body(s.wheels[i])
        expected = nearest(r, np.array([v, L * omega]))
        if expected is None:  # it cannot withdraw from all: not nearer to any
            expected = nearest(Rows(r.a, np.maximum(r.b, 0.0)), np.array([v, L * omega]))
        assert expected is not None
        got_v, got_omega = body(given_.wheels[i])
        assert (got_v, L * got_omega) == pytest.approx(expected.tolist(), abs=2e-4)
        assert given_.change[i] in (LEFT_ALONE, CHANGED)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 10**6))
def test_what_is_safe_is_left_alone_to_the_bit(seed: int) -> None:
    s = scene(seed, reach=0.8)
    got = answer(s)
    untouched = got.change == LEFT_ALONE
    assert np.array_equal(got.wheels[untouched], s.wheels[untouched])
    assert np.array_equal(got.u[untouched], velocities(s.poses, s.wheels)[untouched])
    again = answer(s._replace(wheels=got.wheels))
    assert np.allclose(again.wheels, got.wheels, atol=1e-5)


def test_the_scenes_have_robots_of_both_kinds() -> None:
    counts = np.bincount(np.concatenate([answer(scene(seed)).change for seed in range(50)]), minlength=3)
    assert counts[LEFT_ALONE] > 40
    assert counts[CHANGED] > 40
    assert counts[NO_ANSWER] == 0


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 10**6))
def test_the_wheels_keep_their_limits_and_u_is_what_they_do(seed: int) -> None:
    s = scene(seed)
    got = answer(s)
    assert np.abs(got.wheels).max() <= GTERNAL.max_wheel_speed * (1 + 1e-6)
    assert max(abs(body(row)[0]) for row in got.wheels) <= GTERNAL.max_speed * (1 + 1e-6)
    assert got.u == pytest.approx(velocities(s.poses, got.wheels), abs=1e-9)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_a_mirrored_scene_has_the_mirrored_answer(seed: int) -> None:
    s = scene(seed)
    mirrored = Scene(s.poses * (1, -1, -1), s.turning[:, ::-1].copy(), s.wheels[:, ::-1].copy())
    assert answer(mirrored).wheels == pytest.approx(answer(s).wheels[:, ::-1], abs=1e-6)
    for left, right in ((0.0, 0.0), (6.0, 0.0)):
        expected = answer(s, asked(s.n, left, right)).wheels[:, ::-1]
        assert answer(mirrored, asked(s.n, right, left)).wheels == pytest.approx(expected, abs=1e-6)


def asked(n: int, left: float, right: float) -> Barrier:
    """Return a barrier whose robots were asked for nothing else for as long as it is believed [rad/s]."""
    barrier, apart_ = Barrier(KEEPOUT, (BODY,) * n), np.column_stack([np.linspace(-1.0, 1.0, n), np.zeros((n, 2))])
    for _ in range(10):
        answer(Scene(apart_, np.zeros((n, 2)), np.tile((left, right), (n, 1))), barrier)
    return barrier


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_a_robots_answer_needs_no_help_from_what_others_are_asked_for(seed: int) -> None:
    s = scene(seed)
    others = s.wheels.copy()
    others[1:] = 0.0
    assert np.array_equal(answer(s).wheels[0], answer(s._replace(wheels=others)).wheels[0])


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.integers(0, 10**6))
def test_asked_to_stand_at_a_safe_distance_it_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cell = D + 2 * (KEEPOUT.ahead + GTERNAL.max_speed * GTERNAL.motor_lag)
    cells = np.array([(k, m) for k in range(-4, 5) for m in range(-3, 4)]) * cell
    poses = np.column_stack([cells[rng.permutation(len(cells))[:5]], rng.uniform(-math.pi, math.pi, 5)])
    s = scene(seed)._replace(poses=poses)
    at = np.array([stop_point(pose, turning) for pose, turning in zip(s.poses, s.turning, strict=True)])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=-1)[np.triu_indices(s.n, 1)]
    assert gaps.min() > D
    assert (np.abs(at) < np.array(KEEPOUT.arena) / 2 - from_edge(KEEPOUT, BODY)).all()
    got = answer(s._replace(wheels=np.zeros((s.n, 2))))
    assert not got.wheels.any()
    assert not got.change.any()


def test_within_the_distance_a_robot_withdraws() -> None:
    got = answer(face_to_face(D + 2 * KEEPOUT.ahead - 0.01))
    assert (got.wheels < 0).all()
    v, _ = body(got.wheels[0])
    assert v == pytest.approx(-KEEPOUT.rate * 0.01 / 2, rel=1e-6)


def test_a_robot_between_two_that_are_too_near_goes_to_neither() -> None:
    s = face_to_face(D - 0.005, 3)
    got = answer(s)
    v, _ = body(got.wheels[1])
    assert got.change[1] == CHANGED
    assert v == pytest.approx(0.0, abs=1e-6)


def test_who_does_not_drive_stands_whatever_is_near() -> None:
    s = face_to_face(D - 0.03)
    got = answer(s._replace(wheels=np.zeros((2, 2))), driving=np.zeros(2, dtype=np.bool_))
    assert not got.wheels.any()
    assert not got.change.any()


def test_a_robot_that_is_not_seen_grows_until_it_must_stand_and_one_never_seen_is_nowhere() -> None:
    far = D + 2 * KEEPOUT.ahead + 2 * 0.08 / KEEPOUT.rate + 1e-6
    s = face_to_face(far)  # at 0.08 m/s each: just far enough
    ages = [0.0, KEEPOUT.age, 0.15, 0.2, 0.4, 5.0]
    speeds = [body(answer(s, unseen=np.array([0.0, age])).wheels[0])[0] for age in ages]
    expected = [0.08 - KEEPOUT.rate / 2 * 0.2 * max(0.0, age - KEEPOUT.age) for age in ages[:4]]
    assert speeds[:4] == pytest.approx(expected, abs=1e-5)
    assert speeds[4:] == pytest.approx([-0.1, -0.1])  # it withdraws
    wide = face_to_face(D + 2 * KEEPOUT.ahead + GTERNAL.max_speed * KEEPOUT.lost_after + 0.016 + 1e-6)
    assert body(answer(wide, unseen=np.array([0.0, 60.0])).wheels[0])[0] == pytest.approx(0.08)
    assert body(answer(s, unseen=np.array([0.0, math.inf])).wheels[0])[0] == pytest.approx(0.08)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("what", ["poses", "turning", "wheels"])
def test_what_is_not_a_number_makes_a_robot_stand(what: str, bad: float) -> None:
    s = face_to_face(0.5)
    array = getattr(s, what).copy()
    array[0, 0] = bad
    with np.errstate(invalid="ignore"):
        wheels, u = array if what == "wheels" else s.wheels, np.ones((2, 2))
        poses, turning = (array if name == what else getattr(s, name) for name in ("poses", "turning"))
        drive = np.ones(2, dtype=np.bool_)
        got = Barrier(KEEPOUT, (BODY,) * 2).filter(poses, turning, np.zeros(2), drive, wheels, u)
    assert got.change[0] == NO_ANSWER
    assert not got.wheels[0].any()
    assert not got.u[0].any()
    assert np.isfinite(got.wheels).all()


def test_the_distance_counts_bodies_gap_points_errors_and_a_robot_that_stands_unnoticed() -> None:
    fast = Body(DifferentialDrive(0.016, 0.105, 12.5, 0.4, 0.1, 150.0), 0.1, 0.01)
    expected = 0.055 + 0.1 + 0.01 + 2 * (0.01 + 0.002) + 0.4 * (0.133 + 0.01 + 0.1)
    assert apart(KEEPOUT, BODY, fast) == apart(KEEPOUT, fast, BODY) == pytest.approx(expected)
    assert apart(KEEPOUT, BODY, BODY) == pytest.approx(0.11 + 0.01 + 0.024 + 0.2 * 0.215)


def test_the_edge_is_as_far_as_body_point_and_error() -> None:
    assert from_edge(KEEPOUT, BODY) == pytest.approx(0.055 + 0.01 + 0.01 + 0.002)


FAST = DifferentialDrive(0.016, 0.105, 100.0, 1.5, 0.08, 900.0)
SLOW = DifferentialDrive(0.016, 0.105, 12.5, 0.02, 0.08, 150.0)


@pytest.mark.parametrize(
    ("drive", "rate", "wheels", "way", "speed"),
    [
        (GTERNAL, 10.0, (12.5, 12.5), (1.0, 0.0), 0.2),
        (GTERNAL, 0.3, (12.5, 12.5), (1.0, 0.0), 0.2),  # 1.4 m apart
        (FAST, 10.0, (93.0, 93.0), (1.0, 0.0), 1.488),
        (SLOW, 10.0, (-12.5, 12.5), (0.0, 1.0), 2 * 0.016 * 12.5 / 0.105 * 0.01),  # its point goes sideways
    ],
)
def test_who_is_near_enough_to_matter_is_not_overlooked_at_top_speed(
    drive: DifferentialDrive, rate: float, wheels: tuple[float, float], way: tuple[float, float], speed: float
) -> None:
    keepout = replace(KEEPOUT, rate=rate, arena=(9.0, 9.0))
    bodies = (Body(drive, 0.055, 0.002),) * 2
    for share, how in ((0.95, CHANGED), (1.05, LEFT_ALONE)):
        distance = apart(keepout, *bodies) + 2 * share * speed / rate
        poses = np.array([(0.0, 0.0, 0.0), (distance * way[0], distance * way[1], 0.0)])
        s = Scene(poses, np.zeros((2, 2)), np.array([wheels, (0.0, 0.0)]))
        assert answer(s, Barrier(keepout, bodies)).change[0] == how


@pytest.mark.parametrize("unseen_s", [0.0, 0.233])
@pytest.mark.parametrize("way", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_every_wall_is_kept_and_from_further_by_a_robot_that_is_not_seen(way: tuple[int, int], unseen_s: float) -> None:
    """In an arena whose sides are neither equal nor 2 m; the robot has gone 20 mm in the 0.1 s beyond its age."""
    keepout = replace(KEEPOUT, arena=(3.0, 1.5))
    grown = 0.2 * max(0.0, unseen_s - KEEPOUT.age)
    edge = (1.5 if way[0] else 0.75) - from_edge(KEEPOUT, BODY) - KEEPOUT.ahead - grown
    psi = math.atan2(way[1], way[0])
    for left, speed in ((0.02, 0.16), (0.01, 0.1), (-0.005, -0.05)):  # what is left of the way; asked for 0.16 m/s
        at = edge - left
        s = Scene(np.array([(at * way[0], at * way[1], psi)]), np.zeros((1, 2)), np.full((1, 2), 10.0))
        got = answer(s, Barrier(keepout, (BODY,)), unseen=np.array([unseen_s]))
        assert body(got.wheels[0]) == pytest.approx((speed, 0.0), abs=1e-6)


def test_a_robot_that_is_not_seen_itself_keeps_further_from_others_too() -> None:
    s = face_to_face(D + 2 * KEEPOUT.ahead + 2 * 0.08 / KEEPOUT.rate + 1e-6)
    v, _ = body(answer(s, unseen=np.array([KEEPOUT.age + 0.01, 0.0])).wheels[0])
    assert v == pytest.approx(0.08 - KEEPOUT.rate / 2 * 0.2 * 0.01, abs=1e-5)


def test_who_stands_excuses_nobody_after_it() -> None:
    s = face_to_face(D - 0.005, 3)
    s.wheels[0] = 0.0
    got = answer(s, driving=np.array([False, True, True]))
    assert list(got.change) == [LEFT_ALONE, CHANGED, CHANGED]


def test_two_robots_in_one_place_are_given_an_answer() -> None:
    """No direction leads away; that is for others to notice."""
    s = Scene(np.array([(0.0, 0.0, 0.3), (0.0, 0.0, 0.3)]), np.zeros((2, 2)), np.full((2, 2), 5.0))
    got = answer(s)
    assert np.isfinite(got.wheels).all()
    assert (got.change == LEFT_ALONE).all()


@pytest.mark.slow
def test_of_slow_motors_too_it_is_known_where_they_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = replace(GTERNAL, motor_lag=0.4)
    monkeypatch.setattr(barrier_scenes, "GTERNAL", slow)
    changed = 0
    for seed in range(300):
        s = scene(seed, n=1)
        got = answer(s, Barrier(KEEPOUT, (Body(slow, 0.055, 0.002),)))
        v, omega = body(s.wheels[0])
        expected = nearest(rows(s, 0), np.array([v, L * omega]))
        if got.change[0] == CHANGED and expected is not None:
            changed += 1
            got_v, got_omega = body(got.wheels[0])
            assert (got_v, L * got_omega) == pytest.approx(expected.tolist(), abs=2e-4)
    assert changed > 10


def among_bystanders(
    s: Scene, robots: int, pushed: np.ndarray | None = None, unseen: np.ndarray | None = None
) -> Filtered:
    """Return the answer of a barrier whose last bodies are bystanders: only of robots something is asked."""
    wheels, u = s.wheels[:robots], velocities(s.poses, s.wheels)[:robots]
    turning = s.turning.copy()
    turning[robots:] = 0.0
    seen = np.zeros(s.n) if unseen is None else unseen
    drive = np.ones(robots, dtype=np.bool_)
    return Barrier(KEEPOUT, (BODY,) * s.n).filter(s.poses, turning, seen, drive, wheels, u, pushed)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.integers(0, 10**6))
def test_a_bystander_that_stands_is_as_a_robot_that_stands(seed: int) -> None:
    s = scene(seed)
    s.turning[3:] = 0.0
    expected = answer(s, driving=np.arange(s.n) < 3)
    for pushed in (None, np.zeros((s.n, 2))):
        got = among_bystanders(s, 3, pushed)
        assert len(got.change) == len(got.blocked) == 3
        assert np.array_equal(got.wheels, expected.wheels[:3])
        assert np.array_equal(got.u, expected.u[:3])


@pytest.mark.slow
@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_from_a_bystander_that_a_hand_pushes_each_keeps_its_half_and_what_it_comes_nearer_by(seed: int) -> None:
    s, robots = scene(seed), 3
    s.turning[robots:] = 0.0
    pushed = np.zeros((s.n, 2))
    pushed[robots:] = np.random.default_rng(seed).uniform(-0.15, 0.15, (s.n - robots, 2))
    got = among_bystanders(s, robots, pushed)
    at = [stop_point(pose, turning) for pose, turning in zip(s.poses, s.turning, strict=True)]
    for i in range(robots):
        r, (v, omega) = rows(s, i), body(s.wheels[i])
        pairs = [j for j in range(s.n) if j != i]
        b = r.b.copy()
        for k, j in enumerate(pairs, len(b) - len(pairs)):
            away = (at[j] - at[i]) / np.linalg.norm(at[j] - at[i])
            half = KEEPOUT.rate * (np.linalg.norm(at[j] - at[i]) - D) / 2
            b[k] = max(half - max(0.0, -away @ pushed[j]), -0.1)
        expected = nearest(Rows(r.a, b), np.array([v, L * omega]))
        if expected is None:
            expected = nearest(Rows(r.a, np.maximum(b, 0.0)), np.array([v, L * omega]))
        assert expected is not None
        got_v, got_omega = body(got.wheels[i])
        assert (got_v, L * got_omega) == pytest.approx(expected.tolist(), abs=2e-4)


@pytest.mark.parametrize("speed", [0.0, 0.02, 0.05, 0.2])
@pytest.mark.parametrize("left_m", [-0.01, 0.0, 0.005, 0.03])
def test_a_robot_withdraws_as_fast_as_a_bystander_comes(speed: float, left_m: float) -> None:
    poses = np.array([(0.0, 0.0, 0.0), (D + 2 * KEEPOUT.ahead + left_m, 0.0, math.pi)])
    s = Scene(poses, np.zeros((2, 2)), np.full((2, 2), 12.0))
    for towards in (-1.0, 1.0):  # to the robot, and away from it: that it goes is nothing to count on
        got = among_bystanders(s, 1, np.array([(0.0, 0.0), (towards * speed, 0.0)]))
        coming = speed if towards < 0 else 0.0
        allowed = min(0.192, max(KEEPOUT.rate * left_m / 2 - coming, -0.1))
        assert body(got.wheels[0]) == pytest.approx((allowed, 0.0), abs=1e-6)


def test_a_fast_bystander_is_met_from_further_away() -> None:
    """However fast it comes, the robot begins before the distance is used up."""
    for speed in (0.1, 0.5, 2.0):
        for left_m in np.linspace(0.0, 0.6, 25).tolist():
            poses = np.array([(0.0, 0.0, 0.0), (D + 2 * KEEPOUT.ahead + left_m, 0.0, math.pi)])
            s = Scene(poses, np.zeros((2, 2)), np.zeros((2, 2)))
            got = among_bystanders(s, 1, np.array([(0.0, 0.0), (-speed, 0.0)]))
            expected = max(min(0.0, KEEPOUT.rate * left_m / 2 - speed), -0.1)
            assert body(got.wheels[0]) == pytest.approx((expected, 0.0), abs=1e-6)


def test_a_bystander_that_nobody_sees_grows_and_one_that_never_was_seen_is_nowhere() -> None:
    poses = np.array([(0.0, 0.0, 0.0), (D + 2 * KEEPOUT.ahead + 0.03, 0.0, math.pi)])
    s = Scene(poses, np.zeros((2, 2)), np.full((2, 2), 10.0))
    granted = [
        body(among_bystanders(s, 1, unseen=np.array([0.0, age])).wheels[0])[0]
        for age in (0.0, KEEPOUT.age, KEEPOUT.age + 0.1, KEEPOUT.age + 0.5, 10.0, np.inf)
    ]
    expected = [0.15, 0.15, 0.05, -0.1, -0.1, 0.16]
    assert granted == pytest.approx(expected, abs=1e-6)


AT_REST = apart_at_rest(KEEPOUT, BODY, BODY)
BELIEVED_S = KEEPOUT.age + BODY.delay + GTERNAL.motor_lag


def rested() -> Barrier:
    """Return the barrier of two robots that have stood for a while."""
    barrier = Barrier(KEEPOUT, (BODY,) * 2)
    for _ in range(10):
        answer(face_to_face(1.0)._replace(wheels=np.zeros((2, 2))), barrier)
    return barrier


def test_robots_that_stand_may_be_nearer_than_robots_that_drive() -> None:
    s = face_to_face(AT_REST + 2 * KEEPOUT.ahead + 0.001)._replace(wheels=np.zeros((2, 2)))
    assert not answer(s, rested()).wheels.any()
    assert answer(s).wheels.all(), "of those who were fast lately it is not known that they stand"


@pytest.mark.parametrize("left_m", [0.01, 0.02, 0.03])
def test_beside_another_a_robot_is_no_faster_than_their_distance_allows(left_m: float) -> None:
    """It drives past, so that no row of the pair holds it."""
    apart_m = AT_REST + left_m
    poses = np.array([(0.0, 0.0, math.pi / 2), (apart_m, 0.0, math.pi / 2)])
    s, barrier = Scene(poses, np.zeros((2, 2)), np.array([(12.0, 12.0), (0.0, 0.0)])), rested()
    v, omega = body(answer(s, barrier).wheels[0])
    assert v == pytest.approx((1 - KEEPOUT.rate * KEEPOUT.tick) * left_m / BELIEVED_S, rel=1e-6)
    assert omega == pytest.approx(0.0, abs=1e-9)


def test_however_near_a_robot_may_creep() -> None:
    poses = np.array([(0.0, 0.0, math.pi / 2), (AT_REST + 1e-6, 0.0, math.pi / 2)])
    s = Scene(poses, np.zeros((2, 2)), np.array([(12.0, 12.0), (0.0, 0.0)]))
    v, _ = body(answer(s, rested()).wheels[0])
    assert v == pytest.approx(0.075 * GTERNAL.max_speed)


def test_who_was_fast_is_believed_to_be_until_an_image_would_tell() -> None:
    """A robot at top speed beside the way, and then at rest: the other may come as near as before 0.215 s later."""
    far, barrier = face_to_face(1.0), rested()
    answer(far._replace(wheels=np.full((2, 2), 12.5)), barrier)
    near = face_to_face(AT_REST + 2 * KEEPOUT.ahead + 0.02)._replace(wheels=np.zeros((2, 2)))
    withdrawing = [bool(answer(near, barrier).wheels.any()) for _ in range(30)]
    ticks = math.ceil(BELIEVED_S / KEEPOUT.tick)
    assert all(withdrawing[:ticks])
    assert not withdrawing[-1]

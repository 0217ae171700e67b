"""The barrier's command: safe by its own rows, nearest to what was asked, and no other where that was safe."""

import math
from typing import NamedTuple

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety.barrier import CHANGED, LEFT_ALONE, NO_ANSWER, Barrier, Body, Keepout, apart, from_edge
from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_wheels, wheels_from_body

DRIVE = DifferentialDrive(
    wheel_radius=0.016,
    wheel_base=0.105,
    max_wheel_speed=12.5,
    max_speed=0.2,
    motor_lag=0.08,
    max_wheel_acceleration=150.0,
)
BODY = Body(DRIVE, 0.055, 0.002)
KEEPOUT = Keepout(
    gap=0.01, ahead=0.01, rate=10.0, pose_error=0.002, age=0.133, lost_after=0.5, point_ahead=0.08, tick=0.033,
    arena=(3.2, 2.0),
)  # fmt: skip
D, L = apart(KEEPOUT, BODY, BODY), KEEPOUT.point_ahead
TICKS_3_S = 91

Array = np.ndarray


class Scene(NamedTuple):
    """Robots, how their wheels turn, and what they are asked for."""

    poses: Array
    turning: Array
    wheels: Array

    @property
    def n(self) -> int:
        return len(self.poses)


class Answer(NamedTuple):
    """What the barrier makes of it."""

    wheels: Array
    u: Array
    how: Array
    blocked: Array


def body(wheels: Array) -> tuple[float, float]:
    return body_from_wheels(*wheels.tolist(), DRIVE.wheel_radius, DRIVE.wheel_base)


def feasible(wheels: Array) -> Array:
    """Scale wheels so that the robot can do them."""
    fastest = max(np.abs(wheels).max() / 12.5, abs(body(wheels)[0]) / 0.2, 1.0)
    return wheels / fastest


def scene(seed: int, n: int = 5, reach: float = 0.35) -> Scene:
    """Return robots that are close together, some within D of each other, anywhere in the arena."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform((-1.55, -0.95), (1.55, 0.95))
    at = np.clip(middle + rng.uniform(-reach, reach, (n, 2)), (-1.545, -0.945), (1.545, 0.945))
    wheels = np.array([feasible(row) for row in rng.uniform(-14, 14, (2 * n, 2))])
    return Scene(np.column_stack([at, rng.uniform(-math.pi, math.pi, n)]), wheels[:n], wheels[n:])


def answer(
    s: Scene, barrier: Barrier | None = None, unseen: Array | None = None, driving: Array | None = None
) -> Answer:
    barrier = barrier or Barrier(KEEPOUT, (BODY,) * s.n)
    wheels, u = s.wheels.copy(), velocities(s.poses, s.wheels)
    how, blocked = barrier.filter(
        s.poses, s.turning, np.zeros(s.n) if unseen is None else unseen,
        np.ones(s.n, dtype=np.bool_) if driving is None else driving, wheels, u,
    )  # fmt: skip
    return Answer(wheels, u, how, blocked)


def velocities(poses: Array, wheels: Array) -> Array:
    """Return u (N, 2) of the points p."""
    found = []
    for (_, _, psi), row in zip(poses, wheels, strict=True):
        v, omega = body(row)
        c, s = math.cos(psi), math.sin(psi)
        found.append((c * v - s * L * omega, s * v + c * L * omega))
    return np.array(found)


def stop_point(pose: Array, turning: Array) -> Array:
    """Return q where a robot comes to rest, its wheels' speeds decaying: step by step."""
    x, y, psi = pose.tolist()
    left = np.exp(-np.linspace(0.0, 40.0, 80))  # of the wheels' speeds
    v, omega = body(turning * DRIVE.motor_lag)
    for share in (left[:-1] - left[1:]).tolist():
        x, y, psi = arc(x, y, psi, v, omega, share)
    return np.array([x + KEEPOUT.ahead * math.cos(psi), y + KEEPOUT.ahead * math.sin(psi)])


def stop_velocity(pose: Array, turning: Array, wheels: Array) -> Array:
    """Return q' under a command, by letting the robot follow it for a moment."""
    moment = 1e-4
    between = wheels + (turning - wheels) * math.exp(-moment / 2 / DRIVE.motor_lag)
    after = wheels + (turning - wheels) * math.exp(-moment / DRIVE.motor_lag)
    moved = np.array(arc(*pose.tolist(), *body(between), moment))
    return (stop_point(moved, after) - stop_point(pose, turning)) / moment


class Rows(NamedTuple):
    """A z <= b for one robot's z = (v, l omega): limits, then edges and pairs."""

    a: Array
    b: Array


def rows(s: Scene, i: int) -> Rows:
    """Return a robot's rows by numerical differentiation of where it would stop."""
    at = [stop_point(pose, turning) for pose, turning in zip(s.poses, s.turning, strict=True)]
    units = [
        np.array(wheels_from_body(v, omega, DRIVE.wheel_radius, DRIVE.wheel_base))
        for v, omega in ((0.1, 0), (0, 0.1 / L))
    ]
    moves = np.array([stop_velocity(s.poses[i], s.turning[i], unit) for unit in units]).T / 0.1
    turn = DRIVE.wheel_base / 2 / L
    a = [(g, g * h) for g in (1, -1) for h in (turn, -turn, 0)]
    b = [DRIVE.wheel_radius * 12.5, DRIVE.wheel_radius * 12.5, 0.2] * 2
    for out, half in (((1, 0), 1.6), ((-1, 0), 1.6), ((0, 1), 1.0), ((0, -1), 1.0)):
        a.append(tuple(np.array(out) @ moves))
        b.append(max(KEEPOUT.rate * (half - from_edge(KEEPOUT, BODY) - np.array(out) @ at[i]), -0.1))
    for j in range(s.n):
        if j != i:
            distance = float(np.linalg.norm(at[j] - at[i]))
            a.append(tuple((at[j] - at[i]) / distance @ moves))
            b.append(max(KEEPOUT.rate * (distance - D) / 2, -0.1))  # withdrawing at half its top speed at most
    return Rows(np.array(a, dtype=float), np.array(b, dtype=float))


def nearest(r: Rows, z: Array) -> Array | None:
    """Return daqp's answer; None if there is none."""
    found, _, flag, _ = daqp.solve(
        np.eye(2), -z, r.a, r.b, np.full(len(r.b), -1e30), np.zeros(len(r.b), dtype=np.int32)
    )
    return np.array(found) if flag == 1 else None


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
        assert given_.how[i] in (LEFT_ALONE, CHANGED)


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 10**6))
def test_what_is_safe_is_left_alone_to_the_bit(seed: int) -> None:
    s = scene(seed, reach=0.8)
    got = answer(s)
    untouched = got.how == LEFT_ALONE
    assert np.array_equal(got.wheels[untouched], s.wheels[untouched])
    assert np.array_equal(got.u[untouched], velocities(s.poses, s.wheels)[untouched])
    again = answer(s._replace(wheels=got.wheels))
    assert np.allclose(again.wheels, got.wheels, atol=1e-5)


def test_the_scenes_have_robots_of_both_kinds() -> None:
    counts = np.bincount(np.concatenate([answer(scene(seed)).how for seed in range(50)]), minlength=3)
    assert counts[LEFT_ALONE] > 40
    assert counts[CHANGED] > 40
    assert counts[NO_ANSWER] == 0


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 10**6))
def test_the_wheels_keep_their_limits_and_u_is_what_they_do(seed: int) -> None:
    s = scene(seed)
    got = answer(s)
    assert np.abs(got.wheels).max() <= DRIVE.max_wheel_speed * (1 + 1e-6)
    assert max(abs(body(row)[0]) for row in got.wheels) <= DRIVE.max_speed * (1 + 1e-6)
    assert got.u == pytest.approx(velocities(s.poses, got.wheels), abs=1e-9)


@pytest.mark.parametrize("bearing_deg", [0, 20, 40, 60, 75])
def test_who_turns_aside_keeps_its_rows_too(bearing_deg: float) -> None:
    bearing = math.radians(bearing_deg)
    poses = np.array([(0.0, 0.0, 0.0), (D * math.cos(bearing), D * math.sin(bearing), 0.0)])
    s, barrier = Scene(poses, np.zeros((2, 2)), np.array([(8.0, 8.0), (0.0, 0.0)])), Barrier(KEEPOUT, (BODY,) * 2)
    r = rows(s, 0)
    for _ in range(40):
        got = answer(s, barrier)
        v, omega = body(got.wheels[0])
        assert got.how[0] == CHANGED
        assert (r.a @ (v, L * omega) <= r.b + 1e-5).all()


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 10**6))
def test_a_mirrored_scene_has_the_mirrored_answer(seed: int) -> None:
    s = scene(seed)
    mirrored = Scene(s.poses * (1, -1, -1), s.turning[:, ::-1].copy(), s.wheels[:, ::-1].copy())
    assert answer(mirrored).wheels == pytest.approx(answer(s).wheels[:, ::-1], abs=1e-6)


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
    cell = D + 2 * (KEEPOUT.ahead + DRIVE.max_speed * DRIVE.motor_lag)
    cells = np.array([(k, m) for k in range(-4, 5) for m in range(-3, 4)]) * cell
    poses = np.column_stack([cells[rng.permutation(len(cells))[:5]], rng.uniform(-math.pi, math.pi, 5)])
    s = scene(seed)._replace(poses=poses)
    at = np.array([stop_point(pose, turning) for pose, turning in zip(s.poses, s.turning, strict=True)])
    gaps = np.linalg.norm(at[:, None] - at[None], axis=-1)[np.triu_indices(s.n, 1)]
    assert gaps.min() > D
    assert (np.abs(at) < np.array(KEEPOUT.arena) / 2 - from_edge(KEEPOUT, BODY)).all()
    got = answer(s._replace(wheels=np.zeros((s.n, 2))))
    assert not got.wheels.any()
    assert not got.how.any()


def face_to_face(distance: float, n: int = 2) -> Scene:
    """Return robots in a row that all drive at the middle."""
    poses = [(k * distance, 0.0, 0.0 if k < n / 2 else math.pi) for k in range(n)]
    return Scene(np.array(poses), np.zeros((n, 2)), np.full((n, 2), 5.0))


def test_within_the_distance_a_robot_withdraws() -> None:
    got = answer(face_to_face(D + 2 * KEEPOUT.ahead - 0.01))
    assert (got.wheels < 0).all()
    v, _ = body(got.wheels[0])
    assert v == pytest.approx(-KEEPOUT.rate * 0.01 / 2, rel=1e-6)


def test_a_robot_between_two_that_are_too_near_goes_to_neither() -> None:
    s = face_to_face(D - 0.005, 3)
    got = answer(s)
    v, _ = body(got.wheels[1])
    assert got.how[1] == CHANGED
    assert v == pytest.approx(0.0, abs=1e-6)


def test_who_does_not_drive_stands_whatever_is_near() -> None:
    s = face_to_face(D - 0.03)
    got = answer(s._replace(wheels=np.zeros((2, 2))), driving=np.zeros(2, dtype=np.bool_))
    assert not got.wheels.any()
    assert not got.how.any()


def test_a_robot_that_is_not_seen_grows_until_it_must_stand_and_one_never_seen_is_nowhere() -> None:
    far = D + 2 * KEEPOUT.ahead + 2 * 0.08 / KEEPOUT.rate + 1e-6
    s = face_to_face(far)  # at 0.08 m/s each: just far enough
    ages = [0.0, KEEPOUT.age, 0.15, 0.2, 0.4, 5.0]
    speeds = [body(answer(s, unseen=np.array([0.0, age])).wheels[0])[0] for age in ages]
    expected = [0.08 - KEEPOUT.rate / 2 * 0.2 * max(0.0, age - KEEPOUT.age) for age in ages[:4]]
    assert speeds[:4] == pytest.approx(expected, abs=1e-5)
    assert speeds[4:] == pytest.approx([-0.1, -0.1])  # it withdraws
    wide = face_to_face(D + 2 * KEEPOUT.ahead + DRIVE.max_speed * KEEPOUT.lost_after + 0.016 + 1e-6)
    assert body(answer(wide, unseen=np.array([0.0, 60.0])).wheels[0])[0] == pytest.approx(0.08)
    assert body(answer(s, unseen=np.array([0.0, math.inf])).wheels[0])[0] == pytest.approx(0.08)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("what", ["poses", "turning", "wheels"])
def test_what_is_not_a_number_makes_a_robot_stand(what: str, bad: float) -> None:
    s = face_to_face(0.5)
    array = getattr(s, what).copy()
    array[0, 0] = bad
    with np.errstate(invalid="ignore"):
        wheels, u = (array if what == "wheels" else s.wheels).copy(), np.ones((2, 2))
        poses, turning = (array if name == what else getattr(s, name) for name in ("poses", "turning"))
        drive = np.ones(2, dtype=np.bool_)
        how, _ = Barrier(KEEPOUT, (BODY,) * 2).filter(poses, turning, np.zeros(2), drive, wheels, u)
    assert how[0] == NO_ANSWER
    assert not wheels[0].any()
    assert not u[0].any()
    assert np.isfinite(wheels).all()


def test_two_robots_that_face_each_other_pass_on_the_right_after_half_a_second() -> None:
    s, barrier = face_to_face(D + 2 * KEEPOUT.ahead), Barrier(KEEPOUT, (BODY,) * 2)
    waiting = [body(answer(s, barrier).wheels[0])[1] for _ in range(TICKS_3_S)]
    assert waiting == pytest.approx([0.0] * TICKS_3_S, abs=1e-9), "who asks for little waits"
    s = s._replace(wheels=np.full((2, 2), 8.0))
    turns = [body(answer(s, barrier).wheels[0])[1] for _ in range(20)]
    first = next(k for k, omega in enumerate(turns) if omega < -0.1)
    assert 14 <= first <= 16
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


def test_the_distance_counts_bodies_gap_points_errors_and_a_robot_that_stands_unnoticed() -> None:
    fast = Body(DifferentialDrive(0.016, 0.105, 12.5, 0.4, 0.1, 150.0), 0.1, 0.01)
    expected = 0.055 + 0.1 + 0.01 + 2 * (0.01 + 0.002) + 0.4 * (0.133 + 0.01 + 0.1)
    assert apart(KEEPOUT, BODY, fast) == apart(KEEPOUT, fast, BODY) == pytest.approx(expected)
    assert apart(KEEPOUT, BODY, BODY) == pytest.approx(0.11 + 0.01 + 0.024 + 0.2 * 0.215)


def test_the_edge_is_as_far_as_body_point_and_error() -> None:
    assert from_edge(KEEPOUT, BODY) == pytest.approx(0.055 + 0.01 + 0.002)


SLOW = DifferentialDrive(0.016, 0.105, 12.5, 0.02, 0.08, 150.0)


@pytest.mark.parametrize(
    ("drive", "wheels", "way", "speed"),
    [
        (DRIVE, (12.5, 12.5), (1.0, 0.0), 0.2),
        (SLOW, (-12.5, 12.5), (0.0, 1.0), 2 * 0.016 * 12.5 / 0.105 * 0.01),  # it turns, and its point goes sideways
    ],
)
def test_who_is_near_enough_to_matter_is_not_overlooked_at_top_speed(
    drive: DifferentialDrive, wheels: tuple[float, float], way: tuple[float, float], speed: float
) -> None:
    bodies = (Body(drive, 0.055, 0.002),) * 2
    for share, how in ((0.95, CHANGED), (1.05, LEFT_ALONE)):
        distance = apart(KEEPOUT, *bodies) + 2 * share * speed / KEEPOUT.rate
        poses = np.array([(0.0, 0.0, 0.0), (distance * way[0], distance * way[1], 0.0)])
        s = Scene(poses, np.zeros((2, 2)), np.array([wheels, (0.0, 0.0)]))
        assert answer(s, Barrier(KEEPOUT, bodies)).how[0] == how

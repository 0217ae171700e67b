"""The platoon's law: Algorithm 1's ticks, the closed loop with ideal and with noisy robots, and what it remembers."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.path import Path
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.control.driven import (
    FIGURE_EIGHT,
    KNOTS,
    PLATOON_PATH,
    WHEELS,
    Column,
    Platoon,
    drive_platoon,
    line_up,
    platoon_of,
)

D, T, GAMMA, L, TOP_SPEED, TICK = 0.25, 0.6, 0.0455, 0.08, 0.2, 0.033
LAG, DELAY_TICKS, NOISE = 0.08, 2, 0.0005
ALL = np.ones(4, dtype=np.bool_)
SIGMA = np.array([4.0, 3.82, 3.68, 3.5])
START = line_up(SIGMA, np.array([0.1, -0.2, 0.15, 0.25]))  # turned and off their spacing as in the paper's run


def test_references_are_those_of_algorithm_1() -> None:
    platoon = platoon_of()
    for m in drive_platoon(platoon, line_up(SIGMA), 10.0):
        assert platoon.reference_parameter[0] == pytest.approx(GAMMA * (m.t + T) % 4.0)
    predicted = m.points + T * platoon.u  # by the newest u
    behind = PLATOON_PATH.back(PLATOON_PATH.nearest(predicted[:-1]), D)
    assert platoon.reference_parameter[1:] == pytest.approx(behind, abs=1e-9)
    rho = m.decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]]
    assert rho == pytest.approx(PLATOON_PATH.position(platoon.reference_parameter), abs=1e-12)


def test_control_error_is_the_papers() -> None:
    platoon = platoon_of()
    u_before = platoon.u.copy()
    for m in drive_platoon(platoon, line_up(SIGMA), 3.0):
        rho = m.decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]]
        error = np.linalg.norm(rho - (m.points + T * u_before), axis=1)
        assert m.decisions[:, Column.CONTROL_ERROR] == pytest.approx(error, abs=1e-12)
        u_before = platoon.u.copy()


def test_centre_tracking_shifts_the_reference_along_the_tangent() -> None:
    platoon = platoon_of(track="centre")
    decisions = platoon.tick(3.0, line_up(SIGMA), ALL)
    on_path = platoon.reference_parameter
    shifted = PLATOON_PATH.position(on_path) + L * PLATOON_PATH.tangent(on_path)
    assert decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]] == pytest.approx(shifted, abs=1e-12)


@settings(deadline=None, derandomize=True)
@given(st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8), st.floats(-math.pi, math.pi))
def test_u_is_what_the_wheels_were_given(offsets: list[float], turned: float) -> None:
    """Far from the path the wheels saturate, and u with them: no wind-up."""
    platoon, poses = platoon_of(), line_up(SIGMA, turned)
    poses[:, :2] += np.array(offsets).reshape(4, 2)
    for _ in range(3):
        decisions = platoon.tick(1.0, poses, ALL)
        for row, (_, _, psi), u in zip(decisions, poses, platoon.u, strict=True):
            v, omega = body_from_wheels(row[Column.LEFT], row[Column.RIGHT], 0.016, 0.105)
            c, s = math.cos(psi), math.sin(psi)
            assert u == pytest.approx([c * v - s * L * omega, s * v + c * L * omega], abs=1e-12)
            assert abs(v) <= 0.2
            assert np.abs(row[WHEELS]).max() <= 12.5
            full = max(abs(v) / 0.2, np.abs(row[WHEELS]).max() / 12.5)
            assert bool(row[Column.SATURATED]) == (full > 1.0 - 1e-6)
    assert np.array_equal(decisions[:, [Column.U_X, Column.U_Y]], platoon.u)


def test_saturation_is_met_far_from_the_path() -> None:
    poses = line_up(SIGMA)
    poses[:, 1] -= 0.4
    assert (platoon_of().tick(0.0, poses, ALL)[:, Column.SATURATED] == 1.0).any()


def test_not_driving_means_u_is_zero() -> None:
    platoon, poses = platoon_of(), line_up(SIGMA)
    platoon.tick(2.0, poses, ALL)
    assert np.abs(platoon.u).min() > 0.0
    decisions = platoon.tick(2.0, poses, np.array([True, False, True, False]))
    assert (platoon.u[[1, 3]] == 0.0).all()
    assert (decisions[[1, 3], WHEELS] == 0.0).all()
    assert np.abs(decisions[[0, 2], WHEELS]).min() > 0.0


def test_a_robot_does_not_change_those_before_it() -> None:
    poses, both = line_up(SIGMA), (platoon_of(), platoon_of())
    for robot in (3, 0):
        moved = poses.copy()
        moved[robot] += (0.03, -0.02, 0.5)
        for platoon in both:
            platoon.restart()
        for k in range(30):
            a, b = both[0].tick(k * 0.033, poses, ALL), both[1].tick(k * 0.033, moved, ALL)
            assert np.array_equal(a[:robot], b[:robot])
            assert (a != b)[robot:].any(axis=1).all()  # and those behind it feel it in the same tick


@settings(deadline=None, derandomize=True, max_examples=25)
@given(
    st.floats(-math.pi, math.pi),
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
    st.booleans(),
    st.sampled_from(["point", "centre"]),
)
def test_moving_the_whole_world_changes_no_wheel(turn: float, x: float, y: float, mirrored: bool, track: str) -> None:
    """Turned, shifted, or seen in a mirror, which swaps the wheels."""
    c, s = math.cos(turn), math.sin(turn)
    world = np.array([[c, s], [-s, c]])
    if mirrored:
        world = np.diag([1.0, -1.0]) @ world
    at, derivatives = KNOTS
    here = platoon_of(track=track)
    shifted = platoon_of(path=Path.hermite(at @ world + (x, y), derivatives @ world), track=track)
    rng = np.random.default_rng(1)
    poses = line_up(SIGMA, np.array([0.1, -0.2, 0.15, 0.25]))
    for k in range(20):
        poses += rng.normal(0.0, 0.003, poses.shape)
        heading = (-poses[:, 2] if mirrored else poses[:, 2]) + turn
        moved = np.column_stack([poses[:, :2] @ world + (x, y), heading])
        a = here.tick(k * 0.033, poses, ALL)[:, WHEELS]
        b = shifted.tick(k * 0.033, moved, ALL)[:, WHEELS]
        assert (b[:, ::-1] if mirrored else b) == pytest.approx(a, abs=1e-7)


# The closed loop with ideal robots: where the platoon settles, and what a standing robot does to it


def test_the_leader_converges_to_its_reference_and_the_others_to_their_spacing() -> None:
    """x + T x' = r(t+T) leaves the error e with T e' + e = r(t+T) - r - T r', at most T^2/2 sup|r''|."""
    lap = np.linspace(0.0, 4.0, 4000, endpoint=False)
    fastest_turn = np.linalg.norm(PLATOON_PATH.second_derivative(lap), axis=1).max() * GAMMA**2
    bound = T**2 / 2 * fastest_turn
    settled = [m for m in drive_platoon(platoon_of(), START, 88.0) if m.t > 5.0]
    errors = [float(np.linalg.norm(m.points[0] - PLATOON_PATH.position(GAMMA * m.t))) for m in settled]
    assert max(errors) < bound < 0.003
    off = np.abs([m.gaps - D for m in settled])
    assert off.max() < 0.003 and off.mean() < 0.0005


@pytest.mark.slow
def test_tracking_the_centre_puts_the_centre_on_the_path() -> None:
    def centre_error(track: str) -> float:
        run = drive_platoon(platoon_of(track=track), START, 88.0)
        centres = np.concatenate([m.poses[:, :2] for m in run if m.t > 5.0])
        nearest = PLATOON_PATH.position(PLATOON_PATH.nearest(centres))
        return float(np.linalg.norm(nearest - centres, axis=1).mean())

    point, centre = centre_error("point"), centre_error("centre")
    assert centre < point / 2
    assert centre < 0.0015


def test_a_reference_never_retreats() -> None:
    poses = line_up(np.array([0.0, 3.95, 3.86, 3.6]))  # followers far too close: they must wait, not go back
    poses[1, :2] += 0.03
    run = drive_platoon(platoon_of(), poses, 20.0, blocked=lambda t: {0} if 5.0 < t < 10.0 else set())
    references = np.array([m.platoon.reference_parameter.copy() for m in run])
    advance = (np.diff(references, axis=0) + 2.0) % 4.0 - 2.0
    assert advance.min() >= -1e-12
    assert (advance[:, 1:] == 0.0).any(axis=0).all()  # each follower waited at least once


@pytest.mark.slow_after_first
@pytest.mark.parametrize("robot", [0, 1, 2])
def test_nobody_runs_into_a_robot_whose_motors_stall(robot: int) -> None:
    """Its u is what its wheels can do, so that it is predicted T * top speed ahead at most."""
    run = drive_platoon(platoon_of(), START, 60.0, blocked=lambda t: {robot} if 20.0 < t < 30.0 else set())
    moments = [m for m in run if m.t > 8.0]
    assert np.array([m.gaps for m in moments]).min() > D - T * TOP_SPEED - 0.003
    centres = np.array([m.poses[:, :2] for m in moments])
    assert np.linalg.norm(np.diff(centres, axis=1), axis=2).min() > 0.11
    assert moments[-1].gaps == pytest.approx(np.full(3, D), abs=0.003)  # and the spacing comes back


def test_a_robot_that_must_not_drive_stands_and_its_follower_waits() -> None:
    def driving(t: float) -> np.ndarray:
        return np.array([True, not 20.0 < t < 30.0, True, True])

    moments = list(drive_platoon(platoon_of(), START, 60.0, driving=driving))
    assert all((m.wheels[1] == 0.0).all() for m in moments if 20.0 < m.t < 30.0)
    waiting = [m for m in moments if 22.0 < m.t < 30.0]
    assert min(m.gaps[1] for m in waiting) > 0.19  # it stopped at once, T * 0.1 m/s short of its prediction
    assert max(np.abs(m.wheels[2]).max() for m in waiting[-60:]) < 0.01
    assert moments[-1].gaps == pytest.approx(np.full(3, D), abs=0.003)


# Memory

TWO = np.ones(2, dtype=np.bool_)


def is_behind_the_first(platoon: Platoon, path: Path, poses: np.ndarray) -> bool:
    """Tell whether the follower's reference is D behind the nearest point to its predecessor's prediction."""
    heading = np.array([np.cos(poses[0, 2]), np.sin(poses[0, 2])])
    predicted = poses[0, :2] + 0.08 * heading + T * platoon.u[0]
    expected = path.back(path.nearest(predicted[None]), D)[0]
    return abs((platoon.reference_parameter[1] - expected + 2.0) % 4.0 - 2.0) < 1e-6


def test_a_carried_robot_is_found_again() -> None:
    platoon = platoon_of(2)
    here, other = line_up(np.array([0.5, 0.3])), line_up(np.array([1.8, 0.3]))
    platoon.tick(10.0, here, TWO)
    assert is_behind_the_first(platoon, PLATOON_PATH, here)
    platoon.tick(10.0, other, TWO)
    assert not is_behind_the_first(platoon, PLATOON_PATH, other)  # it is looked for where it was
    platoon.carried(0)
    platoon.tick(10.0, other, TWO)
    assert is_behind_the_first(platoon, PLATOON_PATH, other)


def test_the_follower_of_a_robot_on_a_crossing_keeps_to_its_branch() -> None:
    platoon = platoon_of(2, path=FIGURE_EIGHT, path_rate=0.1)
    for sigma in np.linspace(3.4, 4.6, 121):
        poses = line_up(np.array([sigma, sigma - 0.3]), path=FIGURE_EIGHT)
        side = np.array([-np.sin(poses[0, 2]), np.cos(poses[0, 2])])
        poses[0, :2] += 0.02 * side
        platoon.u[:] = 0.0
        platoon.tick((sigma - 0.06) / 0.1, poses, TWO)
        behind = FIGURE_EIGHT.back(np.array([sigma]), D)[0]
        assert platoon.reference_parameter[1] == pytest.approx(behind, abs=0.15)


def test_a_new_run_begins_as_the_first() -> None:
    platoon, poses = platoon_of(2), line_up(np.array([0.5, 0.3]))
    first = platoon.tick(0.0, poses, TWO).copy()
    for k in range(100):
        platoon.tick(k * 0.033, line_up(np.array([2.5, 2.3])), TWO)
    platoon.restart()
    assert np.array_equal(platoon.tick(0.0, poses, TWO), first)


def test_a_run_that_begins_on_the_lap_goes_on_from_there_and_one_at_the_paths_beginning_begins_there() -> None:
    begun, n = platoon_of(2), len(PLATOON_PATH.coefficients)
    for leader in (0.0, 0.05, 1.5, n - 0.5):
        begun.restart()
        begun.tick(0.0, line_up(np.array([leader, (leader - 0.3) % n])), TWO)
        ahead = (begun.reference_parameter[0] - (leader if leader > 0.1 else 0.0)) % n
        assert ahead == pytest.approx(0.0455 * T, abs=0.01)


# Noise of the poses: the paper's Euler step amplifies it from robot to robot, the exact step does not


def mean_control_errors(platoon: Platoon, poses: np.ndarray, seed: int) -> np.ndarray:
    """Return each robot's mean error [m] over 25 s, with noisy poses, delayed commands and lagging motors."""
    rng, poses = np.random.default_rng(seed), poses.copy()
    under_way = deque([np.zeros((4, 2))] * DELAY_TICKS)
    speeds, errors = np.zeros((4, 2)), []
    step = TICK / 3
    decay = math.exp(-step / LAG)
    for k in range(round(30.0 / TICK)):
        measured = poses + np.column_stack([rng.normal(0.0, NOISE, (4, 2)), np.zeros(4)])
        decisions = platoon.tick(k * TICK, measured, ALL)
        errors.append(decisions[:, Column.CONTROL_ERROR])
        under_way.append(decisions[:, WHEELS])
        command = under_way.popleft()
        for _ in range(3):
            mean = command + (speeds - command) * (1 - decay) * LAG / step
            speeds = command + (speeds - command) * decay
            for i, wheels in enumerate(mean):
                poses[i] = arc(*poses[i], *body_from_wheels(*wheels, 0.016, 0.105), step)
    return np.mean(errors[round(5.0 / TICK) :], axis=0)


@pytest.fixture(scope="module")
def errors() -> Callable[[str], np.ndarray]:
    start = line_up(np.array([4.0, 3.82, 3.68, 3.5]))

    def of(integrator: str) -> np.ndarray:
        runs = [mean_control_errors(platoon_of(integrator=integrator), start, seed) for seed in range(3)]
        return np.mean(runs, axis=0)

    return of


@pytest.mark.slow
def test_euler_amplifies_and_exact_does_not(errors: Callable[[str], np.ndarray]) -> None:
    exact, euler = errors("exact"), errors("euler")
    assert exact[3] / exact[0] < 1.2
    assert euler[3] / euler[0] >= 3.0
    assert (euler[3] / euler[0]) / (exact[3] / exact[0]) >= 3.0
    assert (np.diff(euler) > 0.2e-3).all()  # each robot passes on more than it got
    assert exact.max() < 0.0015

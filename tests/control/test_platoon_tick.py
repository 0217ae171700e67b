"""One tick of Algorithm 1: who depends on whom, what u is, and that the world has no preferred direction."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.path import Path
from robofleet.vehicles.differential_drive import body_from_wheels
from tests.control.driven import WHEELS, Column, Platoon

PlatoonOf = Callable[..., Platoon]
Drive = Callable[..., Iterator]  # type: ignore[type-arg]
LineUp = Callable[..., np.ndarray]
D, T, GAMMA, L = 0.25, 0.6, 0.0455, 0.08
ALL = np.ones(4, dtype=np.bool_)
SIGMA = np.array([4.0, 3.82, 3.68, 3.5])


def test_references_are_those_of_algorithm_1(
    platoon_of: PlatoonOf, line_up: LineUp, drive_platoon: Drive, platoon_path: Path
) -> None:
    platoon = platoon_of()
    for m in drive_platoon(platoon, line_up(SIGMA), 10.0):
        assert platoon.reference_parameter[0] == pytest.approx(GAMMA * (m.t + T) % 4.0)
    predicted = m.points + T * platoon.u  # by the newest u
    behind = platoon_path.back(platoon_path.nearest(predicted[:-1]), D)
    assert platoon.reference_parameter[1:] == pytest.approx(behind, abs=1e-9)
    rho = m.decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]]
    assert rho == pytest.approx(platoon_path.position(platoon.reference_parameter), abs=1e-12)


def test_control_error_is_the_papers(platoon_of: PlatoonOf, line_up: LineUp, drive_platoon: Drive) -> None:
    platoon = platoon_of()
    u_before = platoon.u.copy()
    for m in drive_platoon(platoon, line_up(SIGMA), 3.0):
        rho = m.decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]]
        error = np.linalg.norm(rho - (m.points + T * u_before), axis=1)
        assert m.decisions[:, Column.CONTROL_ERROR] == pytest.approx(error, abs=1e-12)
        u_before = platoon.u.copy()


def test_centre_tracking_shifts_the_reference_along_the_tangent(
    platoon_of: PlatoonOf, line_up: LineUp, platoon_path: Path
) -> None:
    platoon = platoon_of(track="centre")
    decisions = platoon.tick(3.0, line_up(SIGMA), ALL)
    on_path = platoon.reference_parameter
    shifted = platoon_path.position(on_path) + L * platoon_path.tangent(on_path)
    assert decisions[:, [Column.REFERENCE_X, Column.REFERENCE_Y]] == pytest.approx(shifted, abs=1e-12)


@settings(deadline=None, derandomize=True)
@given(st.lists(st.floats(-0.5, 0.5), min_size=8, max_size=8), st.floats(-math.pi, math.pi))
def test_u_is_what_the_wheels_were_given(
    platoon_of: PlatoonOf, line_up: LineUp, offsets: list[float], turned: float
) -> None:
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


def test_saturation_is_met_far_from_the_path(platoon_of: PlatoonOf, line_up: LineUp) -> None:
    poses = line_up(SIGMA)
    poses[:, 1] -= 0.4
    assert (platoon_of().tick(0.0, poses, ALL)[:, Column.SATURATED] == 1.0).any()


def test_not_driving_means_u_is_zero(platoon_of: PlatoonOf, line_up: LineUp) -> None:
    platoon, poses = platoon_of(), line_up(SIGMA)
    platoon.tick(2.0, poses, ALL)
    assert np.abs(platoon.u).min() > 0.0
    decisions = platoon.tick(2.0, poses, np.array([True, False, True, False]))
    assert (platoon.u[[1, 3]] == 0.0).all()
    assert (decisions[[1, 3], WHEELS] == 0.0).all()
    assert np.abs(decisions[[0, 2], WHEELS]).min() > 0.0


def test_a_robot_does_not_change_those_before_it(platoon_of: PlatoonOf, line_up: LineUp) -> None:
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
def test_moving_the_whole_world_changes_no_wheel(
    knots: tuple[np.ndarray, np.ndarray],
    platoon_of: PlatoonOf,
    line_up: LineUp,
    turn: float,
    x: float,
    y: float,
    mirrored: bool,
    track: str,
) -> None:
    """Turned, shifted, or seen in a mirror, which swaps the wheels."""
    c, s = math.cos(turn), math.sin(turn)
    world = np.array([[c, s], [-s, c]])
    if mirrored:
        world = np.diag([1.0, -1.0]) @ world
    at, derivatives = knots
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

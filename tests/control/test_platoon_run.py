"""The closed loop with ideal robots: where the platoon settles, and what a standing robot does to it."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from robofleet.control.path import Path
from tests.control.driven import Platoon

PlatoonOf = Callable[..., Platoon]
Drive = Callable[..., Iterator]  # type: ignore[type-arg]
LineUp = Callable[..., np.ndarray]
D, T, GAMMA, TOP_SPEED = 0.25, 0.6, 0.0455, 0.2


@pytest.fixture(scope="module")
def start(line_up: LineUp) -> np.ndarray:
    """Four robots on the path, turned and off their spacing as in the paper's run."""
    return line_up(np.array([4.0, 3.82, 3.68, 3.5]), np.array([0.1, -0.2, 0.15, 0.25]))


def test_the_leader_converges_to_its_reference(
    platoon_of: PlatoonOf, drive_platoon: Drive, start: np.ndarray, platoon_path: Path
) -> None:
    """x + T x' = r(t+T) leaves the error e with T e' + e = r(t+T) - r - T r', at most T^2/2 sup|r''|."""
    lap = np.linspace(0.0, 4.0, 4000, endpoint=False)
    fastest_turn = np.linalg.norm(platoon_path.second_derivative(lap), axis=1).max() * GAMMA**2
    bound = T**2 / 2 * fastest_turn
    errors = [
        float(np.linalg.norm(m.points[0] - platoon_path.position(GAMMA * m.t)))
        for m in drive_platoon(platoon_of(), start, 88.0)
        if m.t > 5.0
    ]
    assert max(errors) < bound
    assert bound < 0.003


def test_the_spacing_converges(platoon_of: PlatoonOf, drive_platoon: Drive, start: np.ndarray) -> None:
    moments = list(drive_platoon(platoon_of(), start, 88.0))
    assert abs(moments[0].gaps - D).max() > 0.03
    settled = np.array([m.gaps for m in moments if m.t > 5.0])
    assert abs(settled - D).max() < 0.003
    assert abs(settled - D).mean() < 0.0005


def test_tracking_the_centre_puts_the_centre_on_the_path(
    platoon_of: PlatoonOf, drive_platoon: Drive, start: np.ndarray, platoon_path: Path
) -> None:
    def centre_error(track: str) -> float:
        run = drive_platoon(platoon_of(track=track), start, 88.0)
        centres = np.concatenate([m.poses[:, :2] for m in run if m.t > 5.0])
        nearest = platoon_path.position(platoon_path.nearest(centres))
        return float(np.linalg.norm(nearest - centres, axis=1).mean())

    point, centre = centre_error("point"), centre_error("centre")
    assert centre < point / 2
    assert centre < 0.0015


def test_a_reference_never_retreats(
    platoon_of: PlatoonOf, drive_platoon: Drive, line_up: LineUp, platoon_path: Path
) -> None:
    poses = line_up(np.array([0.0, 3.95, 3.86, 3.6]))  # followers far too close: they must wait, not go back
    poses[1, :2] += 0.03
    run = drive_platoon(platoon_of(), poses, 20.0, blocked=lambda t: {0} if 5.0 < t < 10.0 else set())
    references = np.array([m.platoon.reference_parameter.copy() for m in run])
    advance = (np.diff(references, axis=0) + 2.0) % 4.0 - 2.0
    assert advance.min() >= -1e-12
    assert (advance[:, 1:] == 0.0).any(axis=0).all()  # each follower waited at least once


@pytest.mark.parametrize("robot", [0, 1, 2])
def test_nobody_runs_into_a_robot_whose_motors_stall(
    platoon_of: PlatoonOf, drive_platoon: Drive, start: np.ndarray, robot: int
) -> None:
    """Its u is what its wheels can do, so that it is predicted T * top speed ahead at most."""
    run = drive_platoon(platoon_of(), start, 60.0, blocked=lambda t: {robot} if 20.0 < t < 30.0 else set())
    moments = [m for m in run if m.t > 8.0]
    assert np.array([m.gaps for m in moments]).min() > D - T * TOP_SPEED - 0.003
    centres = np.array([m.poses[:, :2] for m in moments])
    assert np.linalg.norm(np.diff(centres, axis=1), axis=2).min() > 0.11
    assert moments[-1].gaps == pytest.approx(np.full(3, D), abs=0.003)  # and the spacing comes back


def test_a_robot_that_must_not_drive_stands_and_its_follower_waits(
    platoon_of: PlatoonOf, drive_platoon: Drive, start: np.ndarray
) -> None:
    def driving(t: float) -> np.ndarray:
        return np.array([True, not 20.0 < t < 30.0, True, True])

    moments = list(drive_platoon(platoon_of(), start, 60.0, driving=driving))
    assert all((m.wheels[1] == 0.0).all() for m in moments if 20.0 < m.t < 30.0)
    waiting = [m for m in moments if 22.0 < m.t < 30.0]
    assert min(m.gaps[1] for m in waiting) > 0.19  # it stopped at once, T * 0.1 m/s short of its prediction
    assert max(np.abs(m.wheels[2]).max() for m in waiting[-60:]) < 0.01
    assert moments[-1].gaps == pytest.approx(np.full(3, D), abs=0.003)

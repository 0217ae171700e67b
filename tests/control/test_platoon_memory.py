"""What a platoon remembers from tick to tick, and when it forgets."""

from collections.abc import Callable

import numpy as np
import pytest

from robofleet.control.path import Path
from tests.control.driven import Platoon

PlatoonOf = Callable[..., Platoon]
LineUp = Callable[..., np.ndarray]
D, T = 0.25, 0.6
TWO = np.ones(2, dtype=np.bool_)


def is_behind_the_first(platoon: Platoon, path: Path, poses: np.ndarray) -> bool:
    """Tell whether the follower's reference is D behind the nearest point to its predecessor's prediction."""
    heading = np.array([np.cos(poses[0, 2]), np.sin(poses[0, 2])])
    predicted = poses[0, :2] + 0.08 * heading + T * platoon.u[0]
    expected = path.back(path.nearest(predicted[None]), D)[0]
    return abs((platoon.reference_parameter[1] - expected + 2.0) % 4.0 - 2.0) < 1e-6


def test_a_carried_robot_is_found_again(platoon_of: PlatoonOf, line_up: LineUp, platoon_path: Path) -> None:
    platoon = platoon_of(2)
    here, other = line_up(np.array([0.5, 0.3])), line_up(np.array([1.8, 0.3]))
    platoon.tick(10.0, here, TWO)
    assert is_behind_the_first(platoon, platoon_path, here)
    platoon.tick(10.0, other, TWO)
    assert not is_behind_the_first(platoon, platoon_path, other)  # it is looked for where it was
    platoon.carried(0)
    platoon.tick(10.0, other, TWO)
    assert is_behind_the_first(platoon, platoon_path, other)


def test_the_follower_of_a_robot_on_a_crossing_keeps_to_its_branch(
    platoon_of: PlatoonOf, line_up: LineUp, figure_eight: Path
) -> None:
    platoon = platoon_of(2, path=figure_eight, path_rate=0.1)
    for sigma in np.linspace(3.4, 4.6, 121):
        poses = line_up(np.array([sigma, sigma - 0.3]), path=figure_eight)
        side = np.array([-np.sin(poses[0, 2]), np.cos(poses[0, 2])])
        poses[0, :2] += 0.02 * side
        platoon.u[:] = 0.0
        platoon.tick((sigma - 0.06) / 0.1, poses, TWO)
        behind = figure_eight.back(np.array([sigma]), D)[0]
        assert platoon.reference_parameter[1] == pytest.approx(behind, abs=0.15)


def test_a_new_run_begins_as_the_first(platoon_of: PlatoonOf, line_up: LineUp) -> None:
    platoon, poses = platoon_of(2), line_up(np.array([0.5, 0.3]))
    first = platoon.tick(0.0, poses, TWO).copy()
    for k in range(100):
        platoon.tick(k * 0.033, line_up(np.array([2.5, 2.3])), TWO)
    platoon.restart()
    assert np.array_equal(platoon.tick(0.0, poses, TWO), first)


def test_a_run_that_begins_on_the_lap_goes_on_from_there_and_one_at_the_paths_beginning_begins_there(
    platoon_of: PlatoonOf, line_up: LineUp, platoon_path: Path
) -> None:
    begun, n = platoon_of(2), len(platoon_path.coefficients)
    for leader in (0.0, 0.05, 1.5, n - 0.5):
        begun.restart()
        begun.tick(0.0, line_up(np.array([leader, (leader - 0.3) % n])), TWO)
        ahead = (begun.reference_parameter[0] - (leader if leader > 0.1 else 0.0)) % n
        assert ahead == pytest.approx(0.0455 * T, abs=0.01)

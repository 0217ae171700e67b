"""The path goes through its knots, closed and smooth."""

from collections.abc import Callable

import numpy as np
import pytest

from robofleet.control.path import Path


def test_it_interpolates_knots_and_derivatives(platoon_path: Path, knots: tuple[np.ndarray, np.ndarray]) -> None:
    at, derivatives = knots
    corners = np.arange(4.0)
    assert platoon_path.position(corners) == pytest.approx(at, abs=1e-12)
    assert platoon_path.derivative(corners) == pytest.approx(derivatives, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_closed_and_its_derivative_continuous(any_path: Callable[[int], Path], seed: int) -> None:
    path, step = any_path(seed), 1e-9
    joints = np.arange(path.sides + 1.0)
    assert path.position(joints - step) == pytest.approx(path.position(joints + step), abs=1e-7)
    assert path.derivative(joints - step) == pytest.approx(path.derivative(joints + step), abs=1e-6)
    sigma = np.linspace(-7.0, 7.0, 41)
    assert path.position(sigma + path.sides) == pytest.approx(path.position(sigma), abs=1e-12)


def test_derivatives_are_derivatives(any_path: Callable[[int], Path]) -> None:
    path, h = any_path(3), 1e-5
    sigma = np.arange(path.sides)[:, None] + np.linspace(0.01, 0.99, 30)
    difference = (path.position(sigma + h) - path.position(sigma - h)) / (2 * h)
    assert path.derivative(sigma) == pytest.approx(difference, abs=1e-7)
    difference = (path.derivative(sigma + h) - path.derivative(sigma - h)) / (2 * h)
    assert path.second_derivative(sigma) == pytest.approx(difference, abs=1e-6)
    tangent = path.tangent(sigma)
    assert np.linalg.norm(tangent, axis=-1) == pytest.approx(1.0)
    along = (tangent * path.derivative(sigma)).sum(axis=-1)
    assert along == pytest.approx(np.linalg.norm(path.derivative(sigma), axis=-1))


def test_length_is_that_of_a_fine_polygon(platoon_path: Path, figure_eight: Path) -> None:
    for path in (platoon_path, figure_eight):
        corners = path.position(np.linspace(0.0, path.sides, 100_001))
        polygon = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
        assert path.length() == pytest.approx(polygon, rel=1e-7)


def test_the_platoons_path_is_the_papers(platoon_path: Path) -> None:
    """Clockwise, never at a standstill, with the highest speeds about 10 s and 54 s into the lap."""
    sigma = np.linspace(0.0, 4.0, 4001)[:-1]
    r, derivative = platoon_path.position(sigma), platoon_path.derivative(sigma)
    area = (r[:, 0] * derivative[:, 1] - r[:, 1] * derivative[:, 0]).mean() * 4 / 2
    assert area < 0.0
    speed = 0.0455 * np.linalg.norm(derivative, axis=1)
    assert speed.min() > 0.02
    first, second = speed[:2000].argmax(), 2000 + speed[2000:].argmax()
    assert sigma[first] / 0.0455 == pytest.approx(9.5, abs=2.0)
    assert sigma[second] / 0.0455 == pytest.approx(54.0, abs=2.0)

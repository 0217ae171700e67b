"""Closed paths: their shape, the nearest point, exact and faithful to its branch, and the first at a distance back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.path import Path
from tests.control.driven import FIGURE_EIGHT, KNOTS, PLATOON_PATH, any_path


def test_it_interpolates_knots_and_derivatives() -> None:
    at, derivatives = KNOTS
    corners = np.arange(4.0)
    assert PLATOON_PATH.position(corners) == pytest.approx(at, abs=1e-12)
    assert PLATOON_PATH.derivative(corners) == pytest.approx(derivatives, abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_closed_and_its_derivative_continuous(seed: int) -> None:
    path, step = any_path(seed), 1e-9
    joints = np.arange(path.sides + 1.0)
    assert path.position(joints - step) == pytest.approx(path.position(joints + step), abs=1e-7)
    assert path.derivative(joints - step) == pytest.approx(path.derivative(joints + step), abs=1e-6)
    sigma = np.linspace(-7.0, 7.0, 41)
    assert path.position(sigma + path.sides) == pytest.approx(path.position(sigma), abs=1e-12)


def test_derivatives_are_derivatives() -> None:
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


def test_length_is_that_of_a_fine_polygon() -> None:
    for path in (PLATOON_PATH, FIGURE_EIGHT):
        corners = path.position(np.linspace(0.0, path.sides, 100_001))
        polygon = np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()
        assert path.length() == pytest.approx(polygon, rel=1e-7)


def test_the_platoons_path_is_the_papers() -> None:
    """Clockwise, never at a standstill, with the highest speeds about 10 s and 54 s into the lap."""
    sigma = np.linspace(0.0, 4.0, 4001)[:-1]
    r, derivative = PLATOON_PATH.position(sigma), PLATOON_PATH.derivative(sigma)
    area = (r[:, 0] * derivative[:, 1] - r[:, 1] * derivative[:, 0]).mean() * 4 / 2
    assert area < 0.0
    speed = 0.0455 * np.linalg.norm(derivative, axis=1)
    assert speed.min() > 0.02
    first, second = speed[:2000].argmax(), 2000 + speed[2000:].argmax()
    assert sigma[first] / 0.0455 == pytest.approx(9.5, abs=2.0)
    assert sigma[second] / 0.0455 == pytest.approx(54.0, abs=2.0)


def smallest_distance(path: Path, q: np.ndarray) -> float:
    """Return the distance of q from the path by the roots of every side's quintic, numpy's way."""
    best = np.inf
    for c in path.coefficients:
        x, y = np.polynomial.Polynomial(c[:, 0]) - q[0], np.polynomial.Polynomial(c[:, 1]) - q[1]
        squared = x * x + y * y
        roots = squared.deriv().roots()
        real = roots.real[np.abs(roots.imag) < 1e-4]  # a double root may split
        inside = real[(real > 0.0) & (real < 1.0)]
        best = min(best, squared(np.concatenate([inside, [0.0, 1.0]])).min())
    return float(np.sqrt(max(best, 0.0)))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("seed", range(6))
def test_whole_search_is_exact_on_any_path(seed: int) -> None:
    path = any_path(seed)
    points = np.random.default_rng(100 + seed).uniform(-1.5, 1.5, (50, 2))
    found = path.nearest(points)
    assert ((found >= 0.0) & (found < path.sides)).all()
    for q, sigma in zip(points, found, strict=True):
        distance = float(np.linalg.norm(path.position(sigma) - q))
        assert distance == pytest.approx(smallest_distance(path, q), abs=1e-9)


def test_the_distance_is_orthogonal_to_the_platoons_path() -> None:
    points = np.random.default_rng(7).uniform((-1.6, -1.0), (1.6, 1.0), (300, 2))
    sigma = PLATOON_PATH.nearest(points)
    away = points - PLATOON_PATH.position(sigma)
    assert (away * PLATOON_PATH.tangent(sigma)).sum(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_a_point_of_the_path_is_its_own_nearest() -> None:
    sigma = np.concatenate([np.linspace(0.0, 3.999, 173), np.arange(4.0)])
    found = PLATOON_PATH.nearest(PLATOON_PATH.position(sigma))
    assert (found - sigma + 2.0) % 4.0 - 2.0 == pytest.approx(0.0, abs=1e-7)


def test_warm_start_searches_half_a_side_and_no_further() -> None:
    points = np.random.default_rng(8).uniform((-1.6, -1.0), (1.6, 1.0), (200, 2))
    near = np.random.default_rng(9).uniform(0.0, 4.0, 200)
    found = PLATOON_PATH.nearest(points, near)
    assert np.abs((found - near + 2.0) % 4.0 - 2.0).max() <= 0.5 + 1e-12
    offsets = np.linspace(-0.5, 0.5, 2001)
    samples = PLATOON_PATH.position(near[:, None] + offsets)
    sampled = np.linalg.norm(samples - points[:, None], axis=2).min(axis=1)
    distance = np.linalg.norm(PLATOON_PATH.position(found) - points, axis=1)
    assert (distance <= sampled + 1e-12).all()
    assert (distance >= sampled - 1e-3).all()


def test_warm_start_stays_on_its_branch_where_the_path_crosses_itself() -> None:
    path = FIGURE_EIGHT
    assert path.position(0.0) == pytest.approx(path.position(4.0), abs=1e-12)
    sigma = np.linspace(3.5, 4.5, 201)
    left = path.tangent(sigma) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    points = path.position(sigma) + 0.02 * left  # beside the path by 2 cm, through the crossing
    warm, near = [], np.array([3.5])
    for q in points:
        near = path.nearest(q[None], near)
        warm.append(near[0])
    assert np.array(warm) == pytest.approx(sigma, abs=0.1)
    jumped = np.abs((path.nearest(points) - sigma + 4.0) % 8.0 - 4.0) > 1.0
    assert jumped.any()


def test_a_warm_start_out_of_reach_is_mended_by_a_whole_search() -> None:
    q = PLATOON_PATH.position(np.array([2.3]))
    assert PLATOON_PATH.nearest(q, np.array([0.1]))[0] == pytest.approx(0.6)  # the end of what is searched
    assert PLATOON_PATH.nearest(q)[0] == pytest.approx(2.3)


def away(path: Path, sigma: float, parameters: np.ndarray) -> np.ndarray:
    """Return the distances of points of the path from r(sigma) [m]."""
    return np.linalg.norm(path.position(parameters) - path.position(sigma), axis=-1)


@pytest.mark.slow
def test_the_whole_lap_is_searched() -> None:
    """Also the rest of the side on which it began."""
    for seed in range(60):
        path = any_path(seed)
        lap = np.linspace(0.0, path.sides, 2001)
        for sigma in np.linspace(0.0, path.sides, 23):
            distances = away(path, float(sigma), lap)
            tau = path.back(np.array([sigma]), 0.999 * distances.max())[0]
            assert away(path, float(sigma), np.array([tau]))[0] == pytest.approx(0.999 * distances.max())


@settings(deadline=None, derandomize=True)
@given(st.integers(0, 40), st.floats(0.0, 1.0, exclude_max=True), st.floats(0.02, 1.5))
def test_it_is_the_first_and_at_the_distance(seed: int, fraction: float, distance: float) -> None:
    path = any_path(seed)
    sigma = fraction * path.sides
    tau = float(path.back(np.array([sigma]), distance)[0])
    samples = sigma - np.linspace(0.0, path.sides, 4001)
    reached = away(path, sigma, samples)
    if np.isnan(tau):
        assert reached.max() < distance
        return
    assert 0.0 <= tau < path.sides
    assert away(path, sigma, np.array([tau]))[0] == pytest.approx(distance, abs=1e-9)
    gone = (sigma - tau) % path.sides
    before = reached[np.linspace(0.0, path.sides, 4001) < gone - 1e-9]
    assert (before < distance + 1e-9).all()


def test_it_goes_back_and_wraps() -> None:
    tau = PLATOON_PATH.back(np.array([0.05, 1.05, 2.5]), 0.25)
    assert 3.5 < tau[0] < 4.0
    assert 0.5 < tau[1] < 1.05
    assert 2.0 < tau[2] < 2.5


def test_a_knot_is_no_different() -> None:
    beside = PLATOON_PATH.back(np.array([1.0 - 1e-9, 1.0, 1.0 + 1e-9]), 0.25)
    assert beside == pytest.approx(np.full(3, beside[1]), abs=1e-7)
    first = PLATOON_PATH.back(np.array([0.0, 4.0, 1e-12]), 0.25)
    assert first[:2] == pytest.approx([first[2]] * 2)


def test_a_path_that_is_too_small_has_no_such_point() -> None:
    lap = np.linspace(0.0, 4.0, 40_001)
    for sigma in (0.0, 0.7, 1.5, 3.99):
        farthest = away(PLATOON_PATH, sigma, lap).max()
        assert np.isnan(PLATOON_PATH.back(np.array([sigma]), farthest + 1e-6)[0])
        assert np.isfinite(PLATOON_PATH.back(np.array([sigma]), farthest - 1e-6)[0])

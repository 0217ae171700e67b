"""The nearest point of a path: exact, and faithful to its branch."""

from collections.abc import Callable

import numpy as np
import pytest

from robofleet.control.path import Path


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


@pytest.mark.parametrize("seed", range(6))
def test_whole_search_is_exact_on_any_path(any_path: Callable[[int], Path], seed: int) -> None:
    path = any_path(seed)
    points = np.random.default_rng(100 + seed).uniform(-1.5, 1.5, (50, 2))
    found = path.nearest(points)
    assert ((found >= 0.0) & (found < path.sides)).all()
    for q, sigma in zip(points, found, strict=True):
        distance = float(np.linalg.norm(path.position(sigma) - q))
        assert distance == pytest.approx(smallest_distance(path, q), abs=1e-9)


def test_the_distance_is_orthogonal_to_the_platoons_path(platoon_path: Path) -> None:
    points = np.random.default_rng(7).uniform((-1.6, -1.0), (1.6, 1.0), (300, 2))
    sigma = platoon_path.nearest(points)
    away = points - platoon_path.position(sigma)
    assert (away * platoon_path.tangent(sigma)).sum(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_a_point_of_the_path_is_its_own_nearest(platoon_path: Path) -> None:
    sigma = np.concatenate([np.linspace(0.0, 3.999, 173), np.arange(4.0)])
    found = platoon_path.nearest(platoon_path.position(sigma))
    assert (found - sigma + 2.0) % 4.0 - 2.0 == pytest.approx(0.0, abs=1e-7)


def test_warm_start_searches_half_a_side_and_no_further(platoon_path: Path) -> None:
    points = np.random.default_rng(8).uniform((-1.6, -1.0), (1.6, 1.0), (200, 2))
    near = np.random.default_rng(9).uniform(0.0, 4.0, 200)
    found = platoon_path.nearest(points, near)
    assert np.abs((found - near + 2.0) % 4.0 - 2.0).max() <= 0.5 + 1e-12
    offsets = np.linspace(-0.5, 0.5, 2001)
    samples = platoon_path.position(near[:, None] + offsets)
    sampled = np.linalg.norm(samples - points[:, None], axis=2).min(axis=1)
    distance = np.linalg.norm(platoon_path.position(found) - points, axis=1)
    assert (distance <= sampled + 1e-12).all()
    assert (distance >= sampled - 1e-3).all()


def test_warm_start_stays_on_its_branch_where_the_path_crosses_itself(figure_eight: Path) -> None:
    path = figure_eight
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


def test_a_warm_start_out_of_reach_is_mended_by_a_whole_search(platoon_path: Path) -> None:
    q = platoon_path.position(np.array([2.3]))
    assert platoon_path.nearest(q, np.array([0.1]))[0] == pytest.approx(0.6)  # the end of what is searched
    assert platoon_path.nearest(q)[0] == pytest.approx(2.3)

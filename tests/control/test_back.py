"""The first point at a distance, going back along the path."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.path import Path


def away(path: Path, sigma: float, parameters: np.ndarray) -> np.ndarray:
    """Return the distances of points of the path from r(sigma) [m]."""
    return np.linalg.norm(path.position(parameters) - path.position(sigma), axis=-1)


def test_the_whole_lap_is_searched(any_path: Callable[[int], Path]) -> None:
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
def test_it_is_the_first_and_at_the_distance(
    any_path: Callable[[int], Path], seed: int, fraction: float, distance: float
) -> None:
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


def test_it_goes_back_and_wraps(platoon_path: Path) -> None:
    tau = platoon_path.back(np.array([0.05, 1.05, 2.5]), 0.25)
    assert 3.5 < tau[0] < 4.0
    assert 0.5 < tau[1] < 1.05
    assert 2.0 < tau[2] < 2.5


def test_a_knot_is_no_different(platoon_path: Path) -> None:
    beside = platoon_path.back(np.array([1.0 - 1e-9, 1.0, 1.0 + 1e-9]), 0.25)
    assert beside == pytest.approx(np.full(3, beside[1]), abs=1e-7)
    assert platoon_path.back(np.array([0.0, 4.0]), 0.25) == pytest.approx([beside_zero(platoon_path)] * 2)


def beside_zero(path: Path) -> float:
    return float(path.back(np.array([1e-12]), 0.25)[0])


def test_a_path_that_is_too_small_has_no_such_point(platoon_path: Path) -> None:
    lap = np.linspace(0.0, 4.0, 40_001)
    for sigma in (0.0, 0.7, 1.5, 3.99):
        farthest = away(platoon_path, sigma, lap).max()
        assert np.isnan(platoon_path.back(np.array([sigma]), farthest + 1e-6)[0])
        assert np.isfinite(platoon_path.back(np.array([sigma]), farthest - 1e-6)[0])

"""The grid finds whom a search among all finds."""

import math

import numpy as np
import pytest

from robofleet.safety.neighbours import around, sorted_into_cells


@pytest.mark.parametrize("reach", [0.0, 0.1, 0.5, 3.0, math.inf, math.nan])
@pytest.mark.parametrize("odd", [(), (1e100,), (math.inf,), (math.nan,)])
def test_the_grid_finds_whom_a_search_among_all_finds(reach: float, odd: tuple[float, ...]) -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 5, 60):
        for size in (0.0, 1.0, 4.0):
            points, present = rng.uniform(-size, size, (n, 2)), rng.random(n) < 0.9
            points[::3] = np.round(2.0 * points[::3]) / 2.0  # some on the cells' edges, some in one place
            points[: len(odd), 1], present[0] = odd, True
            _compare(points, present, reach, exact=bool(np.isfinite(points[present]).all()) and math.isfinite(reach))


def _compare(points: np.ndarray, present: np.ndarray, reach: float, *, exact: bool) -> None:
    found = np.empty(len(points), dtype=np.int64)
    with np.errstate(invalid="ignore"):  # uncompiled, the kernel's infinities and NaN would warn, too
        grid = sorted_into_cells(points, present, reach)
        for i, point in enumerate(points):
            others = present & (np.arange(len(points)) != i)
            near = others & (np.hypot(*(points - point).T) <= reach) if exact else others
            assert found[: around(grid, points, i, found)].tolist() == np.flatnonzero(near).tolist()


def test_in_a_large_fleet_few_are_looked_at() -> None:
    points = np.random.default_rng(1).uniform(-10.0, 10.0, (1000, 2))
    grid, found = sorted_into_cells(points, np.ones(1000, dtype=np.bool_), 0.3), np.empty(1000, dtype=np.int64)
    assert len(grid.first) > 900
    assert max(around(grid, points, i, found) for i in range(1000)) < 12

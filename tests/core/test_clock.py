"""Clocks and the grid of ticks."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS, S, SimulatedClock, TickGrid, WallClock

EXACT = settings(deadline=None, derandomize=True)


def test_a_simulated_clock_moves_only_when_told_to_and_never_back() -> None:
    clock = SimulatedClock()
    assert clock.now_ns() == 0
    clock.advance_to(5 * S)
    clock.advance_to(5 * S)
    assert clock.now_ns() == 5 * S
    with pytest.raises(ValueError, match="cannot go back"):
        clock.advance_to(5 * S - 1)
    assert clock.now_ns() == 5 * S


def test_waiting_on_a_simulated_clock_is_an_error_unless_the_instant_has_come() -> None:
    clock = SimulatedClock()
    clock.advance_to(S)
    clock.sleep_until(S)
    clock.sleep_until(0, precise=True)
    with pytest.raises(RuntimeError, match="tried to wait"):
        clock.sleep_until(S + 1)


@pytest.mark.parametrize("precise", [False, True])
def test_a_wall_clock_never_wakes_too_early(precise: bool) -> None:
    clock = WallClock()
    for wait_ns in (0, 200_000, 3 * MS):
        instant = clock.now_ns() + wait_ns
        clock.sleep_until(instant, precise=precise)
        assert instant <= clock.now_ns() < instant + 2 * S
    clock.sleep_until(clock.now_ns() - S)  # what is past needs no waiting


@EXACT
@given(st.integers(0, 10**18), st.integers(1, 10**9), st.integers(0, 10**6))
def test_an_instant_of_the_grid_is_its_own_tick(origin: int, period: int, index: int) -> None:
    grid = TickGrid(origin, period)
    assert grid.index_at(grid.instant(index)) == index
    assert grid.index_at(grid.instant(index) - 1) == index - 1  # not yet due
    assert grid.instant(index + 1) - grid.instant(index) == period  # ticks do not drift


@EXACT
@given(st.integers(0, 10**18), st.integers(1, 10**9), st.integers(-(10**15), 10**15))
def test_the_newest_tick_that_is_due(origin: int, period: int, after: int) -> None:
    grid, now = TickGrid(origin, period), origin + after
    index = grid.index_at(now)
    assert grid.instant(index) <= now < grid.instant(index + 1)

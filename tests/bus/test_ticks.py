"""Following the controller's ticks on another clock."""

from collections.abc import Callable

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TICK
from robofleet.bus.messages import TICK_RECORD, TickRecord
from robofleet.bus.ticks import TickFollower
from robofleet.core.clock import MS, SimulatedClock

PERIOD, ORIGIN, OTHER_CLOCK = 33 * MS, 700 * MS, 10**15
MakeBus = Callable[[int], MemoryBus]


def record(tick: int) -> bytes:
    stamp = OTHER_CLOCK + tick * PERIOD  # of a clock that has nothing to do with this one
    return TICK_RECORD.encode(TickRecord(1, 1, tick, 0, stamp, *[0] * 6, 2, 0, 0, 0, 0, (), ()))


@pytest.fixture
def follower(memory_bus: MakeBus) -> tuple[TickFollower, Callable[[bytes], None], list[int]]:
    bus, woken = memory_bus(0), list[int]()
    return TickFollower(bus, PERIOD, woken.append), bus.publisher(TICK), woken


Follower = tuple[TickFollower, Callable[[bytes], None], list[int]]


def test_the_least_delayed_record_tells_where_the_grid_is(follower: Follower, clock: SimulatedClock) -> None:
    ticks, publish, woken = follower
    publish(b"\1 not a tick")
    ticks.update()
    assert ticks.newest == 0
    delays = np.random.default_rng(1).integers(0.3 * MS, 9 * MS, 50)
    for tick, delay in enumerate(delays.tolist(), start=1):
        clock.advance_to(ORIGIN + tick * PERIOD + delay)
        publish(record(tick))
        ticks.update()
        assert ticks.newest == tick
        assert ticks.newest_stamp_ns == OTHER_CLOCK + tick * PERIOD
        assert ticks.instant(tick) == ORIGIN + tick * PERIOD + delays[:tick].min()
    assert len(woken) == 51
    assert ticks.instant(1000) - ticks.instant(0) == 1000 * PERIOD


def test_the_nearest_tick(follower: Follower, clock: SimulatedClock) -> None:
    ticks, publish, _ = follower
    clock.advance_to(ORIGIN + 5 * PERIOD)
    publish(record(5))
    ticks.update()
    for tick in (4, 5, 6, 200):
        for off in (-PERIOD // 2 + 1, -1, 0, 1, PERIOD // 2 - 1):
            assert ticks.nearest(ORIGIN + tick * PERIOD + off) == tick


def test_a_slower_grid_is_found_after_a_while(follower: Follower, clock: SimulatedClock) -> None:
    """The other clock runs 100 ppm slow: an old record that was early must not hold the place for ever."""
    ticks, publish, _ = follower
    drift = 3300  # ns a tick
    for tick in range(1, 400):
        clock.advance_to(ORIGIN + tick * (PERIOD + drift))
        publish(record(tick))
        ticks.update()
    error = ORIGIN + 399 * (PERIOD + drift) - ticks.instant(399)
    assert 0 <= error < 64 * drift


def test_another_controller_starts_another_grid(follower: Follower, clock: SimulatedClock) -> None:
    ticks, publish, _ = follower
    clock.advance_to(ORIGIN + 900 * PERIOD)
    publish(record(900))
    ticks.update()
    later = ORIGIN + 1000 * PERIOD + 11 * MS
    clock.advance_to(later)
    publish(record(1))
    ticks.update()
    assert ticks.newest == 1
    assert ticks.instant(1) == later


def test_a_run_begins_where_its_first_tick_was(follower: Follower) -> None:
    """Whichever of its records comes first; a hold does not begin it anew, another run does."""
    ticks, publish, _ = follower

    def say(tick: int, run_tick: int) -> int:
        stamp_ns = OTHER_CLOCK + tick * PERIOD
        publish(TICK_RECORD.encode(TickRecord(1, 1, tick, run_tick, stamp_ns, *[0] * 6, 2, 0, 0, 0, 0, (), ())))
        ticks.update()
        return (ticks.began_ns - OTHER_CLOCK) // PERIOD if ticks.began_ns else 0

    assert say(10, -1) == 0
    assert say(23, 2) == 21
    assert say(24, -1) == 21
    assert say(60, 3) == 21
    assert say(90, 0) == 90

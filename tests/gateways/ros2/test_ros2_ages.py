"""Ages of messages whose sender has a clock of its own."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.core.clock import MS, S
from robofleet.gateways.ros2.velocities import UNKNOWN_NS, Ages

PERIOD_NS = 30 * MS
WAYS = st.lists(st.integers(0, 100 * MS), min_size=1, max_size=60)
SLOW = st.lists(st.integers(0, 5 * S), min_size=1, max_size=60)
SECOND = S // PERIOD_NS + 1  # messages


def told(count: int, way_ns: Callable[[int], int] = lambda _: MS, clock_ns: Callable[[int], int] = lambda _: 0,
         ages: Ages | None = None) -> list[int]:  # fmt: skip
    """Return the ages of messages, by their numbers: how long each took, and by how much its sender's clock is off."""
    ages = ages or Ages()
    return [ages.age_ns(S + k * PERIOD_NS + clock_ns(k), S + k * PERIOD_NS + way_ns(k)) for k in range(count)]


@given(WAYS, st.integers(-(10**18), 10**18))
def test_an_age_is_what_a_message_took_longer_than_the_fastest_so_far(ways_ns: list[int], offset_ns: int) -> None:
    """However far the sender's clock is from ours; but for the drift that clocks may have."""
    for k, age_ns in enumerate(told(len(ways_ns), ways_ns.__getitem__, lambda _: offset_ns)):
        longer_ns = ways_ns[k] - min(ways_ns[: k + 1])
        assert longer_ns - 1e-4 * (k * PERIOD_NS + 5 * S) <= age_ns <= longer_ns


@given(SLOW)
def test_no_message_is_younger_than_the_shortest_way_makes_it(slow_ns: list[int]) -> None:
    """Which one message took before."""
    for way_ns, age_ns in zip(slow_ns, told(len(slow_ns) + 1, [MS, *slow_ns].__getitem__)[1:], strict=True):
        assert age_ns >= way_ns - 2 * MS


def test_a_way_that_becomes_slow_and_stays_so_makes_every_message_old() -> None:
    assert all(age_ns > 1.9 * S for age_ns in told(1000, lambda k: MS if k < 10 else 2 * S)[10:])


def test_what_a_stopped_process_finds_when_it_goes_on_is_old() -> None:
    ages = Ages()
    assert set(told(50, ages=ages)) == {0}
    assert ages.age_ns(S + 50 * PERIOD_NS, S + 50 * PERIOD_NS + 3 * S) > 2.9 * S


def test_clocks_that_drift_apart_make_no_message_old() -> None:
    """For an hour."""
    for drift in (-50, 50):  # millionths
        assert max(told(120_000, clock_ns=lambda k, d=drift: k * PERIOD_NS * d // 1_000_000)) < MS


@pytest.mark.parametrize("set_ns", [-S, S])
def test_a_clock_that_is_set_makes_messages_old_for_a_second(set_ns: int) -> None:
    """Back or forward: nobody knows how long a message is on its way then. Its robot stands, and drives on."""
    ages = told(10 + 2 * SECOND, clock_ns=lambda k: set_ns if k >= 10 else 0)
    assert set(ages[:10]) == {0} and min(ages[10 : 9 + SECOND]) >= S
    assert set(ages[10 + SECOND :]) == {0}


def test_a_clock_that_is_set_forward_while_the_way_is_slow_makes_no_message_young() -> None:
    ages = told(10 + 2 * SECOND, lambda k: 2 * S if 10 <= k < SECOND else MS, lambda k: 5 * S if k >= 10 else 0)
    assert min(ages[10 : 9 + SECOND]) > S and ages[-1] == 0


def test_of_two_senders_that_alternate_with_clocks_that_differ_none_is_believed() -> None:
    assert set(told(100, clock_ns=lambda k: 5 * S * (k % 2))[2:]) == {UNKNOWN_NS}


@pytest.mark.parametrize("off_ns", [-5 * S, 0, 5 * S])
def test_the_next_sender_is_believed_once_its_clock_is_known(off_ns: int) -> None:
    """At once where it is the same clock."""
    ages = Ages()
    told(10, ages=ages)
    ages.expect_another()
    after = [ages.age_ns(60 * S + off_ns + k * PERIOD_NS, 60 * S + MS + k * PERIOD_NS) for k in range(2 * SECOND)]
    assert after[0] == (UNKNOWN_NS if off_ns else 0) and after[-1] == 0

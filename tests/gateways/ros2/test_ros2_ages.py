"""Ages of messages whose sender has a clock of its own."""

from hypothesis import given
from hypothesis import strategies as st

from robofleet.clock import MS, S
from robofleet.gateways.ros2.ages import Ages

WAYS = st.lists(st.integers(0, 2 * S), min_size=1, max_size=60)


@given(WAYS, st.integers(-(10**18), 10**18))
def test_an_age_is_what_a_message_took_longer_than_the_fastest_so_far(ways_ns: list[int], offset_ns: int) -> None:
    """However far the sender's clock is from ours."""
    ages, sent_ns = Ages(), 0
    for k, way_ns in enumerate(ways_ns):
        sent_ns += 30 * MS
        assert ages.age_ns(sent_ns + offset_ns, sent_ns + way_ns) == way_ns - min(ways_ns[: k + 1])


def test_what_a_stopped_process_finds_when_it_goes_on_is_old() -> None:
    ages = Ages()
    for k in range(50):
        assert ages.age_ns(k * 30 * MS, k * 30 * MS + MS) == 0
    went_on_ns = 50 * 30 * MS + 3 * S
    assert ages.age_ns(50 * 30 * MS, went_on_ns) > 2.9 * S


def test_a_clock_that_is_set_back_makes_commands_old_until_it_is_known() -> None:
    """Its robot stands for two seconds, and drives on."""
    ages = Ages()
    told = [ages.age_ns(k * 30 * MS - (S if k >= 10 else 0), k * 30 * MS) for k in range(100)]
    assert told[9] == 0 and told[10] == S and told[-1] == 0

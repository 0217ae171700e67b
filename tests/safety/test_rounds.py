"""Rounds of the wiggle: no two robots have the same, and two without room for both are never away at once."""

import math
from itertools import combinations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from robofleet.safety.rounds import rounds, within

ALONG_X = [(0.0, 0.0), (-1.5, 0.1), (1.5, 0.2), (0.0, 0.3)]  # by y, the two nearest are first and last
PLACES = st.lists(st.tuples(*[st.floats(0.0, 1.0)] * 2), min_size=1, max_size=30)


@example(ALONG_X, 1.0)
@example([(y, x) for x, y in ALONG_X], 1.0)
@given(PLACES, st.floats(0.0, 1.5))
def test_who_is_near_whom_is_what_comparing_all_would_say(places: list[tuple[float, float]], reach: float) -> None:
    near = [(a, b) for a, b in combinations(range(len(places)), 2) if math.dist(places[a], places[b]) <= reach]
    assert [*map(tuple, within(np.array(places), reach).tolist())] == near


@given(PLACES, st.floats(0.0, 0.5))
def test_of_any_two_robots_one_moves_while_the_other_stands(places: list[tuple[float, float]], reach: float) -> None:
    close = [(int(a), int(b)) for a, b in within(np.array(places), reach)]
    given_ = rounds(len(places), close)
    assert len(set(given_)) == len(places), "one code for each"
    assert all(0 <= forth < back for forth, back in given_)
    for row, near_row in close:
        first, second = sorted((given_[row], given_[near_row]))
        assert first[1] < second[0], "back before the other one goes"
    assert set(range(max(back for _, back in given_) + 1)) <= {a for pair in given_ for a in pair}, "no idle round"


def test_rounds_are_few() -> None:
    """About the root of twice the robots; four robots of which two are close take as many as four with room."""
    for robots, most in ((1, 2), (2, 3), (4, 4), (20, 7), (100, 15), (1000, 46)):
        assert max(back for _, back in rounds(robots, ())) + 1 == most
    assert max(back for _, back in rounds(4, [(1, 2)])) + 1 == 4
    lattice = np.array([(0.16 * (k % 10), 0.16 * (k // 10)) for k in range(100)])
    assert max(back for _, back in rounds(100, within(lattice, 0.197).tolist())) + 1 <= 24

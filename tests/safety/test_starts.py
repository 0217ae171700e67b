"""Starts that jam and starts that work, told apart before a wheel turns.

The limit is measured, in lockstep, on the shipped platoon with poses without pixels and runs of 45 s: 191 random
starts. In their order with any heading (20) and anywhere along the path in their order (40): all worked, none was
refused. In their order and up to 0.3 m off their places, heading up to 90 degrees off (40): 2 jammed, none was refused.
In a wrong order on their places (51): 33 were refused as ``reason`` does, of which one would have worked; 4 jammed
though accepted. Anywhere on the floor (40): 2 were refused, both jammed; 19 jammed though accepted. Each of those that
jammed though accepted had a warning.
"""

import math
from itertools import permutations

import numpy as np
import pytest

from robofleet.safety.starts import Pose, Ways, judge, reason

RADIUS, SIDES, COUNT, SPACING, AHEAD = 0.8, 4, 400, 0.3, 0.08


def circle() -> Ways:
    """Return a path round a circle, counter-clockwise, for four robots."""
    angle = np.arange(COUNT) * math.tau / COUNT
    back = round(2 * math.asin(SPACING / 2 / RADIUS) / math.tau * COUNT)
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    behind = (np.arange(COUNT) - back) % COUNT
    return Ways(points, behind, SIDES, SPACING, 0.05, 0.6, AHEAD, (0.2,) * 4, (0.055,) * 4)


def on_circle(steps: float, *, outwards: float = 0.0, turned: float = 0.0) -> Pose:
    """Return a pose whose point is on the path, some spacings from its beginning, and heads along it."""
    at = steps * 2 * math.asin(SPACING / 2 / RADIUS)
    psi, r = at + math.pi / 2, RADIUS + outwards
    return r * math.cos(at) - AHEAD * math.cos(psi), r * math.sin(at) - AHEAD * math.sin(psi), psi + turned


IN_ORDER = tuple(on_circle(-k) for k in range(4))


def test_robots_at_their_places_are_there_at_once() -> None:
    judgement = judge(circle(), IN_ORDER)
    assert max(judgement.away_m) < 0.01
    assert judgement.arrived_s == (0.0,) * 4
    assert judgement.through == 0.0
    assert judgement.ordered


@pytest.mark.parametrize("turned", [1.0, math.pi, -2.0])
def test_no_heading_is_refused(turned: float) -> None:
    assert reason(circle(), tuple(on_circle(-k, turned=turned) for k in range(4))) is None


def test_a_gap_is_no_reason_and_takes_its_time() -> None:
    judgement = judge(circle(), tuple(on_circle(-3 * k) for k in range(4)))
    assert not judgement.jams
    assert 0.0 < judgement.arrived_s[1] < judgement.arrived_s[2] < 25.0
    assert judgement.away_m[2] == pytest.approx(2 * RADIUS * math.sin(4 * math.asin(SPACING / 2 / RADIUS)), abs=0.03)


@pytest.mark.parametrize("order", [order for order in permutations(range(4)) if order != (0, 1, 2, 3)])
def test_the_order_along_the_path_is_told(order: tuple[int, ...]) -> None:
    """``order[k]`` stands at place k."""
    poses = tuple(IN_ORDER[order.index(robot)] for robot in range(4))
    assert judge(circle(), poses).order == order


def test_a_reversed_group_jams_and_the_order_that_does_not_is_named() -> None:
    why = reason(circle(), IN_ORDER[::-1])
    assert why is not None
    assert (why.behind, why.other, why.order) == (3, 2, (3, 2, 1, 0))


def test_a_leader_on_its_lap_begins_where_it_stands() -> None:
    """After a hold the law goes on from there, so that nobody is refused for being far from the path's beginning."""
    judgement = judge(circle(), tuple(on_circle(7 - k) for k in range(4)))
    assert max(judgement.away_m) < 0.01
    assert not judgement.jams

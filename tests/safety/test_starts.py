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

from robofleet.safety.starts import MOST_THROUGH, Judgement, Pose, Reason, Ways, judge, reason

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


@pytest.mark.parametrize("lap", [0, 5])
@pytest.mark.parametrize("order", [order for order in permutations(range(4)) if order != (0, 1, 2, 3)])
def test_the_order_along_the_path_is_told(order: tuple[int, ...], lap: int) -> None:
    """``order[k]`` stands at place k."""
    poses = tuple(on_circle(lap - order.index(robot)) for robot in range(4))
    assert judge(circle(), poses).order == order


def test_who_stands_nearly_half_a_lap_ahead_of_the_leader_is_the_foremost() -> None:
    assert judge(circle(), (*IN_ORDER[:3], on_circle(7.9))).order == (3, 0, 1, 2)


def test_a_reversed_group_jams_and_the_order_that_does_not_is_named() -> None:
    why = reason(circle(), IN_ORDER[::-1])
    assert why is not None
    assert (why.behind, why.other, why.order) == (3, 2, (3, 2, 1, 0))


def test_a_leader_on_its_lap_begins_where_it_stands() -> None:
    """After a hold the law goes on from there, so that nobody is refused for being far from the path's beginning."""
    judgement = judge(circle(), tuple(on_circle(7 - k) for k in range(4)))
    assert max(judgement.away_m) < 0.01
    assert judgement.arrived_s == (0.0,) * 4
    assert not judgement.jams


def straight(*, spacing: float = 0.25, rate: float = 0.01, radii: tuple[float, ...] = (0.05,)) -> Ways:
    """Return a path round a square, which begins in the middle of a side of 4 m, along x; its points are 1/256 m apart.

    The robots' points are their centres, and they drive 0.2 m/s, but the second one 0.1 m/s.
    """
    along = np.arange(1024) / 256.0
    right, up = np.stack([along - 2.0, 0.0 * along], axis=1), np.stack([0.0 * along + 2.0, along], axis=1)
    square = np.concatenate([right, up, (0.0, 4.0) - right, (0.0, 4.0) - up])
    behind = (np.arange(4096) - round(spacing * 256)) % 4096
    speeds = (0.2, 0.1, 0.2)[: len(radii)]
    return Ways(np.roll(square, -512, axis=0), behind, 4, spacing, rate, 0.6, 0.0, speeds, radii)


def test_a_robot_arrives_when_it_has_caught_up_with_its_place() -> None:
    """It is 1 m behind, and 0.16 m/s faster; it is there 0.03 m before the 0.12 m that it goes within its horizon.

    Its place is 0.024 m ahead by that horizon: 0.874 m take 5.46 s, of steps of 0.2 s.
    """
    assert judge(straight(spacing=2.25), ((-1.0, 0.0, 0.0),)).arrived_s == (pytest.approx(5.6),)


def test_a_place_that_is_faster_than_its_robot_is_never_reached() -> None:
    assert judge(straight(rate=0.1), ((-0.125, 0.0, 0.0),)).arrived_s == (math.inf,)


@pytest.mark.parametrize(("x", "away"), [(-0.125, 0.125), (0.125, 0.125), (0.126, 0.0), (-0.126, 0.0)])
def test_a_leader_within_half_a_spacing_of_the_paths_beginning_begins_there(x: float, away: float) -> None:
    two = straight(radii=(0.05, 0.05))
    assert judge(two, ((x, 0.0, 0.0), (-0.25, 0.0, 0.0))).away_m[0] == pytest.approx(away, abs=0.002)


def test_robots_at_places_within_each_others_reach_drive_together_all_the_time() -> None:
    """For 31 steps of 0.2 s, at the slower one's speed; the first and the last one are too far apart."""
    judgement = judge(
        straight(spacing=0.125, radii=(0.05, 0.07, 0.05)), tuple((-0.125 * k, 0.0, 0.0) for k in range(3))
    )
    assert judgement.through == pytest.approx(2 * 31 * 0.2 * 0.1 / 0.16)
    assert judgement.pair == (0, 1)


def test_robots_jam_that_drive_more_than_ten_reaches_through_each_other() -> None:
    for through, jams in ((MOST_THROUGH, False), (MOST_THROUGH + 1e-9, True)):
        assert Judgement((0.0,), (0.0,), through, (0, 0), (0,)).jams is jams


@pytest.mark.parametrize("poses", [IN_ORDER, IN_ORDER[::-1]])
def test_robots_that_jam_in_every_order_are_named_without_one(poses: tuple[Pose, ...]) -> None:
    fat = circle()._replace(radii=(0.3,) * 4, speeds=(0.4,) * 4)
    assert reason(fat, poses) == Reason(*judge(fat, poses).pair, None)


def test_an_order_is_judged_with_each_robots_own_size_and_speed() -> None:
    order, large = (2, 3, 1, 0), circle()._replace(radii=(0.3, 0.1, 0.05, 0.2), speeds=(0.4, 0.4, 0.2, 0.4))
    why = reason(large, tuple(IN_ORDER[order.index(robot)] for robot in range(4)))
    assert why is not None
    assert why.order is None, "it would jam, too"


def test_robots_that_follow_a_path_through_its_crossing_stay_on_their_branch() -> None:
    """Else the next robot's place would jump to the other branch, a third of a lap ahead."""
    angle = (np.arange(COUNT) + 2 / 3) * math.tau / COUNT  # a point of the other branch is on the crossing
    radius = 0.5 + np.cos(angle)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    looped = circle()._replace(points=points, behind=(np.arange(COUNT) - 20) % COUNT, ahead=0.0, rate=0.01)
    assert judge(looped, tuple((*points[131 - 20 * k], 0.0) for k in range(4))).arrived_s == (0.0,) * 4

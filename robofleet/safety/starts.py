"""Whether robots can come from where they stand to their places on the path: judged before a wheel turns. Pure.

The law drives each robot's point straight to its place: the leader's place moves along the path, each other robot's is
``spacing`` behind the path's point that is nearest to the robot ahead. Here the points do that as if nobody were in
their way. The barrier lets nobody through: the further two points drive within each other's reach, the surer they jam.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Pose = tuple[float, float, float]

MOST_THROUGH = 10.0  # reaches; measured in lockstep, tests/safety/test_starts.py says how
_LOOK_S, _STEP_S = 25.0, 0.2
_SETTLED_S = 6.0  # all at their places for so long: nobody comes in another's way any more
_ARRIVED_M = 0.03
_ROOM_M = 0.04  # between two bodies that hinder each other
_ANYWHERE = -1  # as an index of the path: not known yet


class Ways(NamedTuple):
    """What is known of a group's path and robots; arrays over K points of the path in the direction of travel."""

    points: Array  # (K, 2), evenly in the path's parameter [m; world]
    behind: NDArray[np.int64]  # (K,) index of the point one spacing behind
    sides: int  # of the path
    spacing: float  # [m]
    rate: float  # of the leader's place [sides/s]
    horizon: float  # how far the law looks ahead [s]
    ahead: float  # of the robot's centre: the point that follows the path [m]
    speeds: tuple[float, ...]  # of each robot, at most [m/s]
    radii: tuple[float, ...]  # of the bodies [m]


class Judgement(NamedTuple):
    """What comes of a start; robots by their numbers in the group."""

    away_m: tuple[float, ...]  # from each robot's point to its place, at first
    arrived_s: tuple[float, ...]  # when each is there to stay; infinite: not within 25 s
    through: float  # how far pairs drive within each other's reach, in reaches: all pairs' together
    pair: tuple[int, int]  # who does so furthest
    order: tuple[int, ...]  # in which they stand along the path, the foremost first

    @property
    def jams(self) -> bool:
        """Whether they will not get past each other."""
        return self.through > MOST_THROUGH

    @property
    def ordered(self) -> bool:
        """Whether they stand in the group's order."""
        return self.order == tuple(range(len(self.order)))


def judge(ways: Ways, poses: tuple[Pose, ...]) -> Judgement:
    """Return what comes of a start from these poses of the centres, in the group's order."""
    pose = np.array(poses)
    at = pose[:, :2] + ways.ahead * np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    n, count, speeds, radii = len(at), len(ways.points), np.array(ways.speeds), np.array(ways.radii)
    reach = radii[:, None] + radii[None, :] + _ROOM_M
    together, arrived = np.zeros((n, n)), np.zeros(n)
    first = _places(ways, at)
    near, waypoint = np.full(n, _ANYWHERE), np.full(n, _ANYWHERE)
    away, order = np.hypot(*(ways.points[first] - at).T), _order(ways, at, int(first[0]))
    for k in range(round(_LOOK_S / _STEP_S)):
        near = _nearest(ways, at, near)
        leads = (first[0] + round(ways.rate * (k * _STEP_S + ways.horizon) * count / ways.sides)) % count
        waypoint = _advanced(waypoint, np.concatenate([[leads], ways.behind[near[:-1]]]), count)
        towards = ways.points[waypoint] - at
        distance = np.hypot(towards[:, 0], towards[:, 1])
        arrived[distance > speeds * ways.horizon + _ARRIVED_M] = (k + 1) * _STEP_S
        if k * _STEP_S > arrived.max() + _SETTLED_S:
            break
        speed = np.minimum(distance / ways.horizon, speeds)
        at = at + towards * (speed * _STEP_S / np.maximum(distance, 1e-9))[:, None]
        between = at[:, None] - at[None]
        together += np.hypot(between[..., 0], between[..., 1]) < reach
    through = np.triu(together * _STEP_S * np.minimum(speeds[:, None], speeds[None, :]) / reach, 1)
    behind, other = divmod(int(through.argmax()), n)
    late = [float(t) if t < _LOOK_S else math.inf for t in arrived]
    return Judgement(tuple(away.tolist()), tuple(late), float(through.sum()), (behind, other), order)


def _places(ways: Ways, at: Array) -> NDArray[np.int64]:
    """Return each robot's place at first: the law begins at the path's beginning, or where its leader stands."""
    begins = math.dist(ways.points[0], at[0]) <= ways.spacing / 2.0
    places = [0 if begins else int(_nearest(ways, at[:1], np.array([_ANYWHERE]))[0])]
    for _ in at[1:]:
        places.append(int(ways.behind[places[-1]]))
    return np.array(places)


def _nearest(ways: Ways, at: Array, near: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the index of the path's point nearest to each robot's, within half a side of ``near``."""
    count = len(ways.points)
    gaps = at[:, None] - ways.points[None]
    squared = gaps[..., 0] ** 2 + gaps[..., 1] ** 2
    beyond = np.abs(_lap(np.arange(count)[None] - near[:, None], count)) > count / ways.sides / 2
    return np.asarray(np.where(beyond & (near[:, None] != _ANYWHERE), np.inf, squared).argmin(axis=1))


def _advanced(before: NDArray[np.int64], waypoint: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the places, none behind where it was before."""
    return np.where((before != _ANYWHERE) & (_lap(waypoint - before, count) < 0), before, waypoint)


def _order(ways: Ways, at: Array, leader: int) -> tuple[int, ...]:
    """Return the robots by where they stand along the path, the foremost first."""
    nearest = _nearest(ways, at, np.full(len(at), _ANYWHERE))
    ahead = _lap(nearest - leader, len(ways.points))
    return tuple(int(i) for i in np.argsort(-ahead, kind="stable"))  # equal ones in the same order on every machine


def _lap(steps: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return steps along the closed path in [-count/2, count/2)."""
    return np.asarray((steps + count // 2) % count - count // 2)


class Reason(NamedTuple):
    """Why a start will jam: two robots by their numbers, and an order that does not jam, if there is one."""

    behind: int
    other: int
    order: tuple[int, ...] | None  # then ``behind`` stands ahead of ``other``, which it is to follow


def reason(ways: Ways, poses: tuple[Pose, ...]) -> Reason | None:
    """Return why a start from these poses will jam; None: nothing says that it will."""
    judgement = judge(ways, poses)
    if not judgement.jams:
        return None
    if judgement.ordered:
        return Reason(*judgement.pair, None)
    order = judgement.order
    exchanged = ways._replace(
        speeds=tuple(ways.speeds[i] for i in order), radii=tuple(ways.radii[i] for i in order)
    )  # fmt: skip
    if judge(exchanged, tuple(poses[i] for i in order)).jams:
        return Reason(*judgement.pair, None)
    first, other = next((a, b) for a, b in pairwise(order) if a > b)
    return Reason(first, other, order)

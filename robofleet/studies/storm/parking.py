"""Bystanders that a storm places beside the robots' ways, and that a simulated hand pushes."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from robofleet.behaviours.interface import Line
from robofleet.config import barrier, groups, slices
from robofleet.config.robots import Robot, StartPose
from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault, PoseFault, Push
from robofleet.core.arrays import Array
from robofleet.core.settings import LAST_TAG
from robofleet.safety.distances import apart, room_m

_SEED_SHARE = 0.4  # of seeds with bystanders
_MOST = 2
_SPARE_M = 0.12  # further from a way than they must, at most
_MARGIN_M = 0.003
_REACH_M = 0.8  # from a start: where a fleet is in the time of a storm
_TRIES = 40
_PUSH_S, _PUSH_M = (0.5, 2.0), 0.15
_PUSHED, _HIDDEN = 0.5, 0.3  # shares of the bystanders


class Parking:
    """Draws bystanders that ``robofleet check`` would accept where they stand, and where a hand leaves them."""

    def __init__(self, config: Config, rng: np.random.Generator, window_s: float) -> None:
        self._config, self._rng, self._window_s = config, rng, window_s
        self._robots: list[Robot] = []
        self._faults: list[InjectedFault] = []

    def draw(self) -> tuple[tuple[Robot, ...], tuple[InjectedFault, ...]]:
        if self._rng.random() < _SEED_SHARE:
            self._lines = _lines(self._config)
            for number in range(1 + int(self._rng.integers(_MOST))):
                self._park(number)
        return tuple(self._robots), tuple(self._faults)

    def _park(self, number: int) -> None:
        like = self._config.members[int(self._rng.integers(len(self._config.members)))]
        places = self._places(like)
        first = next(places, None)
        if first is None:
            return
        robot = self._robot(like, number, first)
        if self._rng.random() < _PUSHED:
            spot = next((at for at in places if self._pushable(like, np.array(first), np.array(at))), None)
            if spot is not None:
                self._push(robot.id, np.array(first), np.array(spot))
        if self._rng.random() < _HIDDEN:
            at_s, duration_s = self._when(0.05, 4.0)
            self._faults.append(PoseFault(kind="pose_dropout", robot=robot.id, at_s=at_s, duration_s=duration_s))
        self._robots.append(robot)

    def _robot(self, like: Robot, number: int, at: tuple[float, float]) -> Robot:
        used = {robot.tag for robot in (*self._config.robots, *self._robots)}
        tag = next(tag for tag in range(LAST_TAG + 1) if tag not in used)
        heading = float(self._rng.uniform(-180.0, 180.0))
        start = StartPose(x_m=at[0], y_m=at[1], heading_deg=round(heading, 1))
        plain: dict[str, Any] = {"driver": "simulated", "settings": {}, "twin": None, "calibration": None}
        return like.model_copy(update={"id": f"parked{number + 1}", "tag": tag, "start": start, **plain})

    def _places(self, like: Robot) -> Iterator[tuple[float, float]]:
        """Yield places beside the robots' ways where such a robot may stand."""
        away = self._near(like) + _SPARE_M * self._rng.random(_TRIES)
        sides, ways = self._rng.choice((-1.0, 1.0), _TRIES) * away, self._rng.choice(self._ways(), _TRIES)
        beside = ways[:, :2] + sides[:, None] * np.column_stack([-ways[:, 3], ways[:, 2]])
        places = [(round(x, 4), round(y, 4)) for x, y in beside.tolist() if self._free(like, np.array((x, y)))]
        yield from self._accepted(like, places)

    def _ways(self) -> Array:
        """Return points of the robots' ways near their starts (K, 4): x, y [m], and the way's direction there."""
        starts = np.array([slices.start_pose(robot) for robot in self._config.members])
        near = np.hypot(*(self._lines[:, None, :2] - starts[None, :, :2]).transpose(2, 0, 1)).min(axis=1) < _REACH_M
        return self._lines[near] if near.any() else _headed(starts)

    def _accepted(self, like: Robot, places: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """Return the places at which every behaviour accepts such a robot: all are judged at once."""
        body, refused = barrier.body(self._config, like), set()
        parked = tuple((f"parked.{k}", body, (*at, 0.0)) for k, at in enumerate(places))
        for group in self._config.groups:
            behaviour = groups.made(group, replace(groups.team(self._config, group), bystanders=parked))
            refused |= {bound.path for bound in behaviour.bounds() if not bound.holds}
        return [at for at, (name, _, _) in zip(places, parked, strict=True) if f"{name}.start" not in refused]

    def _near(self, like: Robot) -> float:
        config = self._config
        body, keepout = barrier.body(config, like), barrier.keepout(config)
        return max(apart(keepout, barrier.body(config, robot), body) for robot in config.members) + _MARGIN_M

    def _free(self, like: Robot, at: Array) -> bool:
        """Return whether a robot may stand there: inside, clear of the ways, of the starts and of the others."""
        radius, half = like.vehicle.body_radius_m, np.array(self._config.arena.size_m) / 2
        near = self._near(like) - self._config.controller.point_ahead_m  # ways may be those of the points ahead
        if (np.abs(at) + radius + _MARGIN_M > half).any() or self._off_the_ways(at) < near:
            return False
        for robot in (*self._config.robots, *self._robots):
            room = room_m(slices.drive(robot).wheel_radius) + robot.vehicle.body_radius_m + radius + _PUSH_M
            if math.dist(slices.start_pose(robot)[:2], at) < room:
                return False
        return True

    def _off_the_ways(self, at: Array) -> float:
        return float(np.hypot(*(self._lines[:, :2] - at).T).min(initial=math.inf))

    def _pushable(self, like: Robot, here: Array, target: Array) -> bool:
        """Return whether a hand may push it from one place to another one: straight, and never onto a way."""
        middles = (here + share * (target - here) for share in (0.25, 0.5, 0.75))
        return math.dist(here, target) <= 2 * _PUSH_M and all(self._free(like, at) for at in middles)

    def _push(self, robot: str, here: Array, target: Array) -> None:
        at_s, duration_s = self._when(*_PUSH_S)
        velocity = (target - here) * min(1.0, _PUSH_M / math.dist(here, target)) / duration_s
        v_x, v_y = velocity.round(4).tolist()
        self._faults.append(Push(kind="pushed", robot=robot, velocity_m_s=(v_x, v_y), at_s=at_s, duration_s=duration_s))

    def _when(self, shortest_s: float, longest_s: float) -> tuple[float, float]:
        duration_s = round(float(self._rng.uniform(shortest_s, longest_s)), 3)
        return round(float(self._rng.uniform(0.0, self._window_s - duration_s)), 3), duration_s


def _lines(config: Config) -> Array:
    """Return the points (K, 4) of the lines that are drawn for the groups: x, y [m], and the line's direction there."""
    lines = [shape for group in groups.descriptions(config) for shape in group.shapes if isinstance(shape, Line)]
    along = [np.gradient(line.points, axis=0) for line in lines]
    ways = [np.column_stack([line.points, np.arctan2(d[:, 1], d[:, 0])]) for line, d in zip(lines, along, strict=True)]
    return _headed(np.concatenate([np.empty((0, 3)), *ways]))


def _headed(poses: Array) -> Array:
    """Return poses (K, 3) as x, y [m] and the direction of their heading (K, 4)."""
    return np.column_stack([poses[:, :2], np.cos(poses[:, 2]), np.sin(poses[:, 2])])

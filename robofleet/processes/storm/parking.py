"""Robots that a storm parks beside the path: bodies that the fleet has to keep clear of, and that a hand pushes."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.config import barrier, slices
from robofleet.config.model import LAST_TAG
from robofleet.config.robots import Robot, StartPose
from robofleet.config.tree import Config
from robofleet.config.troubles import Fault, PoseFault, Push
from robofleet.control.path import Path
from robofleet.processes.check import drive_lap
from robofleet.safety.arming import free_m
from robofleet.safety.barrier import apart

Array = NDArray[np.float64]

_SHARE = 0.4  # of the seeds
_MOST = 2
_SPARE_M = 0.12  # further from the path than they must, at most
_MARGIN_M = 0.003
_AHEAD = (-0.6, 1.0)  # of the path's beginning: where a fleet is in the time of a storm [sides]
_TRIES = 40
_PUSH_S, _PUSH_M = (0.5, 2.0), 0.15
_PUSHED, _HIDDEN = 0.5, 0.3  # shares of the bystanders


class Parking:
    """Draws bystanders that ``robofleet check`` would accept where they stand, and where a hand leaves them."""

    def __init__(self, config: Config, rng: np.random.Generator, window_s: float) -> None:
        self._config, self._rng, self._window_s = config, rng, window_s
        self._robots: list[Robot] = []
        self._faults: list[Fault] = []

    def draw(self) -> tuple[tuple[Robot, ...], tuple[Fault, ...]]:
        """Return the bystanders of a seed, in most seeds none, and what befalls them."""
        if self._rng.random() < _SHARE:
            group = self._config.groups[0]
            self._path = Path.hermite(*slices.knots(group))
            self._lap = drive_lap(self._path, group, self._config.controller.point_ahead_m).centre
            for number in range(1 + int(self._rng.integers(_MOST))):
                self._park(number)
        return tuple(self._robots), tuple(self._faults)

    def _park(self, number: int) -> None:
        like = self._config.platoon[int(self._rng.integers(len(self._config.platoon)))]
        places = self._places(like)
        first = next(places, None)
        if first is None:
            return
        robot = self._robot(like, number, first)
        if self._rng.random() < _PUSHED:
            there = next((at for at in places if self._pushable(like, np.array(first), np.array(at))), None)
            if there is not None:
                self._push(robot.id, np.array(first), np.array(there))
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
        """Yield places beside the path where such a robot may stand."""
        for _ in range(_TRIES):
            sigma = np.array([self._rng.uniform(*_AHEAD) % self._path.sides])
            side = float(self._rng.choice((-1.0, 1.0))) * (self._near(like) + _SPARE_M * self._rng.random())
            (x, y), (along, across) = self._path.position(sigma)[0], self._path.tangent(sigma)[0]
            at = round(float(x - side * across), 4), round(float(y + side * along), 4)
            if self._free(like, np.array(at)):
                yield at

    def _near(self, like: Robot) -> float:
        config = self._config
        its, keepout = barrier.body(config, like), barrier.keepout(config)
        return max(apart(keepout, barrier.body(config, robot), its) for robot in config.platoon) + _MARGIN_M

    def _free(self, like: Robot, at: Array) -> bool:
        """Return whether a robot may stand there: inside, clear of the path, of the starts and of the others."""
        radius, half = like.vehicle.body_radius_m, np.array(self._config.arena.size_m) / 2
        if (np.abs(at) + radius + _MARGIN_M > half).any() or self._off_the_path(at) < self._near(like):
            return False
        for robot in (*self._config.robots, *self._robots):
            room = free_m(slices.drive(robot).wheel_radius) + robot.vehicle.body_radius_m + radius + _PUSH_M
            if math.dist((robot.start.x_m, robot.start.y_m), at) < room:
                return False
        return True

    def _off_the_path(self, at: Array) -> float:
        return float(np.hypot(*(self._lap - at).T).min())

    def _pushable(self, like: Robot, here: Array, there: Array) -> bool:
        """Return whether a hand may push it from one place to another one: straight, and never onto the path."""
        middles = (here + share * (there - here) for share in (0.25, 0.5, 0.75))
        return math.dist(here, there) <= 2 * _PUSH_M and all(self._free(like, at) for at in middles)

    def _push(self, robot: str, here: Array, there: Array) -> None:
        at_s, duration_s = self._when(*_PUSH_S)
        velocity = (there - here) * min(1.0, _PUSH_M / math.dist(here, there)) / duration_s
        v_x, v_y = velocity.round(4).tolist()
        self._faults.append(Push(kind="pushed", robot=robot, velocity_m_s=(v_x, v_y), at_s=at_s, duration_s=duration_s))

    def _when(self, shortest_s: float, longest_s: float) -> tuple[float, float]:
        duration_s = round(float(self._rng.uniform(shortest_s, longest_s)), 3)
        return round(float(self._rng.uniform(0.0, self._window_s - duration_s)), 3), duration_s

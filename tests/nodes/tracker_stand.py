"""A tracker on a bench, robots that drive straight on from their start, and a controller that ticks."""

import math
from collections.abc import Callable
from typing import Any

from robofleet.bus.keys import CAMERA, POSES, TICK, TRUTH, Topic
from robofleet.bus.messages import TickRecord
from robofleet.core.clock import MS, S
from robofleet.runs import table
from robofleet.simulation.faults import Schedule
from tests.bus.alone import Truth

TICK_NS = 33 * MS


class TrackerStand:
    """``speed``: of every robot [m/s]."""

    def __init__(
        self, bench: Any, speed: float = 0.1, wake: Callable[[int], None] = lambda _: None,
        faults: Schedule | None = None,
    ) -> None:  # fmt: skip
        self.bench, self.origin_ns, self._speed = bench, bench.now_ns, speed
        self.node = bench.made(table.TRACKER, wake, faults=faults)

    def run(self, ns: int, topic: Topic = POSES) -> list[Any]:
        """Let time pass and return every message of a topic so far."""
        self.bench.run(self.node, ns, (10 * MS, self._say_truths), (TICK_NS, self._tick))
        messages: list[Any] = self.bench.heard(topic, CAMERA)
        return messages

    def pose(self, robot: Any, instant_ns: int) -> tuple[float, float, float]:
        """Return where a robot truly is."""
        driven_m = self._speed * (instant_ns - self.origin_ns) / S
        psi = robot.start.psi
        return robot.start.x_m + driven_m * math.cos(psi), robot.start.y_m + driven_m * math.sin(psi), psi

    def _say_truths(self) -> None:
        now_ns = self.bench.now_ns
        for robot in self.bench.config.robots:
            self.bench.say(TRUTH, Truth(1, now_ns, *self.pose(robot, now_ns), self._speed, 0.0), robot.id)

    def _tick(self) -> None:
        tick = (self.bench.now_ns - self.origin_ns) // TICK_NS
        self.bench.say(TICK, TickRecord(1, 1, tick, -1, self.bench.now_ns, *[0] * 11, (), ()))

"""The gateway of a run on a simulated clock, in the gateway's own process: ROS 2 hears the time on ``/clock``.

Simulated time passes as fast as is asked for, and stands while this process is busy: it never races to make up for it.
"""

from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from robofleet.clock import MS, S, WallClock
from robofleet.comms.messages import TICK_RECORD
from robofleet.config.tree import Config
from robofleet.gateways.asking import Asked
from robofleet.gateways.ros2 import services, topics
from robofleet.gateways.ros2.gateway import Gateway
from robofleet.gateways.ros2.graph import profile, stamped
from robofleet.gateways.ros2.live import node
from robofleet.processes.script_link import FleetError
from robofleet.processes.script_lockstep import LockstepLink
from robofleet.safety.supervisor import Phase

_STEP_S = 0.005  # of simulated time, from one look at ROS to the next
_BEHIND_NS = 100 * MS  # of real time, that is not made up
_OVER = Phase.FAULT, Phase.ESTOP, Phase.IDLE
_WORDS = {"stop": "estop"}


class Simulated:
    """A run in lockstep that begins here, and is recorded in a folder."""

    def __init__(self, config: Config, name: str, folder: Path) -> None:
        self._config = config
        self._link = LockstepLink(config, config.groups[0].title, name, folder)

    def serve(self, namespace: str, speed: float) -> dict[str, Any]:
        """Let it go on until its duration is over, it ends, or SIGINT comes; returns its summary.

        ``speed``: simulated seconds a second. FleetError where it does not begin.
        """
        link = self._link
        link.begin()
        with node(namespace) as made:
            outcome: tuple[str, str | None] = "stopped", "the operator interrupted"
            try:
                with suppress(KeyboardInterrupt):
                    outcome = self._lap(made, speed)
            finally:
                summary = link.end(*outcome)  # whose last messages the node still hears
        return summary

    def _lap(self, made: Node, speed: float) -> tuple[str, str | None]:
        """Let time pass; returns how the run ended."""
        link, config, run = self._link, self._config, self._link.run
        executor = SingleThreadedExecutor(context=made.context)
        executor.add_node(made)
        gateway = Gateway(made, config, run.bus, run.clock, lambda: 0)
        services.serve(made, self._asked)
        ticking = made.create_publisher(Clock, topics.CLOCK.name, profile(topics.CLOCK.quality))
        pace = _Pace(speed, run.clock.now_ns())
        while link.status.phase not in _OVER:
            if self._elapsed_s >= config.run.duration_s:
                return "completed", None
            run.advance(_STEP_S)
            now_ns = run.clock.now_ns()
            ticking.publish(Clock(clock=stamped(now_ns)))
            gateway.step()
            executor.spin_once(timeout_sec=max(0.0, pace.left_s(now_ns)))
            while (left_s := pace.left_s(now_ns)) > 0.0:
                executor.spin_once(timeout_sec=left_s)
        return "fault", link.status.describe(config.ids)

    @property
    def _elapsed_s(self) -> float:
        """Time since the run's first tick [s]."""
        ticks: int = TICK_RECORD.head_of(self._link.tick, "run_tick")
        return ticks * self._config.controller.tick_s

    def _asked(self, what: str) -> "Future[Asked]":
        answer: Future[Asked] = Future()
        try:
            self._link.ask(_WORDS.get(what, what).encode())
            answer.set_result((True, "ok"))
        except FleetError as error:
            answer.set_result((False, str(error)))
        return answer


class _Pace:
    """How far simulated time is ahead of what was asked for."""

    def __init__(self, speed: float, now_ns: int) -> None:
        self._wall, self._speed = WallClock(), speed
        self._origin_ns = self._wall.now_ns() - round(now_ns / speed)

    def left_s(self, now_ns: int) -> float:
        """Return how long an instant of simulated time is yet to come [s]."""
        left_ns = self._origin_ns + round(now_ns / self._speed) - self._wall.now_ns()
        if left_ns < -_BEHIND_NS:
            self._origin_ns -= left_ns
        return left_ns / S

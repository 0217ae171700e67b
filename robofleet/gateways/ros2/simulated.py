"""The gateway of a run on a simulated clock, in the gateway's own process: ROS 2 hears the time on ``/clock``.

Simulated time passes as fast as is asked for, and stands while this process is busy: it never races to make up for it.
"""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.gateways.place import Served
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.gateway import Gateway, serve_requests
from robofleet.gateways.ros2.live import node
from robofleet.gateways.ros2.node_graph import profile, stamped
from robofleet.operator.asking import Outcome
from robofleet.operator.terminal.terminal import Interrupts, interrupts
from robofleet.safety.supervisor import Phase
from robofleet.scripts.script_link import FleetError
from robofleet.scripts.script_lockstep import LockstepLink

_STEP_S = 0.005  # of simulated time, from one look at ROS to the next
_BEHIND_NS = 100 * MS  # of real time, that is not made up
_OVER = Phase.FAULT, Phase.ESTOP, Phase.IDLE
_WORDS = {"stop": "estop"}


def serve(config: Config, name: str, folder: Path, namespace: str, speed: float) -> dict[str, Any]:
    """Be a run in lockstep, recorded in a folder, until its duration is over, it ends, or a signal comes.

    Returns its summary. ``speed``: simulated seconds a second. FleetError where it does not begin.
    """
    link = LockstepLink(config, config.groups[0].title, name, folder)
    with interrupts() as interrupted, node(namespace) as made:
        link.begin()
        outcome: tuple[str, str | None] = "stopped", "the operator interrupted"
        try:
            with suppress(KeyboardInterrupt):
                outcome = link.run.lap(_Passing(link, made, speed, interrupted).until, _OVER)
        finally:
            summary = link.end(*outcome)  # whose last messages the node still hears
    return summary


class _Passing:
    """Lets simulated time pass, while a node hears of it."""

    def __init__(self, link: LockstepLink, made: Node, speed: float, interrupted: Interrupts) -> None:
        self._link, self._run, self._interrupted = link, link.run, interrupted
        self._executor = SingleThreadedExecutor(context=made.context)
        self._executor.add_node(made)
        clock = self._run.clock
        served = Served(lambda: False, clock.now_ns())
        self._gateway = Gateway(made, link.config, self._run.bus, clock, lambda: 0, served)
        serve_requests(made, self._answered)
        self._ticking = made.create_publisher(Clock, topics.CLOCK.name, profile(topics.CLOCK.quality))
        self._pace = _Pace(speed, clock.now_ns())

    def until(self, done: Callable[[], bool]) -> None:
        """Let time pass until something is true; KeyboardInterrupt after a signal."""
        spin, left_s = self._executor.spin_once, self._pace.left_s
        while not done():
            if self._interrupted.count:
                raise KeyboardInterrupt
            self._run.advance(_STEP_S)
            now_ns = self._run.clock.now_ns()
            self._ticking.publish(Clock(clock=stamped(now_ns)))
            self._gateway.step()
            spin(timeout_sec=max(0.0, left_s(now_ns)))
            while (rest_s := left_s(now_ns)) > 0.0:
                spin(timeout_sec=rest_s)

    def _answered(self, what: str) -> "Future[Outcome]":
        answer: Future[Outcome] = Future()
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

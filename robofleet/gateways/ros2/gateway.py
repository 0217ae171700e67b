"""The gateway: a run's publication on a node, and the commands of nodes.

``live.py`` and ``simulated.py`` let time pass for it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.task import Future

from robofleet.bus.bus import Bus
from robofleet.config.tree import Config
from robofleet.core.clock import Clock
from robofleet.gateways.asking import SERVICES, Ask
from robofleet.gateways.place import Served
from robofleet.gateways.ros2.node_graph import TRANSFORMS_PACKAGE, NodeGraph
from robofleet.gateways.ros2.publication import Publication
from robofleet.gateways.ros2.topics import SERVICE, load
from robofleet.gateways.ros2.velocities import Velocities

NODE = "robofleet"


class Gateway:
    """Publishes a run on a ROS 2 graph, and takes the commands of ROS 2 nodes."""

    def __init__(
        self, node: Node, config: Config, bus: Bus, clock: Clock, epoch_ns: Callable[[], int], served: Served
    ) -> None:  # fmt: skip
        graph = self._graph = NodeGraph(node, clock, epoch_ns)
        came = node.create_guard_condition(self.step)

        def wake(_at_ns: int) -> None:
            came.trigger()

        self._publication = Publication(graph, config, bus, wake, served)
        self.velocities = Velocities(graph, config, self._publication.names, bus, self._publication.ticks)
        if not graph.has_transforms:
            node.get_logger().warning(
                f"no /tf, so RViz and Nav2 see no robots: this Python has no {TRANSFORMS_PACKAGE}, and PyPI has none: "
                "install robofleet for the Python of a ROS 2 of your own (configs/ROS2.md), which has it"
            )

    def step(self) -> None:
        """Publish what is new; also called when a message comes."""
        self._publication.ticks.update()
        self.velocities.step(self._graph.clock.now_ns())
        self._publication.step()


def serve_requests(node: Node, ask: Ask) -> None:
    """Serve them; the node goes on while one is answered."""

    async def answer(what: str, _request: Any, response: Any) -> Any:
        outcome: Future = Future(executor=node.executor)
        ask(what).add_done_callback(lambda done: None if done.cancelled() else outcome.set_result(done.result()))
        response.success, response.message = await outcome
        return response

    for what in SERVICES:
        node.create_service(load(SERVICE), what, partial(answer, what))

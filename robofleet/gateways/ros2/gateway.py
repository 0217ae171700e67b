"""The gateway: all its parts on one node. ``live.py`` and ``simulated.py`` let time pass for it."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import String

from robofleet.bus.bus import Bus
from robofleet.bus.observer import Observer, Source
from robofleet.bus.ticks import TickFollower
from robofleet.config import obstacles
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.gateways import urdf
from robofleet.gateways.asking import SERVICES, Ask
from robofleet.gateways.place import Served
from robofleet.gateways.ros2 import camera, topics
from robofleet.gateways.ros2.camera import Camera
from robofleet.gateways.ros2.graph import TRANSFORMS_PACKAGE, Graph, Transforms, has_transforms
from robofleet.gateways.ros2.robots import Robots
from robofleet.gateways.ros2.run import Run, markers
from robofleet.gateways.ros2.sensing import Sensing, places
from robofleet.gateways.ros2.topics import SERVICE, load
from robofleet.gateways.ros2.velocities import Velocities
from robofleet.vehicles.solids import distances

NODE = "robofleet"


class Gateway:
    """Publishes a run on a ROS 2 graph, and takes the commands of ROS 2 nodes."""

    def __init__(
        self, node: Node, config: Config, bus: Bus, clock: Clock, epoch_ns: Callable[[], int], served: Served
    ) -> None:  # fmt: skip
        graph = self._graph = Graph(node, clock, epoch_ns)
        came = node.create_guard_condition(self.step)

        def wake(_at_ns: int) -> None:
            came.trigger()

        names = topics.ros_names(robot.id for robot in config.robots)
        self._ticks = TickFollower(bus, round(config.controller.tick_s * S), wake)
        observer = self._observer = Observer(bus, wake=wake)
        robots = Robots(graph, config, names, observer, self._ticks)
        self.velocities = Velocities(graph, config, names, bus, self._ticks)
        run, sensing = Run(graph, config, observer, served), Sensing(graph, config, names, observer)
        # Each publishes what is new at an instant, of the sources of which the observer has a new message.
        self._steps: list[Callable[[int, set[Source]], None]] = [robots.step, run.step, sensing.step]
        if config.tracker.source == "camera":
            for name, view in config.trackers.items():
                self._steps.append(Camera(graph, name, view, robots, bus, observer).step)
        self._latched = [
            published(graph, topics.MARKERS, markers(config, names, graph.frames)),
            published(graph, topics.FLOOR, grid(config, graph)),
            *(
                published(graph, topics.DESCRIPTION, String(data=urdf.urdf(robot)), names[robot.id])
                for robot in config.robots
            ),
        ]
        self._publish_fixed_frames(graph, config, names)
        if not has_transforms():
            node.get_logger().warning(
                f"no /tf, so RViz and Nav2 see no robots: this Python has no {TRANSFORMS_PACKAGE}, and PyPI has none: "
                "install robofleet for the Python of a ROS 2 of your own (configs/ROS2.md), which has it"
            )

    def step(self) -> None:
        """Publish what is new; also called when a message comes."""
        now_ns = self._graph.clock.now_ns()
        self._ticks.update()
        self.velocities.step(now_ns)
        updated = self._observer.update(now_ns)
        for step in self._steps:
            step(now_ns, updated)

    def _publish_fixed_frames(self, graph: Graph, config: Config, names: dict[str, str]) -> None:
        self._fixed = Transforms(graph, topics.FIXED)
        stamp = graph.stamp(graph.clock.now_ns())
        found = [frame for robot in config.robots for frame in places(robot, names[robot.id], graph.frames, stamp)]
        for view in config.views if config.tracker.source == "camera" else ():
            seen = camera.place(view.camera, graph.frames, stamp)
            found += [] if seen is None else [seen]
        self._fixed.say(found)


FREE, OCCUPIED = 0, 100  # nav_msgs/OccupancyGrid
_CELL_M = 0.02
_MOST_CELLS = 1_000_000


def published(graph: Graph, topic: topics.Topic, message: Any, *names: str) -> Any:
    """Publish what does not change, for late subscribers too, as long as the publisher that is returned is held."""
    publisher = graph.publisher(topic, *names)
    publisher.publish(message)
    return publisher


def grid(config: Config, graph: Graph) -> OccupancyGrid:
    """Return the arena as an occupancy grid: a cell is occupied if its middle is in an obstacle or beside the floor."""
    cell_m, cells = occupied(config)
    rows, columns = cells.shape
    message = OccupancyGrid()
    message.header.frame_id = graph.frames.map
    message.header.stamp = message.info.map_load_time = graph.stamp(graph.clock.now_ns())
    message.info.resolution, message.info.width, message.info.height = cell_m, columns, rows
    message.info.origin.position.x, message.info.origin.position.y = -columns * cell_m / 2.0, -rows * cell_m / 2.0
    message.info.origin.orientation.w = 1.0
    message.data = np.where(cells, OCCUPIED, FREE).astype(np.int8).ravel().tolist()
    return message


def occupied(config: Config) -> tuple[float, NDArray[np.bool_]]:
    """Return the side of a cell [m], and which cells of the arena are occupied: rows by y, columns by x, from below."""
    x_m, y_m = config.arena.size_m
    cell_m = max(_CELL_M, math.sqrt(x_m * y_m / _MOST_CELLS))
    columns, rows = math.ceil(x_m / cell_m), math.ceil(y_m / cell_m)
    x, y = ((np.arange(count) + 0.5 - count / 2.0) * cell_m for count in (columns, rows))
    middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    solids = obstacles.every(config.arena)
    inside = distances(solids, middles).min(axis=0) < 0.0 if solids else np.zeros(len(middles), np.bool_)
    return cell_m, inside.reshape(rows, columns)


def serve_requests(node: Node, ask: Ask) -> None:
    """Serve them; the node goes on while one is answered."""

    async def answer(what: str, _request: Any, response: Any) -> Any:
        outcome: Future = Future(executor=node.executor)
        ask(what).add_done_callback(lambda done: None if done.cancelled() else outcome.set_result(done.result()))
        response.success, response.message = await outcome
        return response

    for what in SERVICES:
        node.create_service(load(SERVICE), what, partial(answer, what))

"""All that is published of a run: on the graph of a node, or into a bag."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.observer import Observer
from robofleet.bus.ticks import TickFollower
from robofleet.config import obstacles
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.gateways import urdf
from robofleet.gateways.place import Served
from robofleet.gateways.ros2 import camera, topics
from robofleet.gateways.ros2.camera import Camera
from robofleet.gateways.ros2.graph import Graph, Transforms
from robofleet.gateways.ros2.robots import Robots
from robofleet.gateways.ros2.run import Run, markers
from robofleet.gateways.ros2.sensing import Sensing, places
from robofleet.vehicles.solids import distances


class Publication:
    """Publishes a run, message by message of its bus."""

    def __init__(self, graph: Graph, config: Config, bus: Bus, wake: Wake, served: Served) -> None:
        """``wake`` is called when a message comes that ``step`` is to publish."""
        names = self.names = topics.ros_names(robot.id for robot in config.robots)
        self._graph = graph
        self.ticks = TickFollower(bus, round(config.controller.tick_s * S), wake)
        observer = self._observer = Observer(bus, wake=wake)
        robots = Robots(graph, config, names, observer, self.ticks)
        # Each publishes what is new at an instant, of the sources of which the observer has a new message.
        cameras = config.trackers if config.tracker.source == "camera" else {}
        self._parts: tuple[Robots | Run | Sensing | Camera, ...] = (
            robots,
            Run(graph, config, observer, served),
            Sensing(graph, config, names, observer),
            *(Camera(graph, name, view, robots, bus, observer) for name, view in cameras.items()),
        )
        self._latched = [
            published(graph, topics.MARKERS, markers(graph, config, names)),
            published(graph, topics.FLOOR, grid(graph, config)),
            *(
                published(graph, topics.DESCRIPTION, graph.messages.String(data=urdf.urdf(robot)), names[robot.id])
                for robot in config.robots
            ),
        ]
        self._publish_fixed_frames(config)

    def step(self) -> None:
        now_ns = self._graph.clock.now_ns()
        self.ticks.update()
        updated = self._observer.update(now_ns)
        for part in self._parts:
            part.step(now_ns, updated)

    def _publish_fixed_frames(self, config: Config) -> None:
        graph, names = self._graph, self.names
        self._fixed = Transforms(graph, topics.FIXED)
        stamp = graph.stamp(graph.clock.now_ns())
        found = [frame for robot in config.robots for frame in places(graph, robot, names[robot.id], stamp)]
        for view in config.views if config.tracker.source == "camera" else ():
            seen = camera.place(graph, view.camera, stamp)
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


def grid(graph: Graph, config: Config) -> Any:
    """Return the arena as an occupancy grid: a cell is occupied if its middle is in an obstacle or beside the floor."""
    cell_m, cells = occupied(config)
    rows, columns = cells.shape
    message = graph.messages.OccupancyGrid()
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

"""What does not move: the arena's floor and obstacles as a map, and every robot's description."""

import math
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import String

from robofleet.config import obstacles
from robofleet.config.tree import Config
from robofleet.gateways import urdf
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph
from robofleet.vehicles.solids import distances

FREE, OCCUPIED = 0, 100  # nav_msgs/OccupancyGrid
_CELL_M = 0.02
_MOST_CELLS = 1_000_000


class Floor:
    """Says once what does not move; who comes later hears it, too."""

    def __init__(self, graph: Graph, config: Config, names: dict[str, str]) -> None:
        self._publishers: list[Any] = [graph.publisher(topics.FLOOR)]
        self._publishers[0].publish(grid(config, graph))
        for robot in config.robots:
            description = graph.publisher(topics.DESCRIPTION, names[robot.id])
            description.publish(String(data=urdf.urdf(robot)))
            self._publishers.append(description)


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

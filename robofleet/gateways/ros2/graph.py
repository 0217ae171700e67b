"""The node, and what it says: the table's rows made real."""

import math
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

from robofleet.core.clock import Clock, S, WallClock
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.topics import Frames, Quality, Topic, load

_WALL = WallClock()
_TIME_RANGE_S = -(2**31), 2**31 - 1  # of ROS's time
_LARGEST_FLOAT32 = 3.4028234e38


class Graph:
    """What a part of the gateway needs of ROS: publishers by the table, stamps, and a line in the log.

    ``epoch_ns`` is added to the run's clock to give a stamp; it is 0 in simulated time.
    """

    def __init__(self, node: Node, clock: Clock, epoch_ns: Callable[[], int]) -> None:
        self.node, self.frames = node, Frames(node.get_namespace())
        self.clock, self._epoch_ns = clock, epoch_ns

    def publisher(self, topic: Topic, *names: object) -> Any:
        """Return the publisher of a row, of a robot or camera; of a distance sensor by its number, too."""
        return self.node.create_publisher(load(topic.type), topic.name.format(*names), profile(topic.quality))

    def now_ns(self) -> int:
        """Return the time that ROS has [ns]."""
        return self.clock.now_ns() + self._epoch_ns()

    def real_ns(self) -> int:
        """Return an instant of real time, also in simulated time: no date, so nobody sets it [ns]."""
        return _WALL.now_ns()

    def stamp(self, instant_ns: int) -> Time:
        return stamped(instant_ns + self._epoch_ns())


def stamped(ros_ns: int) -> Time:
    """Return a time of ROS [ns] as messages have it; beyond their ends, the nearer one."""
    first_s, last_s = _TIME_RANGE_S
    return Time(sec=min(max(first_s, ros_ns // S), last_s), nanosec=ros_ns % S)


def single(value: float) -> float:
    """Return a number as a float32 of a message can have it: beyond its ends, infinite."""
    return math.copysign(math.inf, value) if abs(value) > _LARGEST_FLOAT32 else value


def profile(quality: Quality) -> QoSProfile:
    reliability, durability = QoSReliabilityPolicy, QoSDurabilityPolicy
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=reliability.RELIABLE if quality.reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if quality.latched else durability.VOLATILE,
    )


def wanted(publisher: Any) -> bool:
    return bool(publisher.get_subscription_count())


TRANSFORMS_PACKAGE = "tf2_msgs"  # PyPI has no such package; every ROS 2 has it


def has_transforms() -> bool:
    """Return whether frames can be published."""
    return find_spec(TRANSFORMS_PACKAGE) is not None


class Transforms:
    """A publisher of frames."""

    def __init__(self, graph: Graph, topic: Topic = topics.TRANSFORMS) -> None:
        self._publisher = graph.publisher(topic) if has_transforms() else None
        self._type: Any = topics.load(topic.type) if has_transforms() else None
        self._latched = topic.quality.latched

    @property
    def wanted(self) -> bool:
        """Whether somebody listens, or will."""
        return self._publisher is not None and (self._latched or wanted(self._publisher))

    def say(self, frames: Sequence[TransformStamped]) -> None:
        if self._publisher is not None and frames:
            self._publisher.publish(self._type(transforms=frames))

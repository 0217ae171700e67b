"""The graph of a node: the table's rows made real."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

from robofleet.core.clock import Clock, S, WallClock
from robofleet.gateways.ros2.graph import Messages
from robofleet.gateways.ros2.topics import Frames, Quality, Topic, load

_WALL = WallClock()
_TIME_RANGE_S = -(2**31), 2**31 - 1  # of ROS's time
TRANSFORMS_PACKAGE = "tf2_msgs"  # PyPI has no such package; every ROS 2 has it


class NodeGraph:
    """What a part of the gateway needs of ROS.

    ``epoch_ns`` is added to the run's clock to give a stamp; it is 0 in simulated time.
    """

    def __init__(self, node: Node, clock: Clock, epoch_ns: Callable[[], int]) -> None:
        self.node, self.frames = node, Frames(node.get_namespace())
        self.clock, self._epoch_ns = clock, epoch_ns
        self.messages, self.has_transforms = Messages(), find_spec(TRANSFORMS_PACKAGE) is not None

    def publisher(self, topic: Topic, *names: object) -> Any:
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


def profile(quality: Quality) -> QoSProfile:
    reliability, durability = QoSReliabilityPolicy, QoSDurabilityPolicy
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=reliability.RELIABLE if quality.reliable else reliability.BEST_EFFORT,
        durability=durability.TRANSIENT_LOCAL if quality.latched else durability.VOLATILE,
    )

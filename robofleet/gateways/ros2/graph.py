"""What the parts of a publication need of a graph: publishers by the table, types of messages, stamps and frames.

A node has one (``node_graph.py``), and a bag (``gateways/exports/rosbag2.py``), which needs no ROS.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Protocol

from robofleet.core.clock import Clock
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.topics import Frames, Topic

_LARGEST_FLOAT32 = 3.4028234e38
_PACKAGES = {
    "builtin_interfaces": ("Time",),
    "diagnostic_msgs": ("DiagnosticArray", "DiagnosticStatus", "KeyValue"),
    "geometry_msgs": (
        "Point", "Pose", "PoseWithCovarianceStamped", "Quaternion", "TransformStamped", "TwistStamped", "Vector3",
    ),
    "nav_msgs": ("OccupancyGrid", "Odometry"),
    "rcl_interfaces": ("Log",),
    "sensor_msgs": (
        "BatteryState", "CameraInfo", "CompressedImage", "Image", "Imu", "JointState", "MagneticField", "Range",
    ),
    "std_msgs": ("ColorRGBA", "String"),
    "tf2_msgs": ("TFMessage",),
    "visualization_msgs": ("Marker", "MarkerArray"),
}  # fmt: skip
_NAMES = {title: f"{package}/msg/{title}" for package, titles in _PACKAGES.items() for title in titles}


class Messages:
    """Types of messages by their titles: ``messages.Odometry``."""

    def __init__(self, load: Callable[[str], Any] = topics.load) -> None:
        """``load`` returns a type by its full name, ``nav_msgs/msg/Odometry``."""
        self._load = cache(load)

    def __getattr__(self, title: str) -> Any:
        if title not in _NAMES:
            raise AttributeError(title)
        return self._load(_NAMES[title])


class Publisher(Protocol):
    """The publisher of a topic."""

    def publish(self, message: Any, /) -> None:
        """Publish a message; it may be changed afterwards."""

    def get_subscription_count(self) -> int:
        """Return how many listen."""


class Graph(Protocol):
    """Where a run is published."""

    frames: Frames
    messages: Messages
    has_transforms: bool  # whether frames can be published

    @property
    def clock(self) -> Clock:
        """The run's clock."""

    def publisher(self, topic: Topic, *names: object) -> Any:
        """Return the publisher of a row, of a robot or camera; of a distance sensor by its number, too."""

    def stamp(self, instant_ns: int) -> Any:
        """Return an instant of the run's clock as messages have it."""


def single(value: float) -> float:
    """Return a number as a float32 of a message can have it: beyond its ends, infinite."""
    return math.copysign(math.inf, value) if abs(value) > _LARGEST_FLOAT32 else value


def wanted(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count())


class Transforms:
    """A publisher of frames."""

    def __init__(self, graph: Graph, topic: Topic = topics.TRANSFORMS) -> None:
        self._publisher = graph.publisher(topic) if graph.has_transforms else None
        self._type: Any = graph.messages.TFMessage if graph.has_transforms else None
        self._latched = topic.quality.latched

    @property
    def wanted(self) -> bool:
        """Whether somebody listens, or will."""
        return self._publisher is not None and (self._latched or wanted(self._publisher))

    def say(self, frames: Sequence[Any]) -> None:
        if self._publisher is not None and frames:
            self._publisher.publish(self._type(transforms=frames))

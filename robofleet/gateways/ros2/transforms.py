"""``tf``: who may hear the frames where ``tf2_msgs`` is installed. PyPI has no such package; every ROS 2 has it."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

from geometry_msgs.msg import TransformStamped

from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph, wanted
from robofleet.gateways.ros2.topics import Topic

PACKAGE = "tf2_msgs"


def there() -> bool:
    """Return whether frames can be said."""
    return find_spec(PACKAGE) is not None


class Transforms:
    """A publisher of frames."""

    def __init__(self, graph: Graph, topic: Topic = topics.TRANSFORMS) -> None:
        self._publisher = graph.publisher(topic) if there() else None
        self._type: Any = topics.load(topic.type) if there() else None
        self._latched = topic.quality.latched

    @property
    def wanted(self) -> bool:
        """Whether somebody listens, or will."""
        return self._publisher is not None and (self._latched or wanted(self._publisher))

    def say(self, frames: Sequence[TransformStamped]) -> None:
        """Say where these frames are."""
        if self._publisher is not None and frames:
            self._publisher.publish(self._type(transforms=frames))

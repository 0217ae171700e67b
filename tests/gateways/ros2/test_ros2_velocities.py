"""Commands of ROS 2 nodes as their group's wish, whoever publishes them by whatever clock."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="NO ROS 2: pip install -e '.[ros2]' on Python 3.11, or source your own")

from geometry_msgs.msg import TwistStamped

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import WISH
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.gateways.ros2.velocities import Velocities

PERIOD_NS = 30 * MS
SECOND = S // PERIOD_NS + 1  # commands


class Stand:
    """A graph with one clock, on which nodes command r1; what is wished of it."""

    def __init__(self) -> None:
        self.clock, self.senders = SimulatedClock(), list[str]()
        self.clock.advance_to(S)
        self._takes = list[Callable[[Any, dict[str, int]], None]]()
        self.node = self
        config = load_config(SHIPPED / "ros2.yaml")
        bus = MemoryBus(config.arena.name, self.clock, 0)
        self._setpoints = bus.newest(WISH, config.groups[0].title)
        ticks: Any = SimpleNamespace(update=lambda: None, newest=1, instant=lambda _: self.clock.now_ns())
        names = {robot: robot for robot in config.ids}
        self._velocities = Velocities(self, config, names, bus, ticks)  # type: ignore[arg-type]

    def real_ns(self) -> int:
        return self.clock.now_ns()

    def create_guard_condition(self, say: Callable[[], None]) -> Any:
        return SimpleNamespace(trigger=say)

    def resolve_topic_name(self, name: str) -> str:
        return f"/{name}"

    def create_subscription(self, _kind: object, _name: str, take: Any, _profile: object) -> None:
        self._takes.append(take)

    def get_publishers_info_by_topic(self, name: str) -> list[Any]:
        return [SimpleNamespace(topic_type="geometry_msgs/msg/TwistStamped", endpoint_gid=sender.encode())
                for sender in self.senders if name == "/r1/cmd_vel"]  # fmt: skip

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda *_, **__: None)

    def ages_s(self, sender: str, count: int, off_ns: int = 0) -> list[float]:
        """Let a node command r1; returns the ages that are wished of its commands."""
        self.senders = [sender]
        found = []
        for _ in range(count):
            self.clock.advance_to(self.clock.now_ns() + PERIOD_NS)
            self._velocities.step(self.clock.now_ns())
            self._takes[0](TwistStamped(), {"source_timestamp": self.clock.now_ns() + off_ns})
            payload = self._setpoints.take()
            message = None if payload is None else SCRIPT_WISH.view(payload)
            assert message is not None
            found.append(float(SCRIPT_WISH.floats(message[1])[0, 2]))
        return found


def test_the_next_node_drives_whatever_its_clock_is() -> None:
    """A node on a computer whose clock is ahead would make commands of all later ones old."""
    stand = Stand()
    assert stand.ages_s("one", 10, 2 * S) == [0.0] * 10
    stand.clock.advance_to(stand.clock.now_ns() + 10 * S)
    ages = np.array(stand.ages_s("other", 2 * SECOND))
    assert ages[0] >= 1.0, "its clock is not known at first"
    assert ages[-1] == 0.0


def test_a_node_that_is_started_again_drives_at_once() -> None:
    stand = Stand()
    assert stand.ages_s("one", 10) == stand.ages_s("again", 10) == [0.0] * 10

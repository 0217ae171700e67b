"""``cmd_vel``: velocity commands of ROS 2 nodes to the robots whose behaviour is ``ros2``, with their age.

A command's age counts from its publication. DDS tells when that was, on the publisher's clock: see ``Ages``. A
stamp in the message's own header counts too: an old one is an old command.
"""

import secrets
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from robofleet.behaviours.interface import WishKind
from robofleet.behaviours.ros2 import Ros2
from robofleet.bus.bus import Bus
from robofleet.bus.keys import WISH
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.bus.ticks import TickFollower
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.node_graph import NodeGraph, profile
from robofleet.gateways.ros2.topics import load

_DRIFT_DIVISOR = 10_000  # two clocks drift apart by less than this part of the time that passes
_CLOCK_SET_NS = 100 * MS  # who is faster than the fastest by more has set its clock
_DOUBT_NS = S  # so long after that no age is known
UNKNOWN_NS = 60 * S  # older than any command that is done (``silent_s``)


class Ages:
    """Of the messages on one topic.

    The fastest message so far shows how far two clocks are apart, together with the shortest way. What took longer is
    older by that: held back on its way, by its sender's computer, or by this process. The clocks' drift alone makes
    that difference grow: a way that becomes slow, and stays so, makes every message old.

    A message that was sent before the one before it, or that is faster than any clock drifts, is of a sender whose
    clock was set, or of another one. Its way is not known then: all is old until a second has passed without such a
    jump. So of two senders that alternate, with clocks that differ, none is believed.
    """

    def __init__(self) -> None:
        self._fastest_ns: int | None = None  # from the sender's clock to ours
        self._sent_ns = self._came_ns = 0
        self._known_ns = 0  # from when on ages are known
        self._other = False  # the next message may be another sender's

    def expect_another(self) -> None:
        """Expect another sender: whose next message is slower by more than clocks drift has another clock."""
        self._other = True

    def age_ns(self, sent_ns: int, came_ns: int) -> int:
        """Return how old a message is that was sent at an instant of its sender's clock and came at one of ours."""
        way_ns = came_ns - sent_ns
        if self._fastest_ns is None:
            self._fastest_ns = way_ns
        else:
            self._fastest_ns += (came_ns - self._came_ns) // _DRIFT_DIVISOR
            longer_ns = way_ns - self._fastest_ns
            if sent_ns < self._sent_ns or longer_ns < -_CLOCK_SET_NS or (self._other and longer_ns > _CLOCK_SET_NS):
                self._fastest_ns, self._known_ns = way_ns, came_ns + _DOUBT_NS
        self._sent_ns, self._came_ns, self._other = sent_ns, came_ns, False
        self._fastest_ns = min(self._fastest_ns, way_ns)
        return way_ns - self._fastest_ns if came_ns >= self._known_ns else UNKNOWN_NS


_EPOCH_BITS = 30  # as of scripts
_TYPE_POLL_NS = S // 4  # between two looks of which type a robot's commands are
_SILENT_NS = S  # a publisher that says nothing for so long keeps no other one from its topic
_BEYOND = 1e6  # [m/s, rad/s] as the controller refuses it
_LONGEST_AGE_S = 1e5  # older than any command that is heard


class Velocities:
    """The commands of all groups whose behaviour is ``ros2``."""

    def __init__(
        self, graph: NodeGraph, config: Config, names: dict[str, str], bus: Bus, ticks: TickFollower
    ) -> None:  # fmt: skip
        titles, come = groups.taking_setpoints(config, Ros2), graph.node.create_guard_condition(self._say)
        self._groups = [
            _Group(graph, [names[robot] for robot in group.robots], bus, group.title, ticks, come.trigger)
            for group in config.groups
            if group.title in titles
        ]
        self._looked_ns = -_TYPE_POLL_NS
        self.step(graph.clock.now_ns())

    def step(self, now_ns: int) -> None:
        """Listen to each robot's commands by the type that their publisher has."""
        if self._groups and now_ns - self._looked_ns >= _TYPE_POLL_NS:
            self._looked_ns = now_ns
            for group in self._groups:
                group.listen()

    def stand(self) -> None:
        for group in self._groups:
            group.say(WishKind.STAND)

    def _say(self) -> None:
        for group in self._groups:
            if group.changed:
                group.say(WishKind.BODY)


class _Group:
    """A group's commands: what came of each robot's node, and when."""

    def __init__(
        self, graph: NodeGraph, robots: list[str], bus: Bus, group: str, ticks: TickFollower, wake: Callable[[], None]
    ) -> None:
        self._clock, self._ticks, self._wake = graph.clock, ticks, wake
        self._publish = bus.publisher(WISH, group)
        self._epoch, self._seq = 1 + secrets.randbits(_EPOCH_BITS - 1), 0
        self._velocities = np.zeros(len(robots), SCRIPT_WISH.item_dtype)
        self._values = SCRIPT_WISH.floats(self._velocities)  # of the same memory (N, 3)
        self._since_ns = np.zeros(len(robots), np.int64)  # when each command was published, on our clock
        self._topics = [_Commands(graph, robot, partial(self._on_velocity, row)) for row, robot in enumerate(robots)]
        self.changed = False

    def listen(self) -> None:
        for topic in self._topics:
            topic.listen()

    def _on_velocity(self, row: int, v: float, omega: float, age_ns: int) -> None:
        self._velocities["told"][row] = 1
        self._values[row, :2] = v, omega
        self._since_ns[row] = self._clock.now_ns() - age_ns
        self.changed = True
        self._wake()  # several commands that came together make one message

    def say(self, kind: WishKind) -> None:
        """Publish the newest commands as setpoints; their ages count from the newest tick that is known."""
        self.changed = False
        self._ticks.update()
        tick = self._ticks.newest
        if tick:
            age_s = (self._ticks.instant(tick) - self._since_ns) / S
            self._values[:, 2] = np.where(self._velocities["told"], np.minimum(age_s, _LONGEST_AGE_S), 0.0)
            self._seq += 1
            self._publish(SCRIPT_WISH.encode_array((self._epoch, self._seq, kind, 0, tick), self._velocities))


class _Commands:
    """The subscription to one robot's commands."""

    def __init__(self, graph: NodeGraph, robot: str, take: Any) -> None:
        self._graph, self._node, self._on_velocity = graph, graph.node, take
        self._name = graph.node.resolve_topic_name(topics.COMMAND.name.format(robot))
        self._kinds = topics.COMMAND.type.split(" or ")
        self._ages, self._senders = Ages(), set[bytes]()
        self._heard_ns = -_SILENT_NS  # when something was heard last, in real time
        self._kind = self._kinds[0]
        self._subscription = self._subscribed()

    def listen(self) -> None:
        """Take the other type where somebody publishes that one, and nobody is heard by this one.

        DDS holds a node that was killed for alive for twenty seconds. When all are gone that were there, others
        are expected, with clocks of their own.
        """
        senders = self._node.get_publishers_info_by_topic(self._name)
        ids = {bytes(sender.endpoint_gid) for sender in senders}
        if ids and self._senders.isdisjoint(ids):
            self._ages.expect_another()
        self._senders = self._senders & ids or ids or self._senders
        kinds = {sender.topic_type for sender in senders}
        silent = self._graph.real_ns() - self._heard_ns > _SILENT_NS
        if (self._kind not in kinds or silent) and (wanted := kinds & set(self._kinds) - {self._kind}):
            self._node.destroy_subscription(self._subscription)
            self._kind = wanted.pop()
            self._subscription = self._subscribed()

    def _subscribed(self) -> Any:
        take = self._take_stamped if self._kind == self._kinds[0] else self._take
        return self._node.create_subscription(load(self._kind), self._name, take, profile(topics.COMMAND.quality))

    def _take_stamped(self, message: Any, info: dict[str, int]) -> None:
        stamp = message.header.stamp
        stamped_ns = stamp.sec * S + stamp.nanosec
        self._take(message.twist, info, self._graph.now_ns() - stamped_ns if stamped_ns else 0)

    def _take(self, twist: Any, info: dict[str, int], age_ns: int = 0) -> None:
        v, omega = twist.linear.x, twist.angular.z
        if not abs(v) < _BEYOND or not abs(omega) < _BEYOND:  # not so of NaN
            self._node.get_logger().warning(
                f"{self._name}: v {v:g} m/s, omega {omega:g} rad/s is no command: the robot stands",
                throttle_duration_sec=1.0,
            )
            v = omega = 0.0
        self._heard_ns = self._graph.real_ns()
        age_ns = max(age_ns, self._ages.age_ns(info["source_timestamp"], self._heard_ns))
        if age_ns >= UNKNOWN_NS:
            self._node.get_logger().warning(
                f"{self._name}: of another node, or of one whose clock was set: the robot stands until one node alone "
                "has commanded it for a second",
                throttle_duration_sec=1.0,
            )
        self._on_velocity(v, omega, age_ns)

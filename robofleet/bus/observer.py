"""One observer of the bus: the newest message of each topic, when it came, and who is alive.

numpy is not imported: `robofleet stop` and `status` start fast.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from robofleet.bus.bus import Bus, Subscription, Wake
from robofleet.bus.keys import STATUS, Topic
from robofleet.bus.messages import RobotStatus
from robofleet.core.clock import S

Source = Topic | tuple[Topic, str]  # a topic; or a topic and what it is about: a unit, a camera
Decode = Callable[[bytes], Any]


class Observer:
    """The newest valid message of each topic that was declared.

    ``update`` takes what has come. ``observer[TICK]`` and ``observer[STATUS, unit]`` are the newest messages; None
    where none has come. Messages that cannot be decoded are dropped.
    """

    def __init__(self, bus: Bus, sources: Iterable[Source] = (), wake: Wake | None = None) -> None:
        """Declare topics; ``wake`` is called, from any thread, when a message of any declared topic comes."""
        self._bus, self._wake = bus, wake
        self._subscriptions: dict[Source, tuple[Subscription, Decode]] = {}
        self._newest: dict[Source, tuple[Any, int]] = {}  # message, and when it came [ns]
        self.declare(sources)

    def declare(self, sources: Iterable[Source], decode: Decode | None = None) -> None:
        """Subscribe to topics. ``decode`` replaces the layout's own; it returns None for a message that is wrong."""
        for source in sources:
            topic, name = (source, "") if isinstance(source, Topic) else source
            if decode is None:
                assert topic.layout is not None, topic.key
            self._subscriptions[source] = (
                self._bus.newest(topic, name, self._wake),
                decode or topic.layout.decode,  # type: ignore[union-attr]
            )

    def update(self, now_ns: int, sources: Iterable[Source] | None = None) -> set[Source]:
        """Take what has come, by default of all sources; returns those of which there is a new message."""
        updated: set[Source] = set()
        for source in self._subscriptions if sources is None else sources:
            subscription, decode = self._subscriptions[source]
            payload = subscription.take()
            if payload is not None and (message := decode(payload)) is not None:
                self._newest[source] = message, subscription.arrival_ns or now_ns
                updated.add(source)
        return updated

    def __getitem__(self, source: Source) -> Any:
        """Return the newest message; None where none has come."""
        return self._newest.get(source, (None, 0))[0]

    def arrival_ns(self, source: Source) -> int:
        """Return when the newest message came, exactly where there is a ``wake``; 0 where none has."""
        return self._newest.get(source, (None, 0))[1]

    def age_ns(self, source: Source, now_ns: int) -> int | None:
        """Return how long ago the newest message came; None where none has."""
        return now_ns - self.arrival_ns(source) if source in self._newest else None

    def alive(self, source: Source, now_ns: int, within_ns: int = S) -> bool:
        """Return whether a message has come within this time."""
        age_ns = self.age_ns(source, now_ns)
        return age_ns is not None and age_ns <= within_ns


class RobotObserved(NamedTuple):
    """What is known of one robot."""

    status: RobotStatus | None = None
    arrival_ns: int = 0  # 0: its unit has not spoken


def robots_observed(
    observer: Observer, units: Mapping[str, Sequence[str]], robots: Iterable[str]
) -> list[RobotObserved]:
    """Return the newest status of each robot; the observer observes STATUS of the units."""
    found: dict[str, RobotObserved] = {}
    for unit, members in units.items():
        message, arrival_ns = observer[STATUS, unit], observer.arrival_ns((STATUS, unit))
        if message is not None and len(message.robots) == len(members):
            found |= zip(members, [RobotObserved(status, arrival_ns) for status in message.robots], strict=True)
    return [found.get(robot, RobotObserved()) for robot in robots]

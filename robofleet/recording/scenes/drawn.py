"""What viewers draw of a run: the channels and messages that a recording has beside the bus's own.

The recording writes them, and viewers that look at a run while it is on get the same ones: both are made here.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from robofleet.behaviours import described
from robofleet.config.tree import Config
from robofleet.recording.channels import ENCODING, SCHEMA_ENCODING, schema
from robofleet.recording.scenes.robot_ticks import BATCH, RobotTicks
from robofleet.recording.scenes.scene import Scene

PROTOBUF = "protobuf"

DrawnMessages = Sequence[tuple[str, int, bytes]]  # topic, log time [ns], message


class Channel(NamedTuple):
    """A topic, and by which schema its messages are decoded."""

    topic: str
    encoding: str  # of the messages
    schema: str  # its name
    schema_encoding: str
    description: bytes


def of_key(full: str) -> Channel:
    """Return the channel of a key of the bus, whose messages are kept as they were said."""
    name, description = schema(full)
    return Channel(full, ENCODING, name, SCHEMA_ENCODING, description)


class Drawn:
    """Makes viewers' messages of the bus's messages, which it is given in order."""

    def __init__(
        self, config: Config, groups: tuple[described.Group, ...], *, epoch_ns: int = 0, batch: int = BATCH
    ) -> None:
        """``epoch_ns``: added to the caller's clock, it gives dates; ``batch``: ticks of a robot in one message."""
        self._epoch_ns = epoch_ns
        self._scene = Scene(config, groups, epoch_ns=epoch_ns)
        self._ticks = RobotTicks(config, groups, batch)
        self.channels = tuple(self._described())

    def update(self, full: str, payload: bytes, at_ns: int) -> DrawnMessages:
        log_ns = at_ns + self._epoch_ns
        shown = self._scene.update(full, payload, at_ns)
        ticks = self._ticks.update(full, payload, log_ns)
        return [*((topic, log_ns, drawn) for topic, drawn in shown), *ticks] if shown else ticks

    def rest(self) -> DrawnMessages:
        return self._ticks.rest()

    def _described(self) -> Iterator[Channel]:
        for topic, name, descriptor in self._scene.channels:
            yield Channel(topic, PROTOBUF, name, PROTOBUF, descriptor)
        for topic, message in self._ticks.channels:
            yield Channel(topic, PROTOBUF, message.name, PROTOBUF, message.descriptor)

"""A stranger's viewer: it knows what the file's channels say, and decodes messages by that alone."""

import math
from collections import defaultdict
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from robofleet.bus.keys import TICK, key
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.recording.run import Recording
from robofleet.recording.scenes.scene import Scene
from tests.recording.recorded import in_order

EPOCH_NS = 1_790_000_000 * S
START_NS = S  # of what is played, on the recorder's clock
TICK_NS = 33 * MS


class Viewer:
    """Plays recordings to a scene, and keeps what it makes of them: messages by topic."""

    def __init__(self, config: Config) -> None:
        self._scene = Scene(config, groups.descriptions(config), epoch_ns=EPOCH_NS)
        self._kinds = {}
        for topic, _, schema, _, descriptor in self._scene.channels:
            pool = DescriptorPool()
            for file in FileDescriptorSet.FromString(descriptor).file:
                pool.Add(file)  # type: ignore[no-untyped-call]
            self._kinds[topic] = GetMessageClass(pool.FindMessageTypeByName(schema))
        self.messages: dict[str, list[Any]] = defaultdict(list)
        self._ticks = -1

    def tell(self, full: str, payload: bytes, at_ns: int) -> None:
        """Tell a message of the bus."""
        for topic, data in self._scene.update(full, payload, at_ns):
            self.messages[topic].append(self._kinds[topic].FromString(data))

    def play(self, recording: Recording) -> "Viewer":
        """Tell a recording's messages in their order; its ticks make the time."""
        tick_key = key(recording.config.arena.name, TICK)
        for full, payload in in_order(recording):
            self._ticks += full == tick_key
            self.tell(full, payload, START_NS + max(0, self._ticks) * TICK_NS)
        return self

    @property
    def frames(self) -> dict[str, list[Any]]:
        """Every transform of a frame."""
        frames = defaultdict(list)
        for message in self.messages["/tf"]:
            for frame in message.transforms:
                frames[frame.child_frame_id].append(frame)
        return frames

    @property
    def bodies(self) -> dict[str, Any]:
        """The robots' newest shapes."""
        return {entity.id: entity for entity in self.messages["/fleet"][-1].entities}

    @property
    def states(self) -> dict[str, str]:
        """How the robots are doing, as it was said last."""
        return {robot: entity.metadata[0].value for robot, entity in self.bodies.items()}

    @property
    def log(self) -> list[tuple[int, str, str]]:
        """Level, name and words of every line."""
        return [(line.level, line.name, line.message) for line in self.messages["/log"]]


def heading(rotation: Any) -> float:
    """Return the angle of a turn about z [rad]."""
    assert rotation.x == rotation.y == 0.0
    return 2 * math.atan2(rotation.z, rotation.w)


def instant_ns(stamp: Any) -> int:
    """Return a date on the recorder's clock."""
    return int(stamp.seconds) * S + int(stamp.nanos) - EPOCH_NS

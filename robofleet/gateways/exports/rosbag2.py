"""A recorded run as a ROS 2 bag (MCAP, CDR, types of Jazzy), without ROS: what ``robofleet ros2`` would have published.

The run's messages are published again, on a bus in memory, to the same publication that a node has.
"""

from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from rosbags.interfaces import Nodetype, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import BUSY, NEWS, NOTE, STATE, STATUS, TICK, named
from robofleet.bus.messages import TICK_RECORD
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import S, SimulatedClock
from robofleet.gateways.place import Served
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Messages, single
from robofleet.gateways.ros2.publication import Publication
from robofleet.gateways.ros2.topics import Frames, Quality, Topic
from robofleet.gateways.urdf import BASE
from robofleet.recording.reading import about, messages
from robofleet.recording.scenes.scene import Scene
from robofleet.vehicles.differential_drive import body_from_wheels

_TIME_END_S = 2**31 - 1  # of ROS's time
_FOREVER = QosTime(2**31 - 1, 999_999_999)
_LOG = Topic("/rosout", "rcl_interfaces/msg/Log", "", topics.MANY, "what happened, in words")
_COMMANDED = topics.COMMAND._replace(type="geometry_msgs/msg/TwistStamped", quality=topics.PLAIN)
_LEFT_OUT = (topics.IMAGE,)  # the JPEGs are there
_LEVEL_STEP = 10  # of ROS's levels of a log; Foxglove's are 1, 2, ...
_HAPPENED = (STATE, NEWS, BUSY, STATUS, NOTE)  # what a log's lines are made of


def write(run: Path, folder: Path) -> None:
    """Write the bag of a run into a folder that is not there yet.

    Raises:
        RecordingError: The recording cannot be read.
        OSError: The bag cannot be written.
    """
    recording = about(run)
    config, provenance = recording.config, recording.provenance
    clock = SimulatedClock()
    bus = MemoryBus(config.arena.name, clock, 0)
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        bag = _Bag(writer, clock, 0 if provenance is None else provenance.epoch_ns)
        publication, pending = None, list[int]()
        commanded, happened = None, _Log(bag, Scene(config, recording.groups))
        for full, message in messages(run):
            clock.advance_to(max(clock.now_ns(), message.log_ns))
            if publication is None:
                publication = Publication(bag, config, bus, pending.append, Served(lambda: False, clock.now_ns()))
                commanded = _Commanded(bag, config, publication)
            found = named(full)
            if found is None or found[0].by_sender:
                continue
            bus.publisher(*found)(message.data)
            if pending:
                pending.clear()
                publication.step()
            if found[0] == TICK and commanded is not None:
                commanded.take(message.data)
            if found[0] in _HAPPENED:
                happened.take(full, message.data)


class _Bag:
    """A graph whose publishers write into a bag."""

    has_transforms = True

    def __init__(self, writer: Writer, clock: SimulatedClock, epoch_ns: int) -> None:
        self.writer, self.clock, self.frames = writer, clock, Frames()
        self.store = get_typestore(Stores.ROS2_JAZZY)
        self.messages = Messages(partial(_with_defaults, self.store))
        self._epoch_ns = epoch_ns

    def publisher(self, topic: Topic, *names: object) -> "_Publisher":
        return _Publisher(self, topic, "/" + topic.name.format(*names).lstrip("/"))

    def now_ns(self) -> int:
        return self.clock.now_ns() + self._epoch_ns

    def stamp(self, instant_ns: int) -> Any:
        seconds, nanoseconds = divmod(max(0, instant_ns + self._epoch_ns), S)
        return self.messages.Time(sec=min(seconds, _TIME_END_S), nanosec=nanoseconds)


class _Publisher:
    """Writes the messages of a topic; the bag knows the topic from its first message on."""

    def __init__(self, bag: _Bag, topic: Topic, name: str) -> None:
        self._bag, self._topic, self._name = bag, topic, name
        self._connection: Any = None

    def get_subscription_count(self) -> int:
        return int(self._topic not in _LEFT_OUT)

    def publish(self, message: Any) -> None:
        bag, topic = self._bag, self._topic
        if self._connection is None:
            self._connection = bag.writer.add_connection(
                self._name, topic.type, typestore=bag.store, offered_qos_profiles=[_offered(topic.quality)]
            )
        bag.writer.write(self._connection, bag.now_ns(), bag.store.serialize_cdr(message, topic.type))


class _Commanded:
    """What the controller commands each robot at each tick, as the velocity of its body: ``cmd_vel``."""

    def __init__(self, bag: _Bag, config: Config, publication: Publication) -> None:
        self._bag, self._ticks = bag, publication.ticks
        self._message = bag.messages.TwistStamped()
        self._robots = []
        for robot in config.members:
            name, drive = publication.names[robot.id], slices.drive(robot)
            frame = bag.frames.link(name, BASE)
            self._robots.append((bag.publisher(_COMMANDED, name), frame, drive.wheel_radius, drive.wheel_base))

    def take(self, payload: bytes) -> None:
        record, message = TICK_RECORD.decode(payload), self._message
        if record is None or len(record.robots) != len(self._robots):
            return
        message.header.stamp = self._bag.stamp(self._ticks.instant(record.tick))
        for (publisher, frame, radius, base), robot in zip(self._robots, record.robots, strict=True):
            message.header.frame_id = frame
            twist = message.twist
            twist.linear.x, twist.angular.z = body_from_wheels(robot.left_rad_s, robot.right_rad_s, radius, base)
            publisher.publish(message)


class _Log:
    """What happened, in the words that viewers show."""

    def __init__(self, bag: _Bag, scene: Scene) -> None:
        self._bag, self._scene = bag, scene
        self._publisher = bag.publisher(_LOG)

    def take(self, full: str, payload: bytes) -> None:
        now_ns = self._bag.clock.now_ns()
        for topic, data in self._scene.update(full, payload, now_ns):
            if topic == "/log":
                line = Log.FromString(data)
                self._publisher.publish(self._bag.messages.Log(
                    stamp=self._bag.stamp(now_ns), level=_LEVEL_STEP * line.level, name=line.name, msg=line.message
                ))  # fmt: skip


def _offered(quality: Quality) -> Qos:
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=quality.depth,
        reliability=QosReliability.RELIABLE if quality.reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if quality.latched else QosDurability.VOLATILE,
        deadline=_FOREVER,
        lifespan=_FOREVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_FOREVER,
        avoid_ros_namespace_conventions=False,
    )


_NUMBERS = {"byte": "uint8", "char": "uint8", "bool": "bool"}
_UNTURNED = "geometry_msgs/msg/Quaternion"  # w is 1 where nobody says otherwise


@cache
def _with_defaults(store: Any, name: str) -> Any:
    """Return a type of messages whose fields have ROS's defaults, and whose arrays take any sequence of numbers."""
    kind, fields = store.types[name], store.fielddefs[name][1]
    arrays = {field: _numbers(description) for field, description in fields}
    singles = {field for field, (node, value) in fields if node == Nodetype.BASE and value[0] == "float32"}

    def begin(self: Any, **values: Any) -> None:
        for field, description in fields:
            setattr(self, field, values.pop(field) if field in values else _default(store, description))
        if name == _UNTURNED and not self.w and not (self.x or self.y or self.z):
            self.w = 1.0
        if values:
            raise TypeError(f"{name} has no {', '.join(values)}")

    def assign(self: Any, field: str, value: Any) -> None:
        if (dtype := arrays.get(field)) is not None:
            value = np.frombuffer(value, dtype) if isinstance(value, bytes) else np.asarray(value, dtype)
        elif field in singles:
            value = single(value)
        object.__setattr__(self, field, value)

    own: dict[str, Any] = {"__init__": begin}
    if singles or any(arrays.values()):
        own["__setattr__"] = assign
    return type(kind.__name__, (kind,), own)


def _numbers(description: Any) -> np.dtype[Any] | None:
    """Return the type of the elements of a field that is an array or a sequence of numbers; None: it is neither."""
    node, value = description
    if node not in (Nodetype.ARRAY, Nodetype.SEQUENCE) or value[0][0] != Nodetype.BASE or value[0][1][0] == "string":
        return None
    element = value[0][1][0]
    return np.dtype(str(_NUMBERS.get(element, element)))


def _default(store: Any, description: Any) -> Any:
    node, value = description
    if node == Nodetype.BASE:
        return "" if value[0] == "string" else False if value[0] == "bool" else 0.0 if "float" in value[0] else 0
    if node == Nodetype.NAME:
        return _with_defaults(store, value)()
    dtype, count = _numbers(description), value[1] if node == Nodetype.ARRAY else 0
    return np.zeros(count, dtype) if dtype is not None else [_default(store, value[0]) for _ in range(count)]

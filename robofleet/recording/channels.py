"""The channels of a run's file: which keys a run has, and the schemas by which a stranger decodes their messages."""

from collections.abc import Iterator
from typing import NamedTuple

from robofleet.bus.keys import BUSY, NEWS, NOTE, OF_UNITS, PICTURE, POSES, RECORDER, SENSORS, STATE, TICK, key, named
from robofleet.bus.layouts import VERSION
from robofleet.bus.setpoints import setpoint_topics
from robofleet.config.tree import Config
from robofleet.core.valid_json import dumps

ENCODING = f"robofleet-{VERSION}"  # of this project's own messages
SCHEMA_ENCODING = "numpy"  # a JSON object of dtypes
PROTOBUF = "protobuf"
_ABOUT_ALL, _ABOUT_CAMERA = (TICK, STATE, RECORDER, BUSY), (POSES, NEWS, PICTURE)
_OTHER = "Bytes", {"fields": [], "rest": "bytes"}  # text of requests, and what is not known


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


def of_protobuf(topic: str, message: str, descriptor: bytes) -> Channel:
    """Return the channel of messages by their full name and their FileDescriptorSet."""
    return Channel(topic, PROTOBUF, message, PROTOBUF, descriptor)


def keys(config: Config) -> Iterator[str]:
    """Yield the full keys that are known from the configuration."""
    arena = config.arena.name
    yield from (key(arena, topic) for topic in _ABOUT_ALL)
    yield from (key(arena, topic, camera) for camera in config.camera_names for topic in _ABOUT_CAMERA)
    yield from (key(arena, topic, unit) for unit in config.units for topic in OF_UNITS)
    for group, setpoints in setpoint_topics(config).items():
        yield from (key(arena, topic, group) for topic in (setpoints, NOTE))
    yield from (key(arena, SENSORS, unit) for unit in config.sensing)


def schema(full: str) -> tuple[str, bytes]:
    """Return name and description of a key's messages: ``fields``, then ``items`` or ``rest``, if there are any."""
    topic = named(full)
    layout = None if topic is None else topic[0].layout
    name, parts = _OTHER if layout is None else layout.describe()
    return f"robofleet.{name}", dumps(parts).encode()

"""The channels of a run's file: which keys a run has, and a description by which a stranger decodes their messages."""

from collections.abc import Iterator
from typing import Any

from robofleet.comms.keys import (
    BUSY,
    CAMERA,
    COMMAND,
    ENABLE,
    LEASE,
    NEWS,
    PICTURE,
    POSES,
    RECORDER,
    STATE,
    STATUS,
    TICK,
    TRUTH,
    Topic,
    key,
    named,
)
from robofleet.comms.layouts import VERSION, BlobLayout, Layout, ListLayout
from robofleet.comms.messages import (
    BUSY_MACHINE,
    FLEET_POSES,
    LEASE_REQUEST,
    RECORDER_STATUS,
    ROBOT_STATUS,
    RUN_STATE,
    TICK_RECORD,
    TRACKER_NEWS,
    WHEEL_COMMAND,
)
from robofleet.comms.messages import (
    ENABLE as ENABLE_LAYOUT,
)
from robofleet.comms.messages import (
    PICTURE as PICTURE_LAYOUT,
)
from robofleet.comms.messages import (
    TRUTH as TRUTH_LAYOUT,
)
from robofleet.config.tree import Config
from robofleet.valid_json import dumps

ENCODING = f"robofleet-{VERSION}"  # of this project's own messages
SCHEMA_ENCODING = "numpy"  # a JSON object of dtypes
_LAYOUTS: dict[Topic, Layout[Any] | ListLayout[Any] | BlobLayout[Any]] = {
    COMMAND: WHEEL_COMMAND,
    STATUS: ROBOT_STATUS,
    ENABLE: ENABLE_LAYOUT,
    LEASE: LEASE_REQUEST,
    POSES: FLEET_POSES,
    NEWS: TRACKER_NEWS,
    PICTURE: PICTURE_LAYOUT,
    TICK: TICK_RECORD,
    STATE: RUN_STATE,
    BUSY: BUSY_MACHINE,
    RECORDER: RECORDER_STATUS,
    TRUTH: TRUTH_LAYOUT,
}
_ABOUT_ALL, _ABOUT_CAMERA = (TICK, STATE, RECORDER, BUSY), (POSES, NEWS, PICTURE)
_ABOUT_ROBOTS = COMMAND, STATUS, ENABLE, LEASE, TRUTH
_OTHER = "Bytes", {"fields": [], "rest": "bytes"}  # text of requests, and what is not known


def keys(config: Config) -> Iterator[str]:
    """Yield the full keys that are known from the configuration."""
    arena = config.arena.name
    yield from (key(arena, topic) for topic in _ABOUT_ALL)
    yield from (key(arena, topic, CAMERA) for topic in _ABOUT_CAMERA)
    yield from (key(arena, topic, robot.id) for robot in config.robots for topic in _ABOUT_ROBOTS)


def schema(full: str) -> tuple[str, bytes]:
    """Return name and description of a key's messages: ``fields``, then ``items`` or ``rest``, if there are any."""
    topic = named(full)
    layout = None if topic is None else _LAYOUTS.get(topic[0])
    name, parts = _OTHER if layout is None else layout.describe()
    return f"robofleet.{name}", dumps(parts).encode()

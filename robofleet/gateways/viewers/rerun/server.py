"""The server: what viewers draw of a run. rerun's own importer reads messages as it reads those of a recording.

The library keeps what was told for who comes late, up to a limit of memory, and writes to each viewer in threads of
its own. Shapes and outlines, which the importer takes as text, become archetypes here.
"""

import os
import socket
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.writer import CompressionType, Writer
from rerun.chunk import McapReader

from robofleet.core.clock import MS, S, WallClock
from robofleet.gateways.viewers.rerun.shapes import of_annotations, of_entity
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.gateways.viewers.server import Run
from robofleet.operator.viewer_address import Address
from robofleet.recording.channels import PROTOBUF, Channel
from robofleet.recording.run import Recording
from robofleet.reports.layouts.rerun_blueprint import APPLICATION, TIMELINE, blueprint

MEMORY = "256MB"  # for who comes late: with pictures some twenty minutes of four robots
_FREQUENT = "/robots/"  # many messages of such a topic at once cost hardly more than one
_FREQUENT_PERIOD_NS = S // 2
_REPEAT_NS = 20 * S  # of what is told seldom, which the limit may cost who comes late
_LISTENS_WITHIN_NS = 5 * S
_POLL_NS = 10 * MS
_LEAVE_WITHIN_S = 0.5
_ONCE = "/log"  # a line is not said again


class _Message(NamedTuple):
    topic: str
    log_ns: int
    data: bytes


class Server:
    """Serves until ``close``; OSError where its address cannot be used."""

    def __init__(self, name: str, at: Address, shown: Any, channels: Sequence[Channel], memory: str = MEMORY) -> None:
        """Take the run's name, its blueprint, and how much memory is kept for who comes late."""
        own = at.settled()
        sink = rr.GrpcServerSink(_number(own), own.port, server_memory_limit=memory)
        self.url: str = sink.uri
        self.address = f"rerun: rerun {self.url}"
        self._recording = rr.RecordingStream(APPLICATION)
        self._recording.set_log_time_enabled(False)  # a file has its messages' times only
        self._recording.set_sinks(sink)
        _wait_for(own)
        self._recording.send_recording_name(name)
        self._recording.send_blueprint(shown)
        self._channels = {channel.topic: channel for channel in channels if channel.encoding == PROTOBUF}
        self._retained = RetainedMessages()
        self._prompt, self._frequent = list[_Message](), list[_Message]()  # messages that wait for the importer
        self._imported_ns = self._repeated_ns = 0
        self._planes: dict[str, rr.CoordinateFrame] = {}  # of the newest picture of each camera
        self._has: dict[str, set[type]] = {}  # what an entity consists of

    def tell(self, topic: str, log_ns: int, message: bytes) -> None:
        """Take a message; the bus's own are nothing that rerun draws."""
        self._retained.take(topic, message)
        if (channel := self._channels.get(topic)) is None:
            return
        if channel.schema == SceneUpdate.DESCRIPTOR.full_name:
            self._scene(topic, log_ns, SceneUpdate.FromString(message))
        elif channel.schema == ImageAnnotations.DESCRIPTOR.full_name:
            self._annotations(topic, log_ns, ImageAnnotations.FromString(message))
        else:
            if channel.schema == CompressedImage.DESCRIPTOR.full_name:
                camera = CompressedImage.FromString(message).frame_id
                self._planes[_camera(topic)] = rr.CoordinateFrame(f"{camera}_image_plane")  # the importer's name
            waiting = self._frequent if topic.startswith(_FREQUENT) else self._prompt
            waiting.append(_Message(topic, log_ns, message))

    def step(self, log_ns: int) -> None:
        """Show new messages, and repeat rare ones from time to time."""
        if log_ns - self._repeated_ns >= _REPEAT_NS:
            for topic in self._channels:
                if self._repeated_ns and topic != _ONCE and (message := self._retained.of(topic)) is not None:
                    self.tell(topic, log_ns, message)
            self._repeated_ns = log_ns
        self._import(self._prompt)
        if log_ns - self._imported_ns >= _FREQUENT_PERIOD_NS:
            self._import(self._frequent)
            self._imported_ns = log_ns

    def close(self) -> None:
        self._import(self._prompt + self._frequent)
        with suppress(TimeoutError):
            self._recording.flush(timeout_sec=_LEAVE_WITHIN_S)
        self._recording.disconnect()
        del self._recording  # the library's server ends with it

    def _import(self, messages: list[_Message]) -> None:
        """Show messages as rerun's importer reads them in a recording, and forget them."""
        if messages:
            with os.fdopen(os.memfd_create("robofleet"), "wb") as file:
                self._write(Writer(file, compression=CompressionType.NONE), messages)
                file.flush()
                chunks = McapReader(f"/proc/self/fd/{file.fileno()}").stream()
                self._recording.send_chunks(chunks.filter(is_static=False))
            messages.clear()

    def _write(self, writer: Writer, messages: Sequence[_Message]) -> None:
        writer.start()
        numbers: dict[str, int] = {}
        for topic in dict.fromkeys(message.topic for message in messages):
            channel = self._channels[topic]
            schema = writer.register_schema(channel.schema, channel.schema_encoding, channel.description)
            numbers[topic] = writer.register_channel(topic, channel.encoding, schema)
        for topic, log_ns, data in messages:
            writer.add_message(numbers[topic], log_ns, data, log_ns)
        writer.finish()  # type: ignore[no-untyped-call]

    def _log(self, path: str, log_ns: int, *archetypes: rr.AsComponents) -> None:
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(log_ns, "ns"))
        self._recording.log(path, *archetypes)

    def _annotations(self, topic: str, log_ns: int, outlines: ImageAnnotations) -> None:
        if (plane := self._planes.get(_camera(topic))) is not None:  # its picture came before it
            self._log(topic, log_ns, plane, *of_annotations(outlines))

    def _scene(self, topic: str, log_ns: int, update: SceneUpdate) -> None:
        """Show entities below their topic: they stay until they are taken away, or told anew."""
        for gone in update.deletions:
            path = topic if gone.type == SceneEntityDeletion.ALL else _below(topic, gone.id)
            self._log(path, log_ns, rr.Clear(recursive=True))
        for entity in update.entities:
            self._entity(_below(topic, entity.id), log_ns, entity)

    def _entity(self, path: str, log_ns: int, entity: SceneEntity) -> None:
        shown = [*of_entity(entity)]
        kinds = {type(shape) for shape in shown}
        if self._has.get(path, kinds) - kinds:
            self._log(path, log_ns, rr.Clear(recursive=False))
        self._has[path] = kinds
        self._log(path, log_ns, *shown)


def opened(run: Run, at: Address, channels: Sequence[Channel]) -> Server:
    """Open the server of a run; OSError where its address cannot be used."""
    return Server(run.config.arena.name, at, blueprint(Recording(run.config)), channels)


def _below(topic: str, entity: str) -> str:
    return topic + rr.new_entity_path(entity.split("/"))


def _camera(topic: str) -> str:
    """Return below which topic a camera's messages are."""
    return topic.rpartition("/")[0]


def _number(at: Address) -> str:
    """Return a host as the library takes it."""
    return f"[{at.host}]" if ":" in at.host else socket.gethostbyname(at.host)


def _wait_for(at: Address) -> None:
    """Return when the library listens, which it does in a thread; OSError where it does not."""
    clock = WallClock()
    end_ns = clock.now_ns() + _LISTENS_WITHIN_NS
    while True:
        try:
            socket.create_connection((at.host, at.port), _LISTENS_WITHIN_NS / S).close()
        except OSError:
            if clock.now_ns() > end_ns:
                raise
            clock.sleep_until(clock.now_ns() + _POLL_NS)
        else:
            return

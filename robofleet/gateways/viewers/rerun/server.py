"""The server: what viewers draw of a run, under the names that rerun's importer gives to a file's messages.

The library keeps what was told for who comes late, up to a limit of memory, and writes to each viewer in threads of
its own. Shapes and outlines, which the importer takes as text, become archetypes here.
"""

import socket
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from robofleet.core.clock import MS, S, WallClock
from robofleet.gateways.viewers.rerun import columns
from robofleet.gateways.viewers.rerun.shapes import of_annotations, of_entity
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.gateways.viewers.server import Opened, Run
from robofleet.operator.viewer_address import Address
from robofleet.recording.channels import PROTOBUF, Channel
from robofleet.recording.run import Recording
from robofleet.reports.layouts.rerun_blueprint import APPLICATION, TIMELINE, blueprint

MEMORY = "256MB"  # for who comes late: with pictures some twenty minutes of four robots
_OFTEN = "/tf"  # moves the robots: nothing waits there
_ROWS_PERIOD_NS = S // 2  # of every other topic that has columns
_REPEAT_NS = 20 * S  # of what is told seldom, which the limit may cost who comes late
_LISTENS_WITHIN_NS = 5 * S
_POLL_NS = 10 * MS
_LEAVE_WITHIN_S = 0.5
_ONCE = "/log"  # a line is not said again
_LEVELS = {Log.DEBUG: "DEBUG", Log.INFO: "INFO", Log.WARNING: "WARN", Log.ERROR: "ERROR", Log.FATAL: "CRITICAL"}


class Server:
    """Serves until ``close``; OSError where its address cannot be used."""

    def __init__(self, name: str, at: Address, shown: Any, channels: Sequence[Channel], memory: str = MEMORY) -> None:
        """Take the run's name, its blueprint, and how much memory is kept for who comes late."""
        own = at.settled()
        sink = rr.GrpcServerSink(_number(own), own.port, server_memory_limit=memory)
        self.url: str = sink.uri
        self._recording = rr.RecordingStream(APPLICATION)
        self._recording.set_log_time_enabled(False)  # a file has its messages' times only
        self._recording.set_sinks(sink)
        _wait_for(own)
        self._recording.send_recording_name(name)
        self._recording.send_blueprint(shown)
        drawn = [channel for channel in channels if channel.encoding == PROTOBUF]
        self._columns = {channel.topic: kind for channel in drawn if (kind := columns.kind(channel)) is not None}
        self._singles = {
            channel.topic: self._single(channel) for channel in drawn if channel.topic not in self._columns
        }
        self._kept, self._rows = RetainedMessages(), dict[str, list[columns.Row]]()
        self._sent_ns = self._again_ns = 0
        self._has: dict[str, set[type]] = {}  # what an entity consists of
        self._planes: dict[str, rr.CoordinateFrame] = {}  # of the newest picture of each camera

    def tell(self, topic: str, log_ns: int, message: bytes) -> None:
        """Take a message; the bus's own are nothing that rerun draws."""
        self._kept.take(topic, message)
        if (kind := self._columns.get(topic)) is not None:
            self._rows.setdefault(topic, []).extend(kind.rows(log_ns, message))
        elif (single := self._singles.get(topic)) is not None:
            single(log_ns, message)

    def step(self, log_ns: int) -> None:
        """Show new messages, and repeat rare ones from time to time."""
        if log_ns - self._again_ns >= _REPEAT_NS:
            for topic in (*self._columns, *self._singles):
                if self._again_ns and topic != _ONCE and (message := self._kept.of(topic)) is not None:
                    self.tell(topic, log_ns, message)
            self._again_ns = log_ns
        self._send([_OFTEN])
        if log_ns - self._sent_ns >= _ROWS_PERIOD_NS:
            self._send([*self._rows])
            self._sent_ns = log_ns

    def close(self) -> None:
        """Close every viewer's connection."""
        self._send([*self._rows])
        with suppress(TimeoutError):
            self._recording.flush(timeout_sec=_LEAVE_WITHIN_S)
        self._recording.disconnect()
        del self._recording  # the library's server ends with it

    def _send(self, topics: Iterable[str]) -> None:
        for topic in topics:
            if rows := self._rows.pop(topic, []):
                columns.send(self._recording, topic, rows, self._columns[topic])

    def _single(self, channel: Channel) -> Callable[[int, bytes], None]:
        senders: dict[str, Callable[[str, int, bytes], None]] = {
            CompressedImage.DESCRIPTOR.full_name: self._picture,
            ImageAnnotations.DESCRIPTOR.full_name: self._annotations,
            CameraCalibration.DESCRIPTOR.full_name: self._lens,
            Log.DESCRIPTOR.full_name: self._line,
            SceneUpdate.DESCRIPTOR.full_name: self._scene,
        }
        return partial(senders[channel.schema], channel.topic)

    def _log(self, path: str, log_ns: int, stamp_ns: int | None, *what: rr.AsComponents) -> None:
        """Show archetypes of an entity at a time."""
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(log_ns, "ns"))
        if stamp_ns is None:
            self._recording.disable_timeline(columns.STAMPED)
        else:
            self._recording.set_time(columns.STAMPED, timestamp=np.datetime64(stamp_ns, "ns"))
        self._recording.log(path, *what)

    def _picture(self, topic: str, log_ns: int, message: bytes) -> None:
        picture = CompressedImage.FromString(message)
        shown = rr.EncodedImage(contents=picture.data, media_type=f"image/{picture.format}")
        frame = self._planes[_camera(topic)] = rr.CoordinateFrame(_plane(picture.frame_id))
        self._log(topic, log_ns, columns.date_ns(picture.timestamp), frame, shown)

    def _annotations(self, topic: str, log_ns: int, message: bytes) -> None:
        if (frame := self._planes.get(_camera(topic))) is not None:  # its picture came before it
            self._log(topic, log_ns, None, frame, *of_annotations(ImageAnnotations.FromString(message)))

    def _lens(self, topic: str, log_ns: int, message: bytes) -> None:
        lens = CameraCalibration.FromString(message)
        pinhole = rr.Pinhole(
            image_from_camera=np.reshape(lens.K, (3, 3)), resolution=(lens.width, lens.height),
            parent_frame=lens.frame_id, child_frame=_plane(lens.frame_id),
        )  # fmt: skip
        self._log(topic, log_ns, columns.date_ns(lens.timestamp), pinhole)

    def _line(self, topic: str, log_ns: int, message: bytes) -> None:
        line = Log.FromString(message)
        text = rr.TextLog(line.message, level=_LEVELS.get(line.level))
        self._log(topic, log_ns, columns.date_ns(line.timestamp), text)

    def _scene(self, topic: str, log_ns: int, message: bytes) -> None:
        """Show entities below their topic: they stay until they are taken away, or told anew."""
        update = SceneUpdate.FromString(message)
        for gone in update.deletions:
            path = topic if gone.type == SceneEntityDeletion.ALL else _below(topic, gone.id)
            self._log(path, log_ns, None, rr.Clear(recursive=True))
        for entity in update.entities:
            self._entity(_below(topic, entity.id), log_ns, entity)

    def _entity(self, path: str, log_ns: int, entity: SceneEntity) -> None:
        shown = [*of_entity(entity)]
        kinds = {type(shape) for shape in shown}
        if self._has.get(path, kinds) - kinds:
            self._log(path, log_ns, None, rr.Clear(recursive=False))
        self._has[path] = kinds
        self._log(path, log_ns, None, *shown)


def opened(run: Run, at: Address, channels: Sequence[Channel]) -> Opened:
    """Open the server of a run; OSError where its address cannot be used."""
    server = Server(run.config.arena.name, at, blueprint(Recording(run.config)), channels)
    return Opened(server, f"rerun: rerun {server.url}")


def _below(topic: str, entity: str) -> str:
    return topic + rr.new_entity_path(entity.split("/"))


def _camera(topic: str) -> str:
    """Return below which topic a camera's messages are."""
    return topic.rpartition("/")[0]


def _plane(camera: str) -> str:
    """Return the frame of a camera's pictures, as the importer calls it."""
    return f"{camera}_image_plane"


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

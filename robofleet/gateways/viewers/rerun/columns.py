"""What comes often, in columns: many rows of a topic at once cost rerun hardly more than one."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from robofleet.core.clock import S
from robofleet.recording.channels import Channel
from robofleet.recording.scenes.scalars import table
from robofleet.reports.layouts.rerun_blueprint import TIMELINE

STAMPED = "timestamp"  # the importer's name of the date in a message


class Row(NamedTuple):
    """What a row of an entity is made of."""

    log_ns: int
    stamp_ns: int | None  # the date in the message, where it has one
    archetype: Any


class Kind(NamedTuple):
    """How messages of a schema become rows, and rows columns."""

    rows: Callable[[int, bytes], Iterable[Row]]  # of a message with its log time
    columns: Callable[[Sequence[Any]], Iterable[rr.ComponentColumn]]


def kind(channel: Channel) -> Kind | None:
    """Return how a channel's messages become columns; None where they come seldom."""
    if channel.schema == FrameTransforms.DESCRIPTOR.full_name:
        return Kind(_frames, _transforms)
    if channel.schema == PoseInFrame.DESCRIPTOR.full_name:
        return Kind(_pose, _poses)
    if channel.schema.startswith("foxglove."):
        return None
    return Kind(lambda log_ns, message: (Row(log_ns, None, message),), lambda messages: _scalars(channel, messages))


def send(recording: rr.RecordingStream, path: str, rows: Sequence[Row], kind: Kind) -> None:
    """Send the rows of an entity."""
    times = [_times(TIMELINE, [row.log_ns for row in rows])]
    if rows[0].stamp_ns is not None:
        times.append(_times(STAMPED, [row.stamp_ns or 0 for row in rows]))
    recording.send_columns(path, times, kind.columns([row.archetype for row in rows]))


def date_ns(at: Timestamp) -> int:
    """Return a date [ns since 1970]."""
    return at.seconds * S + at.nanos


def _times(timeline: str, dates_ns: list[int]) -> rr.TimeColumn:
    return rr.TimeColumn(timeline, timestamp=np.array(dates_ns, "datetime64[ns]"))


def _frames(log_ns: int, message: bytes) -> Iterator[Row]:
    for frame in FrameTransforms.FromString(message).transforms:
        yield Row(log_ns, date_ns(frame.timestamp), frame)


def _pose(log_ns: int, message: bytes) -> Iterator[Row]:
    pose = PoseInFrame.FromString(message)
    yield Row(log_ns, date_ns(pose.timestamp), pose)


def _transforms(frames: Sequence[FrameTransform]) -> Iterable[rr.ComponentColumn]:
    return rr.Transform3D.columns(
        child_frame=[frame.child_frame_id for frame in frames],
        parent_frame=[frame.parent_frame_id for frame in frames],
        translation=_xyz(frame.translation for frame in frames),
        quaternion=_turns(frame.rotation for frame in frames),
    )


def _poses(poses: Sequence[PoseInFrame]) -> Iterable[rr.ComponentColumn]:
    places = rr.InstancePoses3D.columns(
        translations=_xyz(pose.pose.position for pose in poses),
        quaternions=_turns(pose.pose.orientation for pose in poses),
    )
    return *rr.CoordinateFrame.columns(frame=[pose.frame_id for pose in poses]), *places


def _scalars(channel: Channel, messages: Sequence[bytes]) -> Iterable[rr.ComponentColumn]:
    rows, name = table(channel.description, messages), f"{channel.schema}:message"
    names = rows.dtype.names or ()
    parts = [pa.array(np.ascontiguousarray(rows[own])) for own in names]
    fields = [pa.field(own, part.type, nullable=False) for own, part in zip(names, parts, strict=True)]
    values = pa.StructArray.from_arrays(parts, fields=fields)
    described = rr.ComponentDescriptor(name, archetype=channel.schema)
    return (rr.ComponentColumn(described, rr.AnyBatchValue(described, values)),)


def _xyz(vectors: Iterable[Vector3]) -> list[tuple[float, float, float]]:
    return [(vector.x, vector.y, vector.z) for vector in vectors]


def _turns(rotations: Iterable[Quaternion]) -> list[tuple[float, float, float, float]]:
    return [(rotation.x, rotation.y, rotation.z, rotation.w) for rotation in rotations]

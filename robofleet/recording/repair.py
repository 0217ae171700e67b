"""Gives a killed run's file its index, so that every tool opens it."""

import fcntl
import os
from collections.abc import Iterator
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Channel, Header, Metadata, Schema

from robofleet.core.files import replaced
from robofleet.recording.chunks import Content, Message
from robofleet.recording.container import Container
from robofleet.recording.reading import RecordingError, check_maker, file_of, nothing, opened, own, scanned
from robofleet.recording.scanning import Scan

_DAMAGED_SUFFIX = ".damaged"


@dataclass(frozen=True)
class Repair:
    """What came of a repair."""

    file: Path
    trouble: str | None  # what was wrong; None: nothing, and the file is as it was
    messages: int  # of this project's own that are in the file now
    span_ns: int  # from the first to the last of them
    lost: int  # [bytes] of the old file, behind the last good one
    kept: Path | None  # where the old file is, if more was wrong than a torn end


def repair(run: Path) -> Repair:
    """Mend the file of a run: everything up to where it is torn off or damaged, and an index.

    The old file is replaced by a whole new one, or left as it is.

    Raises:
        RecordingError: it is no recording, holds no message, or is still being written.
        OSError: the new file cannot be written; the old one is as it was.
    """
    file = file_of(run)
    with opened(file) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise RecordingError(f"{file}: is still being recorded: end the run first") from error
        scan = scanned(stream)
        times = [*_times(scan, file)]
        if not times:
            raise nothing(scan, file)
        kept = None if scan.trouble is None or scan.torn else file.with_name(file.name + _DAMAGED_SUFFIX)
        if scan.trouble is not None:
            stream.seek(0)
            _replace(file, stream, kept)
        return Repair(file, scan.trouble, len(times), max(times) - min(times), scan.lost, kept)


def _times(scan: Scan, file: Path) -> Iterator[int]:
    """Yield when each message came [ns]; those that only viewers read are not counted."""
    channels: dict[int, str] = {}
    for item in scan.items():
        if isinstance(item, Header):
            check_maker(item, file)
        elif isinstance(item, list):
            yield from (message.log_ns for _, message in own(item, channels))


def _replace(file: Path, old: BinaryIO, kept: Path | None) -> None:
    with replaced(file) as stream:
        _copy(scanned(old), stream, file)
        os.fsync(stream)
        if kept is not None:
            kept.hardlink_to(file)


def _copy(scan: Scan, new: FileIO, file: Path) -> None:
    """Write what is good, in the same order and the same chunks; RecordingError where another one numbered it."""
    for item in scan.items():
        if isinstance(item, Header):
            container = Container(new, item.profile, item.library)
        elif isinstance(item, Attachment | Metadata):
            container.write([item])
        else:
            for content in item:
                if not _add(container, content):
                    raise RecordingError(
                        f"{file}: is not a recording of robofleet: its channels are not in their order"
                    )
            container.write()
    container.finish()


def _add(container: Container, content: Content) -> bool:
    """Add one thing; returns whether its schemas and channels are numbered in the order in which they come."""
    match content:
        case Schema(id=number, name=name, encoding=encoding, data=data):
            return container.register_schema(name, encoding, data) == number
        case Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema):
            return container.register_channel(topic, encoding, schema) == number
        case Message():
            container.add_message(*content)
    return True

"""An MCAP file that grows by whole blocks: after a kill or on a full disk it is a valid beginning of itself.

``mcap.writer.Writer`` indexes and counts a chunk before it knows that the disk took it; here a block that does not fit
leaves no trace, and the next one goes on from there. The layouts of the records are the library's.
"""

import os
import zlib
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import FileIO
from operator import itemgetter

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

from robofleet.recording.chunks import MESSAGE_OVERHEAD, Waiting, encode, encode_chunk

FOOTER_CRC = 4  # [bytes] at the footer's end, of all that comes before since the end of the data


@dataclass(frozen=True)
class _Written:
    """What is in the file, and what its end will say of it."""

    size: int = 0  # [bytes]
    crc: int = 0
    definitions: int = 0  # how many of the schemas and channels
    counts: Counter[int] = field(default_factory=Counter)  # of messages, by channel
    times: tuple[int, ...] = ()  # first and last log time [ns]
    indexed: int = 0  # how many of the index's entries


class Container:
    """Writes messages in chunks, and single records between them. What is added waits in memory until ``write``."""

    def __init__(self, file: FileIO, profile: str, library: str) -> None:
        """Take an empty file, unbuffered; nothing is written yet."""
        self._file = file
        self._start = MAGIC + encode(Header(profile, library))
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._definitions: list[bytes] = []
        self._index: list[tuple[Opcode, bytes]] = []  # of attachments, metadata and chunks
        self._waiting: list[Waiting] = []
        self._written = _Written()
        self.waiting_bytes = 0

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        self._schemas.append(Schema(len(self._schemas) + 1, data, encoding, name))
        self._definitions.append(encode(self._schemas[-1]))
        return len(self._schemas)

    def register_channel(self, topic: str, message_encoding: str, schema: int) -> int:
        self._channels.append(Channel(len(self._channels) + 1, topic, message_encoding, {}, schema))
        self._definitions.append(encode(self._channels[-1]))
        return len(self._channels)

    def add_message(self, channel: int, sequence: int, log_ns: int, data: bytes) -> None:
        """Let a message wait for the next block."""
        self._waiting.append((channel, sequence, log_ns, data))
        self.waiting_bytes += MESSAGE_OVERHEAD + len(data)

    def discard(self) -> None:
        self._waiting, self.waiting_bytes = [], 0

    def write(self, records: Sequence[Attachment | Metadata] = ()) -> None:
        """Write records, and what waits as a chunk; after an OSError nothing of it is there and all of it waits."""
        if not (records or self._waiting):
            return
        was, messages = self._written, self._waiting
        block = bytearray() if was.size else bytearray(self._start)
        del self._index[was.indexed :]  # of a write that failed
        for record in records:
            data = encode(record)
            self._index.append(_index(record, was.size + len(block), len(data)))
            block += data
        if messages:
            chunk, chunk_index = encode_chunk(self._definitions[was.definitions :], messages, was.size + len(block))
            self._index.append((Opcode.CHUNK_INDEX, encode(chunk_index)))
            block += chunk
        times = *was.times, *map(itemgetter(2), messages)
        written = _Written(
            self._put(block),
            zlib.crc32(block, was.crc),
            len(self._definitions) if messages else was.definitions,
            was.counts + Counter(map(itemgetter(0), messages)),
            (min(times), max(times)) if times else (),
            len(self._index),
        )
        # No call between these: an interrupt leaves both or none.
        self._written = written
        self._waiting = []
        self.waiting_bytes = 0

    def finish(self) -> None:
        """Write what waits, then the end of the file: its index. After an OSError the file is as if it was killed."""
        self.write()
        was = self._written
        data_end = encode(DataEnd(was.crc))
        start = was.size + len(data_end)
        summary, offsets = bytearray(), bytearray()
        for opcode, group in self._summary().items():
            if group:
                offset = SummaryOffset(opcode, start + len(summary), sum(map(len, group)))
                offsets += encode(offset)
                summary += b"".join(group)
        footer = encode(Footer(start, start + len(summary), 0))[:-FOOTER_CRC]
        crc = zlib.crc32(summary + offsets + footer)
        self._put(data_end + summary + offsets + footer + crc.to_bytes(FOOTER_CRC, "little") + MAGIC)

    def _summary(self) -> dict[Opcode, Sequence[bytes]]:
        was = self._written
        indexes = defaultdict[Opcode, list[bytes]](list)
        for kind, entry in self._index[: was.indexed]:
            indexes[kind].append(entry)
        statistics = Statistics(
            attachment_count=len(indexes[Opcode.ATTACHMENT_INDEX]),
            channel_count=len(self._channels),
            channel_message_counts=dict(was.counts),
            chunk_count=len(indexes[Opcode.CHUNK_INDEX]),
            message_count=was.counts.total(),
            message_start_time=min(was.times, default=0),
            message_end_time=max(was.times, default=0),
            metadata_count=len(indexes[Opcode.METADATA_INDEX]),
            schema_count=len(self._schemas),
        )
        return {
            Opcode.SCHEMA: [*map(encode, self._schemas)],
            Opcode.CHANNEL: [*map(encode, self._channels)],
            Opcode.STATISTICS: [encode(statistics)],
            **indexes,
        }

    def _put(self, block: bytes | bytearray) -> int:
        """Write a block behind what is there, whole or not at all; returns the new size [bytes]."""
        end, left = self._written.size, memoryview(block)
        try:
            while left:
                count = os.pwrite(self._file.fileno(), left, end)
                end, left = end + count, left[count:]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file.fileno(), self._written.size)
            raise
        return end


def _index(record: Attachment | Metadata, at: int, length: int) -> tuple[Opcode, bytes]:
    """Return a record's entry in the index, for its place in the file and its length [bytes]."""
    if isinstance(record, Metadata):
        return Opcode.METADATA_INDEX, encode(MetadataIndex(at, length, record.name))
    size, times = len(record.data), (record.log_time, record.create_time)
    return Opcode.ATTACHMENT_INDEX, encode(AttachmentIndex(at, length, *times, size, record.name, record.media_type))

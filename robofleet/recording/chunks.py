"""A chunk of an MCAP file: definitions and messages, compressed and checked by their CRC. Layouts: mcap.dev/spec."""

import zlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from io import BytesIO
from operator import itemgetter
from struct import Struct, pack
from typing import NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Schema
from zstandard import ZstdCompressor, ZstdDecompressor, ZstdError, frame_content_size

from robofleet.core.errors import RobofleetError

RECORD = Struct("<BQ")  # opcode, bytes that follow
MESSAGE_OVERHEAD = 31  # [bytes] of a message beside its payload
_MESSAGE = Struct("<HIQQ")  # channel, sequence, log time and publish time [ns]; the payload follows
_RECORD_MESSAGE = Struct("<BQHIQQ")
MESSAGE_INDEX = Struct("<HI")  # channel, bytes that follow: log time and offset of each of its messages in a chunk
_OPCODE = int(Opcode.MESSAGE)
_COMPRESSION = "zstd"
_LEVEL = 3
LARGEST_CHUNK = 1 << 24  # [bytes] of its content: RunLog's hold 64 kB, or one message


Waiting = tuple[int, int, int, bytes]  # a message's channel, sequence, log time [ns] and payload


class Message(NamedTuple):
    """A message of a file."""

    channel: int
    sequence: int
    log_ns: int
    data: bytes


Content = Schema | Channel | Message


class DamageError(RobofleetError):
    """Raised where bytes of a recording are not what was written."""


def encode(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def encode_chunk(definitions: Sequence[bytes], messages: Sequence[Waiting], at: int) -> tuple[bytes, ChunkIndex]:
    """Return a chunk with its message indexes behind it, to stand at ``at`` in the file, and its entry in the index."""
    parts, offset, indexes = [*definitions], sum(map(len, definitions)), defaultdict[int, list[int]](list)
    for channel, sequence, log_ns, data in messages:
        indexes[channel] += log_ns, offset
        length = _MESSAGE.size + len(data)
        parts += _RECORD_MESSAGE.pack(_OPCODE, length, channel, sequence, log_ns, log_ns), data
        offset += RECORD.size + length
    content, times = b"".join(parts), [*map(itemgetter(2), messages)]
    packed, first, last = ZstdCompressor(_LEVEL).compress(content), min(times), max(times)
    block = bytearray(encode(Chunk(_COMPRESSION, packed, last, first, zlib.crc32(content), len(content))))
    length, offsets = len(block), dict[int, int]()
    for channel, index in indexes.items():
        offsets[channel] = at + len(block)
        body = MESSAGE_INDEX.pack(channel, 8 * len(index)) + pack(f"<{len(index)}Q", *index)
        block += RECORD.pack(Opcode.MESSAGE_INDEX, len(body)) + body
    index_length = len(block) - length
    entry = ChunkIndex(length, at, _COMPRESSION, len(packed), last, index_length, offsets, first, len(content))
    return bytes(block), entry


def decode_chunk(body: bytes) -> tuple[list[Content], int]:
    """Return what a chunk holds, in order, and how much that is [bytes].

    Raises:
        DamageError: it is not what was written, or more than any chunk holds; what it says of its size is believed
            only after that.
        McapError, ValueError, struct.error: so is what it holds.
    """
    content = _unpacked(body)
    return [*_contents(content)], len(content)


def stream(body: bytes) -> ReadDataStream:
    """Return the bytes of a record as the library's records read them."""
    return ReadDataStream(BytesIO(body))


def _unpacked(body: bytes) -> bytes:
    try:
        chunk = Chunk.read(stream(body))
        if chunk.compression != _COMPRESSION or frame_content_size(chunk.data) != chunk.uncompressed_size:
            raise DamageError
        if chunk.uncompressed_size > LARGEST_CHUNK:
            raise DamageError
        content = ZstdDecompressor().decompress(chunk.data)
    except (McapError, ZstdError, ValueError, MemoryError) as error:
        raise DamageError from error
    if zlib.crc32(content) != chunk.uncompressed_crc:
        raise DamageError
    return content


def _contents(content: bytes) -> Iterator[Content]:
    at, end = 0, len(content)
    while at < end:
        opcode, length = RECORD.unpack_from(content, at)
        at += RECORD.size
        if length > end - at:
            raise DamageError
        if opcode == _OPCODE:
            if length < _MESSAGE.size:
                raise DamageError
            channel, sequence, log_ns, _ = _MESSAGE.unpack_from(content, at)
            yield Message(channel, sequence, log_ns, content[at + _MESSAGE.size : at + length])
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(stream(content[at : at + length]))
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(stream(content[at : at + length]))
        at += length

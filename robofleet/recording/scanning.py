"""Walks through a run's file from its start, whole or not, and believes nothing that it cannot check."""

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, DataEnd, Footer, Header, Metadata
from mcap.writer import MCAP0_MAGIC as MAGIC

from robofleet.recording.chunks import MESSAGE_INDEX, RECORD, Content, DamageError, decode_chunk, stream
from robofleet.recording.container import FOOTER_CRC

_ATTACHMENT_CRC_BYTES = 4  # at its end
_LONGEST_RECORD_BYTES, _LONGEST_METADATA_BYTES = 1 << 26, 1 << 20  # a length beyond it is no length
_MOST_UNPACKED = 32  # times the bytes of the file so far, beside _GRANTED_BYTES: RunLog's content is packed to a half
_GRANTED_BYTES = 1 << 26
_START = (Opcode.HEADER,)
_DATA = (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.DATA_END)
_SUMMARY = (
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.STATISTICS,
    Opcode.CHUNK_INDEX,
    Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX,
    Opcode.SUMMARY_OFFSET,
    Opcode.FOOTER,
)

Item = Header | Attachment | Metadata | list[Content]  # the list: what a chunk holds
NO_MCAP = "is not an MCAP file"


class Scan:
    """The records of a file, up to where it ends, is torn off or damaged."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        """Take a file of ``size`` bytes; it is read once, without seeking."""
        self._file, self._size, self._read, self._crc = file, size, 0, 0
        self._unpacked = 0  # [bytes] of all chunks so far
        self.good = 0  # [bytes] from the start that are as they were written
        self.trouble: str | None = None  # what was met then; None: the file is whole
        self.torn = False  # it only ends too early

    @property
    def lost(self) -> int:
        """What follows the good bytes [bytes]."""
        return self._size - self.good

    def items(self) -> Iterator[Item]:
        """Yield what is whole, in order."""
        try:
            yield from self._items()
        except EOFError:
            self.torn, self.trouble = True, "ends before its index, as after a kill or on a full disk"
        except OSError as error:
            self.trouble = f"cannot be read {self.good} bytes from its start: {error.strerror}"
        except (DamageError, McapError, ValueError, OverflowError, struct.error):
            self.trouble = f"is damaged {self.good} bytes from its start"

    def _items(self) -> Iterator[Item]:
        if self._take(len(MAGIC)) != MAGIC:
            self.trouble = NO_MCAP
            return
        expected: tuple[Opcode, ...] = _START
        while True:
            self.good, crc = self._read, self._crc
            opcode, length = RECORD.unpack(self._take(RECORD.size))
            longest = _LONGEST_METADATA_BYTES if opcode == Opcode.METADATA else _LONGEST_RECORD_BYTES
            if opcode not in expected or length > longest:
                raise DamageError
            body = self._take(length)
            if opcode == Opcode.DATA_END:
                _check(crc, DataEnd.read(stream(body)).data_section_crc)
                expected, self._crc = _SUMMARY, 0
            elif opcode == Opcode.FOOTER:
                head = RECORD.pack(opcode, length) + body[:-FOOTER_CRC]
                _check(zlib.crc32(head, crc), Footer.read(stream(body)).summary_crc)
                break
            elif expected is _START:
                expected = _DATA
                yield Header.read(stream(body))
            elif expected is _DATA:
                yield from self._decoded(opcode, body)
        if self._take(len(MAGIC)) != MAGIC or self._read != self._size:
            raise DamageError
        self.good = self._size

    def _take(self, count: int) -> bytes:
        """Return the next bytes; EOFError where there are not so many."""
        data = self._file.read(count) if self._read + count <= self._size else b""
        if len(data) != count:
            raise EOFError
        self._read += count
        self._crc = zlib.crc32(data, self._crc)
        return data

    def _decoded(self, opcode: int, body: bytes) -> Iterator[Item]:
        """Yield what a record of the data is, if it is more than an index of what came before."""
        match opcode:
            case Opcode.ATTACHMENT:
                crc = int.from_bytes(body[-_ATTACHMENT_CRC_BYTES:], "little")
                _check(zlib.crc32(body[:-_ATTACHMENT_CRC_BYTES]), crc)
                yield Attachment.read(stream(body))
            case Opcode.METADATA:
                yield Metadata.read(stream(body))
            case Opcode.CHUNK:
                contents, size = decode_chunk(body)
                self._unpacked += size
                if self._unpacked > _GRANTED_BYTES + _MOST_UNPACKED * self._read:
                    raise DamageError
                yield contents
            case Opcode.MESSAGE_INDEX:
                _check(len(body), MESSAGE_INDEX.size + MESSAGE_INDEX.unpack_from(body)[1])  # else it was a chunk


def _check(found: int, should_be: int) -> None:
    if found != should_be:
        raise DamageError

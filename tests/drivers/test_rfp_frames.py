"""rfp/1: its reference in Python, and the same in C."""

import random
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.drivers.rfp_frames import (
    LINE_BYTES,
    Command,
    Gains,
    Health,
    Hello,
    Identity,
    Lease,
    LeaseAnswer,
    Message,
    Permission,
    Receiver,
    Settings,
    Status,
    body,
    frame,
    line,
    message,
)
from robofleet.simulation import firmware_library

MOTION = Command(3, 0xCAFEBABE, 70000, 7, 123456, -1024, 512)
MESSAGES: tuple[Message, ...] = (
    Hello(), MOTION, Permission(3, 9, 7, 123456, 0, 0, 6144), Lease(0xCAFEBABE, 1), Gains(96, 160, 683),
    Identity(1, b"uno".ljust(12, b"\0"), b"v1".ljust(16, b"\0"), 0xDEADBEEF, 8),
    Status(7, 123456, -5, 2**31 - 1, -1024, 512, 0, 0, 4, 2, 1, 17), LeaseAnswer(0xCAFEBABE, 3, 1),
    Health(3, 0xCAFEBABE, 9, 1, 2, 3, 7400, 120, -120, 118, -1, 400, 0, 4),
    Settings(575488, 32500, 6144, 9452, 6554, 1, 2, 3),
)  # fmt: skip


@pytest.fixture(scope="module")
def library() -> Any:
    return firmware_library.firmware_library({}, firmware_library.SOURCES)


class InC:
    """The receiver of the firmware."""

    def __init__(self, library: Any) -> None:
        self.ffi, self.c = library
        self.receiver = self.ffi.new("struct rfp_receiver *")

    def receive(self, data: bytes) -> Iterator[bytes]:
        for byte in data:
            if length := self.c.rfp_receive(self.receiver, byte):
                yield bytes(self.ffi.buffer(self.receiver.bytes, length))

    @property
    def struck(self) -> int:
        return int(self.receiver.struck)

    @property
    def lost(self) -> int:
        return int(self.receiver.lost)


@pytest.mark.parametrize("sent", MESSAGES, ids=lambda sent: type(sent).__name__)
def test_a_message_comes_as_it_was_sent(library: Any, sent: Message) -> None:
    on_line = frame(sent, 21)
    assert len(on_line) <= LINE_BYTES and on_line.index(0) == len(on_line) - 1
    for receiver in (Receiver(), InC(library)):
        (got,) = receiver.receive(on_line)
        assert message(got) == sent and got[0] & 15 == 5


def test_the_firmware_sends_the_same_frames(library: Any) -> None:
    ffi, c = library
    to = ffi.new("uint8_t[58]")
    texts = ffi.new("char[]", b"uno"), ffi.new("char[]", b"v1")
    identity = ffi.new("struct rfp_identity *", {"board": texts[0], "build": texts[1], "hash": 0xDEADBEEF, "reset": 8})
    by_fields = {type(each): each for each in MESSAGES}
    s = by_fields[Settings]
    in_c = {
        Identity: lambda: c.rfp_put_identity(to, 21, identity),
        Status: lambda: c.rfp_put_status(to, 21, ffi.new("struct rfp_status *", list(by_fields[Status]))),
        Health: lambda: c.rfp_put_health(to, 21, ffi.new("struct rfp_health *", list(by_fields[Health]))),
        LeaseAnswer: lambda: c.rfp_put_lease_answer(to, 21, *by_fields[LeaseAnswer]),
        Settings: lambda: c.rfp_put_settings(to, 21, ffi.new("struct rfp_settings *", [*s[:5], list(s[5:])])),
    }
    for kind, put in in_c.items():
        length = put()
        on_line = ffi.new("uint8_t[64]")
        assert bytes(ffi.buffer(on_line, c.rfp_frame(on_line, to, length))) == frame(by_fields[kind], 21)
    assert c.rfp_put_lease_answer(to, 21, 7, 3, False) == 8 and to[7] == 0


def test_every_length_is_the_headers(library: Any) -> None:
    """``robot.c`` takes a frame by its length alone."""
    header = (firmware_library.SOURCES / "rfp.h").read_text()
    for sent in MESSAGES:
        name = re.sub(r"(?<!^)([A-Z])", r"_\1", type(sent).__name__).upper()
        (number,) = re.findall(rf"RFP_{name} = (\d+)", header)
        (length,) = re.findall(rf"#define RFP_{name}_BYTES (\d+)u", header)
        got = body(frame(sent, 0)[:-1])
        assert got is not None and (got[0] >> 4, len(got)) == (int(number), int(length))


@settings(max_examples=100, derandomize=True, deadline=None)
@given(
    pieces=st.lists(st.binary(max_size=80) | st.sampled_from([frame(each, 3) for each in MESSAGES]) | st.just(b"\0"))
)
def test_both_receivers_take_the_same_of_any_bytes(library: Any, pieces: list[bytes]) -> None:
    data, python, in_c = b"".join(pieces), Receiver(), InC(library)
    assert list(python.receive(data)) == list(in_c.receive(data))
    assert (python.struck, python.lost) == (in_c.struck, in_c.lost)


@given(data=st.binary(max_size=58))
@settings(max_examples=200, derandomize=True, deadline=None)
def test_any_body_comes_as_it_was_sent_in_both(library: Any, data: bytes) -> None:
    ffi, c = library
    on_line = ffi.new("uint8_t[64]")
    whole = bytes(ffi.buffer(on_line, c.rfp_frame(on_line, data, len(data))))
    assert whole == line(data)
    if data:
        assert list(Receiver().receive(whole)) == list(InC(library).receive(whole)) == [data]


def test_the_checksum_is_zlibs(library: Any) -> None:
    for data in (*(bytes([byte]) for byte in range(256)), b"", b"123456789"):
        assert library.c.rfp_crc(data, len(data)) == zlib.crc32(data)


def test_a_frame_that_comes_in_pieces_behind_noise_is_taken(library: Any) -> None:
    for receiver in (Receiver(), InC(library)):
        noise = bytes(range(1, 200))
        got = [
            b
            for piece in (noise, noise, b"\0", *(bytes([b]) for b in frame(MOTION, 0)))
            for b in receiver.receive(piece)
        ]
        assert [message(b) for b in got] == [MOTION] and receiver.struck == 1


def test_a_frame_that_lost_its_end_is_not_completed_by_the_one_before(library: Any) -> None:
    whole = frame(MOTION, 0)
    for receiver in (Receiver(), InC(library)):
        assert len([*receiver.receive(whole + whole[:-2] + b"\0" + whole)]) == 2
        assert receiver.struck == 1


def test_a_frame_without_a_head_and_one_that_is_too_long_are_none(library: Any) -> None:
    for receiver in (Receiver(), InC(library)):
        assert [*receiver.receive(line(b"") + line(bytes(range(1, 60))))] == []
        longest = line(bytes(range(1, 59)))
        assert [*receiver.receive(longest[:-1] + b"\1\0")] == []
        assert receiver.struck == 3
        assert len([*receiver.receive(longest)]) == 1


def test_frames_that_are_missing_are_counted(library: Any) -> None:
    for receiver in (Receiver(), InC(library)):
        for count in (14, 15, 16, 18, 25, 26):
            assert list(receiver.receive(frame(Hello(), count)))
        assert (receiver.lost, receiver.struck) == (7, 0)


def struck_frames(library: Any, frames: int, seed: int) -> tuple[int, int]:
    """Send motions of which 1 % of the bytes are changed; return how many were struck, and how many came wrong."""
    source, receiver = random.Random(seed), InC(library)
    wrong = 0
    for seq in range(frames):
        sent = MOTION._replace(seq=seq, left=source.randrange(-6144, 6145))
        clean = frame(sent, seq)
        dirty = bytes(b if source.random() >= 0.01 else source.randrange(256) for b in clean)
        if dirty != clean:
            wrong += sum(message(got) != sent for got in receiver.receive(dirty))
    return receiver.struck, wrong


def test_no_struck_frame_is_taken(library: Any) -> None:
    struck, wrong = struck_frames(library, 4000, seed=4)
    assert struck > 800 and wrong == 0


@pytest.mark.long
def test_no_struck_frame_is_taken_of_ten_million(library: Any) -> None:
    assert struck_frames(library, 10_000_000, seed=5)[1] == 0


def test_what_is_of_another_version_is_no_message() -> None:
    assert message(struct.pack("<B", 0x60)) is None
    assert message(frame(MOTION, 0)[1:8]) is None

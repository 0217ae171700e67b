"""rfp/1, the line protocol of ``drivers/firmware``: its messages as frames on a line, and back. RFP.md describes it.

A frame is COBS(head, fields, CRC-32) and a zero. Speeds are in 2^-9 rad/s, instants and nonces in the robot's
milliseconds, everything else is as the fields say.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple, get_args

VERSION = 1
PER_RAD_S = 512.0  # of a speed on the line
LINE_BYTES = 64  # of a frame, with its zero
MAX_GAIN = 8191
_CRC = struct.Struct("<I")


class Hello(NamedTuple):
    """The host asks who is there: the robot answers with Identity, Settings and Health."""


class Command(NamedTuple):
    """The wheels' speeds."""

    epoch: int
    session: int
    seq: int
    boot_id: int
    nonce: int
    left: int
    right: int


class Permission(NamedTuple):
    """Permission to move up to a limit; or an emergency stop; or a latch's reset."""

    epoch: int
    seq: int
    boot_id: int
    nonce: int
    latch: int
    clear: int
    limit: int


class Lease(NamedTuple):
    """The host asks for the lease, or gives it back."""

    session: int
    action: int  # 1: acquire; 2: take over; 3: release


class Gains(NamedTuple):
    """Gains of the wheels' speed loops, for as long as the robot is on."""

    kp: int
    ki: int
    kff: int


class Identity(NamedTuple):
    """Who is there. The first field of every version of the protocol is the version."""

    version: int
    board: bytes  # 12 characters, filled up with zeros
    build: bytes  # 16
    hash: int  # of the firmware's sources
    reset: int  # why the board started: 1 power-on, 2 external, 4 brown-out, 8 watchdog


class Status(NamedTuple):
    """The newest nonce, the wheels, and the gate: every 10 ms."""

    boot_id: int
    nonce: int
    left_count: int
    right_count: int
    left_speed: int
    right_speed: int
    left_output: int
    right_output: int
    gate: int
    latch: int
    faults: int  # that last
    felt: int  # since the gate was latched


class Health(NamedTuple):
    """The rest of the robot's state: every 100 ms."""

    epoch: int
    session: int
    latch_id: int
    refused: int
    struck: int
    lost: int
    battery_mv: int  # 0: not measured
    left_ma: int
    right_ma: int
    target_after_ms: int  # last stop; -1: none
    output_after_ms: int
    loop_us: int
    memory_lost: int
    reset: int


class LeaseAnswer(NamedTuple):
    """Whether the lease was granted."""

    session: int
    epoch: int
    granted: int


class Settings(NamedTuple):
    """What is built in, and the gains that hold."""

    counts_per_turn: int  # [2^-8]
    wheel_radius_um: int
    max_wheel: int
    max_sum: int  # of both wheels
    max_ramp: int  # [2^-16 rad/s per ms]
    kp: int
    ki: int
    kff: int


Message = (
    Hello | Command | Permission | Lease | Gains | Identity | Status | Health | LeaseAnswer | Settings
)  # fmt: skip
_LAYOUTS: dict[type, tuple[int, struct.Struct]] = {
    kind: (number, struct.Struct(f"<B{fields}"))
    for kind, number, fields in (
        (Hello, 1, ""), (Command, 2, "HIIIIhh"), (Permission, 3, "HIIIBIh"), (Lease, 4, "IB"), (Gains, 5, "HHH"),
        (Identity, 9, "B12s16sIB"), (Status, 10, "IIiihhhhBBBB"), (Health, 11, "HIIHHHHhhhhHBB"),
        (LeaseAnswer, 12, "IHB"), (Settings, 13, "IIhHHHHH"),
    )
}  # fmt: skip
_KINDS = {number: kind for kind, (number, _) in _LAYOUTS.items()}
IDENTITY = _LAYOUTS[Identity][0]
assert set(_LAYOUTS) == set(get_args(Message))


def frame(message: Message, count: int) -> bytes:
    """Return a message as a frame; ``count``: of frames that were sent before."""
    number, layout = _LAYOUTS[type(message)]
    return line(layout.pack(number << 4 | count & 15, *message))


def line(body: bytes) -> bytes:
    """Return head and fields as a frame."""
    whole = body + _CRC.pack(zlib.crc32(body))
    return b"".join(bytes([len(group) + 1]) + group for group in whole.split(b"\0")) + b"\0"


def body(line: bytes) -> bytes | None:
    """Return head and fields of what stood before a zero; None: it is no whole frame."""
    if len(line) >= LINE_BYTES:
        return None
    groups, at = [], 0
    while at < len(line):
        groups.append(line[at + 1 : at + line[at]])
        at += line[at]
    whole = b"\0".join(groups)
    head, crc = whole[: -_CRC.size], whole[-_CRC.size :]
    if at != len(line) or not head or crc != _CRC.pack(zlib.crc32(head)):
        return None
    return head


def message(body: bytes) -> Message | None:
    """Return what a body says; None: it is of another version."""
    kind = _KINDS.get(body[0] >> 4)
    if kind is None or len(body) != _LAYOUTS[kind][1].size:
        return None
    read: Message = kind(*_LAYOUTS[kind][1].unpack(body)[1:])
    return read


class Receiver:
    """Takes bytes, gives bodies.

    Attributes:
        struck: How many frames came that were none.
        lost: How many frames are missing, by the sender's counts.
    """

    def __init__(self) -> None:
        self.struck = self.lost = 0
        self._rest = b""
        self._count: int | None = None

    def receive(self, data: bytes) -> Iterator[bytes]:
        """Yield head and fields of the frames that are whole with these bytes."""
        *lines, rest = (self._rest + data).split(b"\0")
        self._rest = rest[:LINE_BYTES]  # what is too long stays too long
        for each in lines:
            if not each:
                continue
            found = body(each)
            if found is None:
                self.struck += 1
                continue
            count = found[0] & 15
            if self._count is not None:
                self.lost += (count - self._count - 1) % 16
            self._count = count
            yield found

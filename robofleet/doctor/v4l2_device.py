"""What a camera of the kernel's says of itself (Video4Linux): its name, and the formats, sizes and rates that it has.

By the ioctls of linux/videodev2.h, without a library: OpenCV cannot list them, and a robot's computer has none.
"""

import errno
import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from typing import NamedTuple

_QUERYCAP, _ENUM_FMT, _ENUM_SIZES, _ENUM_INTERVALS = 0x80685600, 0xC0405602, 0xC02C564A, 0xC034564B
_CAPABILITY, _FORMAT, _SIZE, _INTERVAL = 104, 64, 44, 52  # bytes of their structs
_CAPTURE, _HAS_DEVICE_CAPS = 0x1, 0x80000000
_VIDEO_CAPTURE = 1  # the type of buffer
_DISCRETE = 1
_MOST_ENTRIES = 256  # entries of a list: a driver that never ends one is broken

Ioctl = Callable[[int, int, bytearray], object]


class Mode(NamedTuple):
    """A format and a size, with the rates at which it comes."""

    format: str  # four letters: MJPG, YUYV, GREY
    width: int  # [px]; the largest, where any size up to it can be had
    height: int
    rates_hz: tuple[float, ...]  # highest first; empty: the driver does not tell


class DeviceReport(NamedTuple):
    """What a device says."""

    name: str
    modes: tuple[Mode, ...]


def ask(path: str, ioctl: Ioctl = fcntl.ioctl) -> DeviceReport | None:
    """Return what a camera says; None if the device gives no images. OSError where it cannot be opened."""
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        buffer = bytearray(_CAPABILITY)
        ioctl(descriptor, _QUERYCAP, buffer)
        name = bytes(buffer[16:48]).partition(b"\0")[0].decode(errors="replace")
        of_all, of_this = struct.unpack_from("=II", buffer, 84)
        if not (of_this if of_all & _HAS_DEVICE_CAPS else of_all) & _CAPTURE:
            return None
        modes = [
            Mode(letters.decode(errors="replace"), width, height, _rates(ioctl, descriptor, letters, width, height))
            for letters in _formats(ioctl, descriptor)
            for width, height in _sizes(ioctl, descriptor, letters)
        ]
        return DeviceReport(name, tuple(modes))
    finally:
        os.close(descriptor)


def _formats(ioctl: Ioctl, descriptor: int) -> Iterator[bytes]:
    """Yield the formats, four letters each."""
    for buffer in _listed(ioctl, descriptor, _ENUM_FMT, _FORMAT, struct.pack("=II", 0, _VIDEO_CAPTURE)):
        yield bytes(buffer[44:48])


def _sizes(ioctl: Ioctl, descriptor: int, letters: bytes) -> Iterator[tuple[int, int]]:
    for buffer in _listed(ioctl, descriptor, _ENUM_SIZES, _SIZE, bytes(4) + letters):
        if struct.unpack_from("=I", buffer, 8)[0] == _DISCRETE:
            yield struct.unpack_from("=II", buffer, 12)
        else:
            _, width, _, _, height, _ = struct.unpack_from("=6I", buffer, 12)
            yield width, height
            return


def _rates(ioctl: Ioctl, descriptor: int, letters: bytes, width: int, height: int) -> tuple[float, ...]:
    head = bytes(4) + letters + struct.pack("=II", width, height)
    rates = set()
    for buffer in _listed(ioctl, descriptor, _ENUM_INTERVALS, _INTERVAL, head):
        numerator, denominator = struct.unpack_from("=II", buffer, 20)  # the shortest, where there is a range
        if numerator:
            rates.add(round(denominator / numerator, 3))
        if struct.unpack_from("=I", buffer, 16)[0] != _DISCRETE:
            break
    return tuple(sorted(rates, reverse=True))


def _listed(ioctl: Ioctl, descriptor: int, request: int, size: int, head: bytes) -> Iterator[bytearray]:
    """Yield the entries of a list: the struct begins with the entry's index, and ``head`` is what is asked for."""
    for index in range(_MOST_ENTRIES):
        buffer = bytearray(size)
        buffer[: len(head)] = head
        struct.pack_into("=I", buffer, 0, index)
        try:
            ioctl(descriptor, request, buffer)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTTY):  # the list has ended; there is no such list
                raise
            return
        yield buffer

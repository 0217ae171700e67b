"""What a camera of the kernel's (Video4Linux) says of itself, and its controls.

By the ioctls of linux/videodev2.h, without a library: OpenCV lists neither formats nor controls, linuxpy is GPL. The
numbers and layouts below are those that a C compiler gives for that header (Linux 6.1, x86-64).
"""

import errno
import fcntl
import os
import re
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from robofleet.config.camera import StampedInstant

_QUERYCAP, _ENUM_FMT, _ENUM_SIZES, _ENUM_INTERVALS = 0x80685600, 0xC0405602, 0xC02C564A, 0xC034564B
_CAPABILITY, _FORMAT, _SIZE, _INTERVAL = 104, 64, 44, 52  # bytes of their structs
_QUERYCTRL, _G_CTRL, _S_CTRL = 0xC0445624, 0xC008561B, 0xC008561C
_QUERY = struct.Struct("=II32siiiiI2I")  # id, type, name, low, high, step, default, flags
_VALUE = struct.Struct("=Ii")  # id, value
_BUFFER = struct.Struct("@5I2l2I4B4s2IL2Ii0l")  # index, type, bytes, flags, field, time, code, number, memory, ...
_QUERYBUF = 0xC0000000 | _BUFFER.size << 16 | ord("V") << 8 | 9

_CAPTURE, _HAS_DEVICE_CAPS = 0x1, 0x80000000
_VIDEO_CAPTURE, _MMAP = 1, 1  # types of buffer and of its memory
_DISCRETE = 1
_NEXT = 0x80000000  # V4L2_CTRL_FLAG_NEXT_CTRL: the next control after this id
_DISABLED = 0x1
_NUMBERS = {1, 2, 3, 9}  # types of controls: integer, boolean, menu, menu of integers; others are buttons, texts, ...
_STAMP_SOURCE, _START_OF_EXPOSURE = 0x00070000, 0x00010000  # V4L2_BUF_FLAG_TSTAMP_SRC_MASK, _SOE
_MOST_ENTRIES = 256  # entries of a list: a driver that never ends one is broken

UVCVIDEO = Path("/sys/module/uvcvideo/parameters")
Ioctl = Callable[[int, int, bytearray], object]


class Mode(NamedTuple):
    """A format and a size, with the rates at which it comes."""

    format: str  # four letters: MJPG, YUYV, GREY
    width: int  # [px]; the largest, where any size up to it can be had
    height: int
    rates_hz: tuple[float, ...]  # highest first; empty: the driver does not tell


@dataclass(frozen=True, kw_only=True)
class Control:
    """A control with the values that it can have. ``name``: as ``v4l2-ctl`` writes it: focus_absolute."""

    id: int
    name: str
    low: int
    high: int
    step: int
    default: int


class Device:
    """An open camera; OSError where it cannot be opened or asked. Other programs may have it open, too."""

    def __init__(self, path: str, ioctl: Ioctl = fcntl.ioctl) -> None:
        self._descriptor, self._ioctl = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC), ioctl
        buffer = bytearray(_CAPABILITY)
        try:
            ioctl(self._descriptor, _QUERYCAP, buffer)
        except OSError:
            self.close()
            raise
        self.driver, self.name = (_text(buffer[start:end]) for start, end in ((0, 16), (16, 48)))
        of_all, of_this = struct.unpack_from("=II", buffer, 84)
        self.gives_images = bool((of_this if of_all & _HAS_DEVICE_CAPS else of_all) & _CAPTURE)

    def close(self) -> None:
        """Let go of it. Idempotent."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)

    def modes(self) -> tuple[Mode, ...]:
        """Return the formats, sizes and rates of its images."""
        return tuple(
            Mode(letters.decode(errors="replace"), width, height, self._rates(letters, width, height))
            for letters in self._formats()
            for width, height in self._sizes(letters)
        )

    def controls(self) -> dict[int, Control]:
        """Return its controls that have a number as value, by their V4L2_CID."""
        found: dict[int, Control] = {}
        after = 0
        for _ in range(_MOST_ENTRIES):
            buffer = bytearray(_QUERY.pack(after | _NEXT, 0, b"", 0, 0, 0, 0, 0, 0, 0))
            if not self._answers(_QUERYCTRL, buffer):
                break
            after, kind, name, low, high, step, default, flags, _, _ = _QUERY.unpack(buffer)
            if kind in _NUMBERS and not flags & _DISABLED:
                words = re.sub(r"[^a-z0-9]+", "_", _text(name).lower()).strip("_")
                found[after] = Control(id=after, name=words, low=low, high=high, step=step, default=default)
        return found

    def get(self, control: int) -> int:
        buffer = bytearray(_VALUE.pack(control, 0))
        self._ioctl(self._descriptor, _G_CTRL, buffer)
        return int(_VALUE.unpack(buffer)[1])

    def set(self, control: int, value: int) -> None:
        self._ioctl(self._descriptor, _S_CTRL, bytearray(_VALUE.pack(control, value)))

    def stamped_instant(self, uvcvideo: Path = UVCVIDEO) -> StampedInstant:
        """Return which instant the driver stamps, as far as it says so.

        uvcvideo's buffers always say start of exposure. It is that only with the camera's own clock (hwtimestamps);
        else the driver stamps an image's first packet, which the camera sends when rows were exposed.
        """
        if self.driver == "uvcvideo":
            return "transfer" if sysfs_line(uvcvideo / "hwtimestamps") in ("", "0", "N") else "start"
        buffer = bytearray(_BUFFER.pack(0, _VIDEO_CAPTURE, *11 * (0,), b"", 0, _MMAP, *4 * (0,)))
        with suppress(OSError):  # anybody may ask; the first buffer is there as soon as somebody has asked for images
            self._ioctl(self._descriptor, _QUERYBUF, buffer)
            if _BUFFER.unpack(buffer)[3] & _STAMP_SOURCE == _START_OF_EXPOSURE:
                return "start"
        return "end"

    def _formats(self) -> Iterator[bytes]:
        """Yield the formats, four letters each."""
        for buffer in self._listed(_ENUM_FMT, _FORMAT, struct.pack("=II", 0, _VIDEO_CAPTURE)):
            yield bytes(buffer[44:48])

    def _sizes(self, letters: bytes) -> Iterator[tuple[int, int]]:
        for buffer in self._listed(_ENUM_SIZES, _SIZE, bytes(4) + letters):
            if struct.unpack_from("=I", buffer, 8)[0] == _DISCRETE:
                yield struct.unpack_from("=II", buffer, 12)
            else:
                _, width, _, _, height, _ = struct.unpack_from("=6I", buffer, 12)
                yield width, height
                return

    def _rates(self, letters: bytes, width: int, height: int) -> tuple[float, ...]:
        head = bytes(4) + letters + struct.pack("=II", width, height)
        rates = set()
        for buffer in self._listed(_ENUM_INTERVALS, _INTERVAL, head):
            numerator, denominator = struct.unpack_from("=II", buffer, 20)  # the shortest, where there is a range
            if numerator:
                rates.add(round(denominator / numerator, 3))
            if struct.unpack_from("=I", buffer, 16)[0] != _DISCRETE:
                break
        return tuple(sorted(rates, reverse=True))

    def _listed(self, request: int, size: int, head: bytes) -> Iterator[bytearray]:
        """Yield the entries of a list: the struct begins with the entry's index, and ``head`` is what is asked for."""
        for index in range(_MOST_ENTRIES):
            buffer = bytearray(size)
            buffer[: len(head)] = head
            struct.pack_into("=I", buffer, 0, index)
            if not self._answers(request, buffer):
                return
            yield buffer

    def _answers(self, request: int, buffer: bytearray) -> bool:
        """Return whether there is such an entry; OSError where the device fails."""
        try:
            self._ioctl(self._descriptor, request, buffer)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTTY):  # the list has ended; there is no such list
                raise
            return False
        return True


def sysfs_line(file: Path) -> str:
    """Return what a file of sysfs says; empty where there is none."""
    try:
        return file.read_text().strip()
    except (OSError, UnicodeDecodeError):
        return ""


def _text(data: bytes | bytearray) -> str:
    return bytes(data).partition(b"\0")[0].decode(errors="replace")

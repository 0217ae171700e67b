"""The range of a control of the kernel's cameras (Video4Linux), which OpenCV does not tell: an ioctl of
linux/videodev2.h."""

import fcntl
import os
import struct
from collections.abc import Callable
from typing import NamedTuple

EXPOSURE_ABSOLUTE, GAIN = 0x009A0902, 0x00980913  # V4L2_CID_EXPOSURE_ABSOLUTE [100 us], V4L2_CID_GAIN
_QUERYCTRL = 0xC0445624
_CONTROL = struct.Struct("=II32siiiiI2I")  # id, type, name, low, high, step, default, flags
_UNUSABLE = 0x1 | 0x4  # disabled, read only

Ioctl = Callable[[int, int, bytearray], object]


class Range(NamedTuple):
    """The values that a control can have."""

    low: int
    high: int
    step: int


def control_range(path: str, control: int, ioctl: Ioctl = fcntl.ioctl) -> Range | None:
    """Return the range of a device's control; None where it has no such control."""
    buffer = bytearray(_CONTROL.pack(control, 0, b"", 0, 0, 0, 0, 0, 0, 0))
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        ioctl(descriptor, _QUERYCTRL, buffer)
    except OSError:
        return None
    finally:
        os.close(descriptor)
    _, _, _, low, high, step, _, flags, _, _ = _CONTROL.unpack(buffer)
    return None if flags & _UNUSABLE else Range(low, high, step)

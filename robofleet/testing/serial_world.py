"""One thread for a driver and its robot's twin, on a clock that they do not wait for, over a real pseudo-terminal.

The kernel carries a byte to the other end of a pseudo-terminal a moment after it was written: here a write returns
when it has. A driver that waits for its robot, with ``select.select`` or ``SerialPort.wait``, lets the twin's time
pass instead of ours: so the same happens each time, and seconds cost milliseconds. Where it waits for datagrams, too.
"""

import fcntl
import math
import os
import select
import socket
import stat
import struct
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from robofleet.core.clock import MS, S, WallClock

_PTS, _PTMX = 136, os.makedev(5, 2)  # devices, as Linux numbers them
_NUMBER = 0x80045430  # ioctl TIOCGPTN: which pseudo-terminal
_UNREAD = 1024  # bytes: the other end does not listen, and the kernel keeps back what is more
_PATIENCE_NS = S

_write, _select = os.write, select.select


@contextmanager
def shared(now_ns: Callable[[], int], pass_time: Callable[[int], None]) -> Iterator[None]:
    """Let bytes arrive when they are written, and ``pass_time`` let a step of time pass while a driver waits.

    It is given the instant that it must not pass [ns].
    """

    def wait(reads: Any, writes: Any, errors: Any, timeout: float | None = None) -> Any:
        if not any(terminal(_descriptor(item)) or _takes_datagrams(_descriptor(item)) for item in reads):
            return _select(reads, writes, errors, timeout)
        assert timeout is not None, "it waits for its robot for ever"
        deadline_ns = now_ns() + math.ceil(timeout * S)
        while not any(ready := _select(reads, writes, errors, 0.0)) and now_ns() < deadline_ns:
            pass_time(deadline_ns)
        return ready

    patient = patch("robofleet.drivers.dead_man.SILENT_S", 600.0)  # real time, in which nothing happens here
    with patch.object(os, "write", _write_and_arrive), patch.object(select, "select", wait), patient:
        yield


def terminal(descriptor: int) -> tuple[int, bool] | None:
    """Return which pseudo-terminal this is an end of, and whether it is the robot's end; None: of none."""
    try:
        device = os.fstat(descriptor).st_rdev
        if device == _PTMX:
            return _ioctl_int(descriptor, _NUMBER), True
    except OSError:
        return None
    return (os.minor(device), False) if os.major(device) == _PTS else None


def _takes_datagrams(descriptor: int) -> bool:
    if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        return False
    with socket.socket(fileno=os.dup(descriptor)) as same:
        return same.family == socket.AF_INET and same.type == socket.SOCK_DGRAM


def unread(port: Path) -> int:
    """Return how many bytes wait at the robot's end of the port."""
    number = int(port.resolve().name)
    return sum(_ioctl_int(d, termios.FIONREAD) for d in open_descriptors() if terminal(d) == (number, True))


def open_descriptors() -> list[int]:
    """Return what this process has open."""
    return [int(entry.name) for entry in Path("/proc/self/fd").iterdir()]


def _write_and_arrive(descriptor: int, data: Any, /) -> int:
    end = terminal(descriptor)
    if end is None:
        return _write(descriptor, data)
    other = _open_end(end[0], not end[1])
    before = _UNREAD if other is None else _ioctl_int(other, termios.FIONREAD)
    written = _write(descriptor, data)
    if other is not None and before < _UNREAD:
        clock = WallClock()
        deadline_ns = clock.now_ns() + _PATIENCE_NS
        while _ioctl_int(other, termios.FIONREAD) < min(before + written, _UNREAD) and clock.now_ns() < deadline_ns:
            clock.sleep_until(clock.now_ns() + MS // 20)
    return written


_found: dict[tuple[int, bool], int] = {}  # where an end was last: a search for each write takes longer than all else


def _open_end(*end: *tuple[int, bool]) -> int | None:
    """Return the descriptor of an end of a pseudo-terminal that this process has open."""
    if (before := _found.get(end)) is not None and terminal(before) == end:
        return before
    found = next((d for d in open_descriptors() if terminal(d) == end), None)
    if found is not None:
        _found[end] = found
    return found


def _ioctl_int(descriptor: int, what: int) -> int:
    return int(struct.unpack("i", fcntl.ioctl(descriptor, what, bytes(4)))[0])


def _descriptor(item: Any) -> int:
    return item if isinstance(item, int) else int(item.fileno())

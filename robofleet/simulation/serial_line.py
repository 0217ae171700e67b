"""The robot's end of a serial line that a driver opens as any other: a pseudo-terminal, found by a link."""

import errno
import math
import os
import tty
from collections import deque
from contextlib import suppress
from pathlib import Path

from robofleet.core.clock import MS, S

_MOST_BYTES_AT_ONCE = 65536
_BITS_A_BYTE = 10  # with start and stop bit


class SerialLine:
    """A pseudo-terminal in raw mode; the link at ``port`` leads to the host's end. Nothing here ever waits."""

    def __init__(self, port: Path) -> None:
        self._port = port
        self._master: int | None = None
        self.open = False  # whether the host has it open, as ``read`` found it last
        self.plug()

    @property
    def descriptor(self) -> int | None:
        """What becomes readable when bytes come; None while there can be none."""
        return self._master if self.open else None

    def plug(self) -> None:
        """Let the port be there. The link is replaced at once: nobody finds none, or half of one."""
        if self._master is not None:
            return
        self._master, host = os.openpty()
        try:
            tty.setraw(host)
            os.set_blocking(self._master, False)
            new = self._port.with_suffix(".new")
            new.unlink(missing_ok=True)
            new.symlink_to(os.ttyname(host))
            new.replace(self._port)
        finally:
            os.close(host)

    def unplug(self) -> None:
        """Let the port be gone: whoever has it open reads the end of the line and can write no more. Idempotent."""
        if self._master is not None:
            self._port.unlink(missing_ok=True)
            os.close(self._master)
            self._master, self.open = None, False

    def read(self) -> bytes:
        """Return what the host has written; says in ``open`` whether it has the port open."""
        if self._master is None:
            return b""
        self.open = True
        try:
            return os.read(self._master, _MOST_BYTES_AT_ONCE)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:  # so Linux says that nobody has the other end
                raise
            self.open = False
            return b""

    def write(self, data: bytes) -> None:
        """Send to the host; what it has no room for is lost, as is all while it has not opened the port."""
        if data and self._master is not None and self.open:
            with suppress(BlockingIOError):
                os.write(self._master, data)


class Wire:
    """One direction of a line: bytes arrive as fast as the baud rate lets them, in order.

    A chunk arrives as a whole with its last byte. Less than a millisecond is not waited for: it would only cost
    wakings.
    """

    def __init__(self, baud: int) -> None:
        self._byte_ns = _BITS_A_BYTE * S / baud
        self._free_ns = 0.0  # when the last byte will be through
        self._chunks: deque[tuple[int, bytes]] = deque()

    @property
    def next_ns(self) -> float:
        """When the next chunk arrives [ns]; infinity: none is under way."""
        return self._chunks[0][0] if self._chunks else math.inf

    def put(self, data: bytes, now_ns: int, late_ns: int = 0) -> None:
        """Send a chunk, ``late_ns`` later than it could be."""
        if not data:
            return
        self._free_ns = max(self._free_ns, now_ns) + len(data) * self._byte_ns
        at_ns = late_ns + (round(self._free_ns) if self._free_ns - now_ns >= MS else now_ns)
        if self._chunks:
            at_ns = max(at_ns, self._chunks[-1][0])
        self._chunks.append((at_ns, data))

    def take(self, now_ns: int) -> bytes:
        arrived = []
        while self._chunks and self._chunks[0][0] <= now_ns:
            arrived.append(self._chunks.popleft()[1])
        return b"".join(arrived)

    def clear(self) -> None:
        self._chunks.clear()
        self._free_ns = 0.0

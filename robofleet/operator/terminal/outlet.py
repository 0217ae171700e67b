"""What a run says on stdout and stderr, which waits for nobody who reads it.

A terminal that takes no output (Ctrl-S, a window that hangs), a full pipe and a reader that is gone neither hold a run
up nor end it: a thread writes, and what nobody takes is dropped, the oldest first.
"""

import io
import os
import select
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, TextIO, cast

_MOST_WAITING_BYTES = 1 << 16  # a picture of the live view has some 3,000
_DRAIN_WITHIN_S = 2.0  # in the end, with a reader that takes nothing


class _Writer:
    """The thread that writes to one file, by whichever descriptors, in the order in which it was said."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._bytes = 0  # of them
        self._taken = 0  # how often the file took something, or failed
        self._busy = False
        self._changed = threading.Condition()
        threading.Thread(target=self._write, daemon=True).start()

    def put(self, descriptor: int, text: bytes) -> None:
        """Have it written; never blocks."""
        with self._changed:
            self._waiting.append((descriptor, text))
            self._bytes += len(text)
            while self._bytes > _MOST_WAITING_BYTES and len(self._waiting) > 1:
                self._bytes -= len(self._waiting.popleft()[1])
            self._changed.notify_all()

    def drain(self) -> None:
        """Return when all is written, or when the reader has taken nothing for a while."""
        with self._changed:
            while self._waiting or self._busy:
                taken = self._taken
                if not self._changed.wait(_DRAIN_WITHIN_S) and taken == self._taken:
                    return

    def _write(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                while not self._waiting:
                    self._changed.wait()
                descriptor, text = self._waiting.popleft()
                self._bytes -= len(text)
                self._busy = True
            while text:
                text = text[self._some(descriptor, text) :]
                self._taken += 1

    def _some(self, descriptor: int, text: bytes) -> int:
        """Write some of it; returns how much is done with: all, where nobody will ever read it."""
        try:
            return os.write(descriptor, text[: select.PIPE_BUF])
        except BlockingIOError:  # somebody has made it so
            select.select([], [descriptor], [])
            return 0
        except OSError:  # no reader, no terminal, no room: the run's folder has what matters
            return len(text)


class _Outlet(io.RawIOBase):
    """A descriptor as Python's text streams want it."""

    def __init__(self, descriptor: int, writer: _Writer) -> None:
        super().__init__()
        self._descriptor, self._writer = descriptor, writer

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._descriptor

    def isatty(self) -> bool:
        return os.isatty(self._descriptor)

    def write(self, text: Any) -> int:
        whole = bytes(text)
        self._writer.put(self._descriptor, whole)
        return len(whole)


@contextmanager
def unhindered() -> Iterator[None]:
    """Let stdout and stderr wait for no reader, until this ends; as a decorator: while the function runs."""
    before = sys.stdout, sys.stderr
    writers: dict[tuple[int, int], _Writer] = {}  # by file: two descriptors of one terminal keep their order
    sys.stdout, sys.stderr = (_outlet(stream, writers) for stream in before)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        for writer in writers.values():
            writer.drain()
        sys.stdout, sys.stderr = before


def _outlet(stream: TextIO | None, writers: dict[tuple[int, int], _Writer]) -> TextIO:
    """Return what says the same without waiting; the stream itself where it is no file."""
    if stream is None:  # its descriptor was closed before we began
        return io.StringIO()
    try:
        stream.flush()
        descriptor = stream.fileno()
        file = os.fstat(descriptor)
    except (OSError, ValueError):
        return stream
    same = file.st_dev, file.st_ino
    if same not in writers:
        writers[same] = _Writer()
    outlet = cast("BinaryIO", _Outlet(descriptor, writers[same]))
    return io.TextIOWrapper(outlet, encoding=stream.encoding, errors=stream.errors, line_buffering=True)

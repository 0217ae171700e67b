"""Log lines of a process: a line that cannot be written is lost, and the process goes on.

A robot must not lose its emergency stop because the disk is full, or because nobody reads a pipe's other end any more.
"""

import io
import sys
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, TextIO

_LOST = (OSError, ValueError, RuntimeError)  # no room, no reader; closed, or not to be encoded; said amid saying


class Unfailing:
    """A text stream on which nothing that is written raises; all else is the stream's own."""

    def __init__(self, stream: TextIO | io.TextIOBase) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(*_LOST):
            self._stream.write(text)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        with suppress(*_LOST):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def never_raise(*, stdout: bool = False) -> None:
    """Let no line on stderr raise from now on, whoever writes it; ``stdout``: nor one there, where it is a log too."""
    sys.stderr = _unfailing(sys.stderr)
    if stdout:
        sys.stdout = _unfailing(sys.stdout)


def _unfailing(stream: TextIO) -> Any:
    return stream if isinstance(stream, Unfailing) else Unfailing(stream)

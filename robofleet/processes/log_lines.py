"""What a process says in its log: a line that cannot be written is lost, and the process goes on.

A robot must not lose its emergency stop because the disk is full, or because nobody reads a pipe's other end any more.
"""

import io
import re
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import IO, Any, TextIO

_MOST_LINES, _MINUTE_NS = 20, 60_000_000_000
_LOST = (OSError, ValueError, RuntimeError)  # no room, no reader; closed, or not to be encoded; said amid saying


class Unfailing:
    """A text stream on which nothing that is written raises; all else is the stream's own."""

    def __init__(self, stream: TextIO | io.TextIOBase) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write what can be written."""
        with suppress(*_LOST):
            self._stream.write(text)
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write what can be written."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Let go of what can be let go of."""
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


_ANSI = re.compile(r"\x1b\[[0-9;]*m")
_WHERE = re.compile(r"^\S+\s+WARN\s+.*?(?P<room>zenoh\S*): (?P<words>.*?)(?: at /\S+)?$")


def say_of_links(lines: IO[str], say: Callable[[str], None], now_ns: Callable[[], int]) -> None:
    """Say in the log whom the router let in no further, and why; at most a few lines a minute, whoever knocks."""
    left, until_ns, more = _MOST_LINES, 0, 0
    for line in lines:
        if now_ns() >= until_ns:
            if more:
                say(f"{more} more links were refused")
            left, until_ns, more = _MOST_LINES, now_ns() + _MINUTE_NS, 0
        found = _WHERE.match(_ANSI.sub("", line).strip())
        if found is None or "zenoh_link" not in found["room"]:
            continue
        if left:
            left -= 1
            say(f"a link was refused: {found['words'].partition('. Hint:')[0]}")
        else:
            more += 1

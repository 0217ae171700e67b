"""The file of a run in lockstep, written by a process of its own: drawing and compressing take no time of the run."""

import gc
import marshal
import multiprocessing
import signal
from collections.abc import Iterable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from robofleet.config.tree import Config
from robofleet.recording.log import RunLog

_BATCH_MESSAGES = 200  # a second of a small fleet
_IGNORED_SIGNALS = signal.SIGINT, signal.SIGHUP  # the terminal's signals are the run's to answer


class LogBeside:
    """A ``RunLog`` in a process of its own; close it in a ``finally``.

    It is a fork of this process, as the messages are many and its start must cost less than it saves. What it is told
    is in the file when this is closed. If it is killed, every message counts as dropped, and the file ends early.
    """

    def __init__(self, file: Path, config: Config) -> None:
        """Begin a file; FileExistsError if it is there already, OSError if it cannot be."""
        log = RunLog(file, config, batched=True)
        context = multiprocessing.get_context("fork")
        theirs, self._to_log = context.Pipe()
        # A daemon: an interpreter that ends without closing this waits for nobody.
        self._process = context.Process(target=_write, args=(log, theirs, self._to_log), daemon=True)
        self._process.start()
        theirs.close()
        log.let_go()
        self._batches: list[tuple[int, list[tuple[str, bytes]]]] = []
        self._waiting = 0
        self._closed = False
        self.messages = 0  # that came
        self.dropped = 0  # that are not in the file; known when it is closed
        self.failed: str | None = None  # why the newest write did not succeed; known when it is closed

    def add_all(self, batch: Iterable[tuple[str, bytes]], at_ns: int) -> None:
        messages = list(batch)
        self._batches.append((at_ns, messages))
        self._waiting += len(messages)
        if self._waiting >= _BATCH_MESSAGES:
            self._send(self._batches)

    def _send(self, what: Any) -> None:
        with suppress(OSError):  # it was killed: that is told at the end
            self._to_log.send_bytes(marshal.dumps(what))
        self.messages += self._waiting
        self._batches, self._waiting = [], 0

    def end(self, ending: bytes = b"") -> None:
        """End the file with how the run ended, where somebody knows it, and its index. Idempotent."""
        if self._closed:
            return
        self._closed = True
        self._send(self._batches)
        self.dropped, self.failed = self.messages, "the process that writes it was killed"
        with suppress(OSError, EOFError):
            self._to_log.send_bytes(marshal.dumps(ending))
            self.dropped, self.failed = marshal.loads(self._to_log.recv_bytes())
        self._to_log.close()
        self._process.join()

    close = end


def _write(log: RunLog, incoming: Connection, theirs: Connection) -> None:
    for number in _IGNORED_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    gc.freeze()  # what the run had is not looked at again
    theirs.close()
    with log, suppress(EOFError):
        while isinstance(batch := marshal.loads(incoming.recv_bytes()), list):
            for at_ns, messages in batch:
                log.add_all(messages, at_ns)
        log.end(batch)
        with suppress(OSError):
            incoming.send_bytes(marshal.dumps((log.dropped, log.failed)))

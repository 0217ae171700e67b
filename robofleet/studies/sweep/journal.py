"""The journal of a sweep: every finished run is a line of ``runs.jsonl``, so an interrupted sweep loses none."""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from robofleet.processes.refusal import RefusedError, new_folder
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.unit import Played
from robofleet.valid_json import dumps

FILE = "runs.jsonl"


class Journal:
    """What is finished; ``add`` keeps one more."""

    def __init__(self, stream: BinaryIO, played: dict[int, Played]) -> None:
        self._stream = stream
        self.played = played  # by the runs' numbers

    def add(self, number: int, played: Played) -> None:
        """Keep a run; OSError where there is no room."""
        line = dumps({"run": number, **played._asdict()}, compact=True)
        self._stream.write(line.encode() + b"\n")
        self._stream.flush()
        self.played[number] = played


@contextmanager
def opened(folder: Path, study: Study) -> Iterator[Journal]:
    """Open a sweep's folder: a new one, or one in which the same sweep was interrupted; RefusedError for any other."""
    file = folder / FILE
    if not file.is_file():
        new_folder(folder)
    try:
        with file.open("a+b") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise RefusedError(f"--out: {folder} is in use by a sweep that is running: name another one") from error
            yield Journal(stream, _read(stream, file, study))
    except OSError as error:
        raise RefusedError(f"--out: {file}: {error.strerror}: make room, or name another folder") from error


def _read(stream: BinaryIO, file: Path, study: Study) -> dict[int, Played]:
    """Return what is finished, and leave the stream where the next line goes: a line that was cut short is removed."""
    head = {"sweep": study.digest, "runs": len(study.runs)}
    stream.seek(0)
    whole = 0
    played: dict[int, Played] = {}
    for number, line in enumerate(stream):
        if not line.endswith(b"\n"):
            break
        try:
            told = json.loads(line)
            if number == 0 and told != head:
                break
            if number > 0:
                played[told.pop("run")] = Played(**told)
        except (ValueError, KeyError, TypeError, AttributeError):
            break
        whole += len(line)
    size = os.fstat(stream.fileno()).st_size
    if whole == 0 and size > 0:
        raise RefusedError(
            f"--out: {file} is of another sweep, or of this one before it was changed: name another folder"
        )
    stream.truncate(whole)
    if whole == 0:
        stream.write(dumps(head, compact=True).encode() + b"\n")
        stream.flush()
    return played

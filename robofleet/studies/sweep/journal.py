"""The journal of a sweep: every finished run is a line of ``runs.jsonl``, so an interrupted sweep loses none."""

import fcntl
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from robofleet.core.refusal import RefusedError, new_folder
from robofleet.core.valid_json import dumps
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.unit import Played

FILE = "runs.jsonl"


class Journal:
    """What is finished; ``add`` keeps one more."""

    def __init__(self, stream: BinaryIO, played: dict[int, Played]) -> None:
        self._stream = stream
        self.played = played  # by the runs' numbers

    def add(self, number: int, played: Played) -> None:
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
    """Return what is finished; a last line that was cut short is removed, and nothing else ever is."""
    head = {"sweep": study.digest, "runs": len(study.runs)}
    stream.seek(0)
    lines = stream.read().split(b"\n")
    if len(lines) == 1:  # it was interrupted before it began
        stream.truncate(0)
        stream.write(dumps(head, compact=True).encode() + b"\n")
        stream.flush()
        return {}
    try:
        same = json.loads(lines[0]) == head
        played = dict(_run(line) for line in lines[1:-1]) if same else {}
    except (ValueError, KeyError, TypeError) as error:
        raise RefusedError(f"--out: {file} is damaged: {error}: name another folder") from error
    if not same:
        raise RefusedError(f"--out: {file} is of another sweep, or of this one as it was: name another folder")
    if lines[-1]:
        stream.truncate(stream.tell() - len(lines[-1]))
    return played


def _run(line: bytes) -> tuple[int, Played]:
    fields = json.loads(line)
    return fields.pop("run"), Played(**fields)

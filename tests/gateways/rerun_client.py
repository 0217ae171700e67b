"""A viewer: rerun's own command, which writes what a server tells it to a file, and rows of what it wrote."""

import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rerun.chunk import McapReader, RrdReader

from tests.runs.realrun import wait

Rows = dict[str, list[dict[str, Any]]]  # by entity
_WITHIN_S = 60.0


class Saving:
    """A viewer that keeps all that comes, as a process of its own."""

    def __init__(self, url: str, file: Path) -> None:
        command = Path(sys.executable).with_name("rerun")
        self._file, log = file, file.parent / f"{file.name}.log"
        with log.open("wb") as log_file:
            self.process = subprocess.Popen(
                [str(command), "--new", "--bind", "127.0.0.1", "--save", str(file), url],
                stdout=log_file, stderr=log_file, env=os.environ | {"HOME": str(file.parent)},
            )  # fmt: skip

    def connected(self) -> None:
        """Return when something came."""
        assert wait(lambda: self._file.exists() and self._file.stat().st_size > 0, _WITHIN_S)

    def until(self, condition: Callable[[Rows], Any]) -> Rows:
        """Return what was told, once it is as it should be."""
        held: list[Rows] = []

        def holds() -> bool:
            held[:] = [self.told()]
            return bool(condition(held[0]))

        assert wait(holds, _WITHIN_S), {path: len(rows) for path, rows in held[0].items()}
        return held[0]

    def told(self) -> Rows:
        """Return what was told so far."""
        with warnings.catch_warnings(action="ignore"):  # that the file has no end yet
            try:
                reader = RrdReader(self._file)
                return _rows(chunk for store in reader.recordings() for chunk in reader.stream(store=store))
            except (RuntimeError, ValueError, OSError):  # there is none yet, or half a frame at its end
                return {}

    def close(self) -> None:
        """Let nothing be left."""
        self.process.kill()
        self.process.wait()


def imported(file: Path) -> Rows:
    """Return what rerun's importer makes of a recording."""
    return _rows(McapReader(file).stream())


def _rows(chunks: Iterator[Any]) -> Rows:
    rows: Rows = {}
    for chunk in chunks:
        if not chunk.is_static:
            batch = chunk.to_record_batch().drop_columns(["rerun.controls.RowId"])
            batch_rows = [
                {name: value for name, value in row.items() if value is not None} for row in batch.to_pylist()
            ]
            rows.setdefault(chunk.entity_path, []).extend(batch_rows)
    return rows

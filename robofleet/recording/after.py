"""Reports from the files that runs left."""

import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from robofleet.files import read_plain
from robofleet.recording import comparison, metrics
from robofleet.recording import report as pages
from robofleet.recording.bounds import failures
from robofleet.recording.reading import read
from robofleet.recording.run import Recording

Summary = dict[str, Any]

SUMMARY = "summary.json"
_LARGEST = 1 << 24  # [bytes] of a summary


class _Told(BaseModel):
    """What a summary says that the recording may not."""

    outcome: Annotated[str, Field(max_length=100)] = "unknown"
    cause: Annotated[str, Field(max_length=10_000)] | None = None
    mode: Annotated[str, Field(max_length=100)] = "unknown"
    config: Annotated[str, Field(max_length=300)] | None = None


def report(run: Path) -> tuple[Path, list[str]]:
    """Write a run's page and columns again; returns the page, and a line for every bound that was not met."""
    recording, summary = _looked_at(run)
    return pages.write(recording, summary, _folder(run)), failures(summary)


def compare(first: Path, second: Path, out: Path | None) -> tuple[Path, list[str]]:
    """Write the page about two runs; returns it, and no line: nothing is asked of a difference."""
    page = out or _folder(first) / f"compare-{_name(second)}.html"
    comparison.write(_side(first), _side(second), page)
    return page, []


def _side(run: Path) -> comparison.Side:
    recording, summary = _looked_at(run)
    return comparison.Side(_name(run), pages.view_of(recording, summary), summary)


def _looked_at(run: Path) -> tuple[Recording, Summary]:
    """Return a recording and its figures, worked out anew; what the file does not say of the run, its summary may."""
    recording = read(run)
    told = _told(_folder(run) / SUMMARY)
    outcome, cause = recording.outcome or told.outcome, recording.cause or told.cause
    mode = recording.provenance.mode if recording.provenance else told.mode
    name = _name(run) if told.config is None else told.config
    return recording, metrics.summary(recording, name=name, mode=mode, outcome=outcome, cause=cause)


def _told(file: Path) -> _Told:
    try:
        return _Told.model_validate_json(read_plain(file, _LARGEST))
    except (OSError, ValidationError):
        return _Told()  # the run was killed before it could say how it ended


def _folder(run: Path) -> Path:
    return run if os.path.isdir(run) else run.parent  # noqa: PTH112 - it raises nothing


def _name(run: Path) -> str:
    return _folder(run).resolve().name

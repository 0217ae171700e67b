"""Reports from the files that runs left."""

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, Field, ValidationError

from robofleet.core.clock import S
from robofleet.core.files import read_plain
from robofleet.recording.reading import Imports, nothing_imported
from robofleet.recording.run import Recording, Run
from robofleet.reports import comparison, metrics
from robofleet.reports import report as pages
from robofleet.reports.sampled import look, looks

Summary = dict[str, Any]

SUMMARY = "summary.json"
_LARGEST_SUMMARY_BYTES = 1 << 24


class SummaryFile(BaseModel):
    """What a summary says that the recording may not."""

    outcome: Annotated[str, Field(max_length=100)] = "unknown"
    cause: Annotated[str, Field(max_length=10_000)] | None = None
    mode: Annotated[str, Field(max_length=100)] = "unknown"
    config: Annotated[str, Field(max_length=300)] | None = None
    began: Annotated[str, Field(pattern=r"^\d{4}(-\d\d){2}T\d\d(:\d\d){2}Z$")] | None = None


class Report(NamedTuple):
    """A run's report."""

    page: Path
    summary: Summary
    trouble: str | None  # what is wrong with the recording


def report(
    run: Path, figures: Path | None = None, imports: Imports = nothing_imported, columns: Run | None = None
) -> Report:
    """Write a run's page and columns again, and its figures as files where a folder for them is given.

    ``imports``: as of ``reading.read``; ``columns``: the run, where somebody has looked at it.
    """
    columns, summary = _looked_at(run, imports, columns)
    parts = None if columns.reduced is None else looks(run, imports)
    page = pages.write(columns.recording, summary, _folder(run), figures, columns, parts)
    return Report(page, summary, columns.recording.trouble)


def compare(first: Path, second: Path, out: Path | None, imports: Imports = nothing_imported) -> Path:
    """Write the page about two runs and return it."""
    page = out or _folder(first) / f"compare-{_name(second)}.html"
    comparison.write(_side(first, imports), _side(second, imports), page)
    return page


def _side(run: Path, imports: Imports) -> comparison.Side:
    columns, summary = _looked_at(run, imports)
    return comparison.Side(_name(run), pages.view_of(columns.recording, summary, columns), summary)


def _looked_at(run: Path, imports: Imports, columns: Run | None = None) -> tuple[Run, Summary]:
    """Return a run in columns, and its figures, worked out anew.

    What the file does not say of the run, its summary may.
    """
    columns = columns or look(run, imports)
    recording = columns.recording
    ending = _told(_folder(run) / SUMMARY)
    outcome, cause = recording.outcome or ending.outcome, recording.cause or ending.cause
    mode = recording.provenance.mode if recording.provenance else ending.mode
    name = _name(run) if ending.config is None else ending.config
    began = ending.began or _began(recording, columns)
    summary = metrics.summary(recording, name=name, mode=mode, outcome=outcome, cause=cause, began=began, run=columns)
    return columns, summary


def _began(recording: Recording, run: Run) -> str | None:
    """Return the date of a recording's first tick; None where its times are no dates."""
    made, ticks = recording.provenance, run.all_ticks
    if made is None or not made.epoch_ns or not len(ticks):
        return None
    date = datetime.fromtimestamp((made.epoch_ns + int(ticks["stamp_ns"][0])) // S, UTC)
    return f"{date:%Y-%m-%dT%H:%M:%SZ}"


def _told(file: Path) -> SummaryFile:
    try:
        return SummaryFile.model_validate_json(read_plain(file, _LARGEST_SUMMARY_BYTES))
    except (OSError, ValidationError):
        return SummaryFile()  # the run was killed before it could say how it ended


def _folder(run: Path) -> Path:
    return run if os.path.isdir(run) else run.parent  # noqa: PTH112 - it raises nothing


def _name(run: Path) -> str:
    return _folder(run).resolve().name

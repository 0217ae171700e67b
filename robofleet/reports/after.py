"""Reports from the files that runs left."""

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, Field, ValidationError

from robofleet.core.clock import S
from robofleet.core.files import read_plain
from robofleet.recording.columns import CSV, write_csv
from robofleet.recording.reading import Imports, nothing_imported
from robofleet.recording.run import Recording, Run
from robofleet.reports import comparison, metrics, predicted
from robofleet.reports import report as pages
from robofleet.reports.canvas import RunView
from robofleet.reports.sampled import Sampled, look, looks

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
    columns = _written(run, imports, columns)
    summary = _summary(run, columns)
    return Report(pages.write(columns, summary, _folder(run), figures), summary, columns.recording.trouble)


def _written(run: Path, imports: Imports, columns: Run | None) -> Run:
    """Write a run's columns, before plots need memory, and return it: a file that nobody has read is read once."""
    file = _folder(run) / CSV
    if columns is not None:
        write_csv([columns] if columns.reduced is None else looks(run, imports), file)
        return columns
    sampled = Sampled()
    write_csv(sampled.taking(looks(run, imports)), file)
    return sampled.run()


def compare(first: Path, second: Path, out: Path | None, imports: Imports = nothing_imported) -> Path:
    """Write the page about two runs and return it."""
    page = out or _folder(first) / f"compare-{_name(second)}.html"
    comparison.write(_side(first, imports), _side(second, imports), page)
    return page


def _side(run: Path, imports: Imports) -> comparison.Side:
    return comparison.Side(_name(run), viewed(run, imports))


def stored(run: Path) -> Summary | None:
    """Return what a run's ``summary.json`` holds; None where there is none that can be believed."""
    try:
        found = json.loads(read_plain(_folder(run) / SUMMARY, _LARGEST_SUMMARY_BYTES))
        return found if isinstance(found, dict) and found.get("version") == metrics.VERSION else None
    except (OSError, ValueError, RecursionError):
        return None


def viewed(run: Path, imports: Imports = nothing_imported) -> RunView:
    """Return a run as it is drawn, with its figures worked out anew."""
    columns = look(run, imports)
    return RunView(columns, _summary(run, columns))


def _summary(run: Path, columns: Run) -> Summary:
    """Return the figures of a run, worked out anew; what the file does not say of it, its summary may."""
    recording = columns.recording
    ending = _told(_folder(run) / SUMMARY)
    outcome, cause = recording.outcome or ending.outcome, recording.cause or ending.cause
    mode = recording.provenance.mode if recording.provenance else ending.mode
    name = _name(run) if ending.config is None else ending.config
    began = ending.began or _began(recording, columns)
    gap = predicted.load(_folder(run))
    return metrics.summary(
        recording, name=name, mode=mode, outcome=outcome, cause=cause, began=began, run=columns,
        gap=None if gap is None else predicted.figures(gap),
    )  # fmt: skip


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

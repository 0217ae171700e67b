"""Reports from the files that runs left."""

import json
from pathlib import Path
from typing import Any

from robofleet.recording import comparison, metrics
from robofleet.recording import report as pages
from robofleet.recording.bounds import failures
from robofleet.recording.reading import read
from robofleet.recording.run import Recording

Summary = dict[str, Any]

SUMMARY = "summary.json"


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
    outcome = recording.outcome or told.get("outcome", "unknown")
    cause = recording.cause or told.get("cause")
    mode = recording.provenance.mode if recording.provenance else told.get("mode", "unknown")
    name = told.get("config", _name(run))
    return recording, metrics.summary(recording, name=name, mode=mode, outcome=outcome, cause=cause)


def _told(file: Path) -> Summary:
    try:
        told = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}  # the run was killed before it could say how it ended
    return told if isinstance(told, dict) else {}


def _folder(run: Path) -> Path:
    return run if run.is_dir() else run.parent


def _name(run: Path) -> str:
    return _folder(run).resolve().name

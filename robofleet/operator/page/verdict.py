"""How a run ended, by the summary that it left in its folder."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.core.files import read_plain
from robofleet.recording.run_clock import time_words
from robofleet.reports.bounds import failures

REPORT = "report.html"
_SUMMARY = "summary.json"
_LARGEST_SUMMARY = 1 << 24  # [bytes]
_ENDS = {"fault": "Ended by a fault", "stopped": "Stopped"}


class Verdict(NamedTuple):
    """How a run ended, in words."""

    headline: str
    lines: tuple[str, ...]  # a bound that was not met each
    good: bool | None  # None: nobody knows


def verdict_of(folder: Path) -> Verdict | None:
    """Return what the summary in a run's folder says; None while there is none that can be read."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        summary: dict[str, Any] = json.loads(read_plain(folder / _SUMMARY, _LARGEST_SUMMARY))
        outcome, bounds, missed = str(summary["outcome"]), summary["bounds"], failures(summary)
        if outcome != "completed":
            cause = f": {summary['cause']}" if summary["cause"] else ""
            return Verdict(f"{_ENDS.get(outcome, outcome)}{cause}", tuple(missed) if summary["ticks"] else (), False)
        how = f", {len(missed)} of {len(bounds)} bounds not met" if missed else ", every bound met" if bounds else ""
        reached_s = summary.get("duration_s")
        after = f" after {time_words(reached_s, summary.get('clock_duration_s'))}" if reached_s else ""
        return Verdict(f"Completed{after}{how}", tuple(missed), not missed)
    return None

"""Where a run leaves its results, unless the user names a folder: ``runs/<UTC time>-<name>`` in the current folder."""

import re
import sys
from pathlib import Path

from robofleet.config.files.yamlfile import printable
from robofleet.core.clock import utc_now
from robofleet.core.refusal import RefusedError

RUNS = Path("runs")
DEFAULT_FOLDER = f"Default: {RUNS}/<time>-<name>."  # for the help of options
STAMP = "%Y%m%dT%H%M%SZ"
_NAME = re.compile(r"\d{8}T\d{6}Z-.+")


def new(name: str) -> Path:
    """Return the folder of what begins now; it is not made."""
    return RUNS / f"{utc_now():{STAMP}}-{name}"


def chosen(run: Path | None) -> Path:
    """Return the run that a command is about: the newest one, where the user names none.

    RefusedError where there is none.
    """
    if run is not None:
        return run
    from robofleet.recording.log import FILE  # noqa: PLC0415 - it takes its time, and who makes a run needs none of it

    found = [file.parent for file in RUNS.glob(f"*/{FILE}") if _NAME.fullmatch(file.parent.name)]
    if not found:
        raise RefusedError(f"RUN: there is no run in {RUNS.absolute()}: name a run's folder")
    newest = max(found, key=lambda folder: (folder.name[: len("20260102T030405Z")], folder.stat().st_mtime_ns))
    print(f"the newest run is taken: {printable(str(newest))}", file=sys.stderr)
    return newest

"""robofleet's commands one after the other in this process, which may take only so much more memory.

``python -m tests.recording.within``: a JSON list of command lines on stdin; a line of JSON for what came of each.
"""

import json
import resource
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.clock import S, stopwatch_ns

ROOM = 768 << 20  # [bytes] beside what the commands' own modules take
PATIENCE_S = 20  # for one command, on a busy machine


class Came(NamedTuple):
    """What came of a command."""

    exit_code: int
    stdout: str
    stderr: str
    raised: str  # the traceback of what nobody caught
    took_s: float


def commands(lines: Sequence[Sequence[object]]) -> list[Came]:
    """Run each in a child; fewer than were asked for where the child died."""
    asked = json.dumps([[*map(str, line)] for line in lines])
    ran = subprocess.run(
        [sys.executable, "-m", __name__], input=asked, capture_output=True, text=True, check=False,
        timeout=60 + PATIENCE_S * len(lines),
    )  # fmt: skip
    came = [Came(*json.loads(line)) for line in ran.stdout.splitlines() if line.startswith("[")]
    assert len(came) == len(lines), f"{lines[len(came)]} ended the process: {ran.returncode} {ran.stderr[-2000:]}"
    return came


def _main() -> None:
    import matplotlib.figure
    from typer.testing import CliRunner

    from robofleet.cli import app
    from robofleet.processes import replay  # noqa: F401
    from robofleet.recording import after, report

    assert matplotlib.figure and after
    report.sections = lambda view: {}  # type: ignore[assignment]  # plots take their time, and have tests of their own
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    for line in json.load(sys.stdin):
        began_ns = stopwatch_ns()
        result = CliRunner().invoke(app, line)
        error: Any = result.exception
        raised = "" if error is None or isinstance(error, SystemExit) else "".join(traceback.format_exception(error))
        took_s = (stopwatch_ns() - began_ns) / S
        print(json.dumps([result.exit_code, result.stdout, result.stderr, raised, took_s]), flush=True)


if __name__ == "__main__":
    _main()

"""robofleet's commands one after the other in this process, which may take only so much more memory.

``python -m tests.reports.within``: a command line as a JSON list in each line of stdin; a line of JSON for what came
of each.
"""

import atexit
import functools
import json
import resource
import select
import subprocess
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.core.clock import S, stopwatch_ns

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
    """Run each in a child, the same one for all who ask: its modules take longer to load than most commands."""
    return [_asked([*map(str, line)]) for line in lines]


def _asked(line: list[str]) -> Came:
    child = _child()
    assert child.stdin is not None and child.stdout is not None
    child.stdin.write(json.dumps(line).encode() + b"\n")
    answers, _, _ = select.select([child.stdout], [], [], 60 + PATIENCE_S)
    answer = child.stdout.readline() if answers else b""
    if not answer:
        _child.cache_clear()
        _end(child)
    assert answer, f"{line} ended the process, or never ended: {child.returncode}"
    return Came(*json.loads(answer))


@functools.cache
def _child() -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", __name__]
    child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
    atexit.register(_end, child)
    return child


def _end(child: "subprocess.Popen[bytes]") -> None:
    child.kill()
    child.communicate()


def _main() -> None:
    import matplotlib.figure
    from typer.testing import CliRunner

    from robofleet.cli import app
    from robofleet.reports import after, report
    from robofleet.runs import replay  # noqa: F401

    assert matplotlib.figure and after
    report.sections = lambda view: {}  # type: ignore[assignment]  # plots take their time, and have tests of their own
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    for line in sys.stdin:
        began_ns = stopwatch_ns()
        result = CliRunner().invoke(app, json.loads(line))
        error: Any = result.exception
        raised = "" if error is None or isinstance(error, SystemExit) else "".join(traceback.format_exception(error))
        took_s = (stopwatch_ns() - began_ns) / S
        print(json.dumps([result.exit_code, result.stdout, result.stderr, raised, took_s]), flush=True)


if __name__ == "__main__":
    _main()

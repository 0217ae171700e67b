"""One run of a sweep: from its configuration to its summary. Nothing else goes in, and no file is left."""

import gc
import json
import resource
import shlex
import subprocess
import sys
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from robofleet.config.tree import Config
from robofleet.core.clock import S, cpu_ns
from robofleet.envs.evaluation import evaluated
from robofleet.operator.run import driven
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from robofleet.studies.sweep.load import Planned

_COLLECT_EVERY = 20  # runs: what a run leaves is small, and to look for it takes a tenth of a second

_runs = 0  # of this worker


class Played(NamedTuple):
    """What a run left."""

    summary: dict[str, Any]
    cpu_s: float  # of its processes: all of it
    lockstep_s: float  # of these: lockstep's steps


def play(name: str, run: Planned) -> Played:
    """Play a run of a configuration of that name."""
    if run.mode == "real_time":
        return _in_real_time(run.replay)
    return _in_environment(run.config) if run.mode == "environment" else _in_lockstep(name, run.config)


def _in_environment(config: Config) -> Played:
    began_ns = cpu_ns()
    return Played(evaluated(config), (cpu_ns() - began_ns) / S, 0.0)


def _in_real_time(command: str) -> Played:
    """Play a run by its own command; RuntimeError where it leaves no summary."""
    with TemporaryDirectory() as folder:
        began_s = _children_s()
        words = [sys.executable, "-P", "-m", *shlex.split(command), "--quiet", "--out", f"{folder}/run"]
        ended = subprocess.run(words, capture_output=True, text=True, check=False)
        file = Path(folder, "run", "summary.json")
        if not file.is_file():
            raise RuntimeError(f"exit code {ended.returncode}: {' '.join(ended.stderr.split())[-300:]}")
        return Played(json.loads(file.read_text()), _children_s() - began_s, 0.0)


def _children_s() -> float:
    """Return the CPU time of all processes that have ended, which this one started [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _in_lockstep(name: str, config: Config) -> Played:
    began_ns = cpu_ns()
    with redirect_stderr(StringIO()):  # processes complain as they should: the summary says what matters
        run = Lockstep(config)
        built_ns = cpu_ns()
        outcome, cause = driven(run, lambda _recording, _phase: None)
        ended_ns = cpu_ns()
    figures = summary(run.recording, name=name, mode="lockstep", outcome=outcome, cause=cause)
    run.recording.messages.clear()  # most of the memory, which the collector need not come for
    _collect()
    return Played(figures, (cpu_ns() - began_ns) / S, (ended_ns - built_ns) / S)


def _collect() -> None:
    """Free what refers to itself, from time to time."""
    global _runs  # noqa: PLW0603 - a worker counts its runs
    _runs += 1
    if _runs % _COLLECT_EVERY == 0:
        gc.collect()

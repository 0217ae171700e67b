"""A long run: memory, threads and open files of every process of it, and what its report needs.

    python -m tools.measure.runs.long_run --hours 12
    python -m tools.measure.runs.long_run --hours 1 --real-time

It drives the platoon, with true poses in lockstep and with the camera in real time; its batteries last. The slopes are
of the second half: what a process has when it has warmed up stays.
"""

import subprocess
import sys
import tempfile
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import numpy as np
import psutil

from robofleet.core.clock import S, WallClock
from robofleet.recording.log import FILE
from tools.measure.program import program

CONFIG = Path(__file__).parents[3] / "configs" / "platoon.yaml"
ROBOTS = 4
CLOCK = WallClock()
LASTING = [f"--set=robots.{k}.vehicle.simulated.battery_life_s=1.0e+9" for k in range(ROBOTS)]
WHAT = "memory, MB", "threads", "open files"
Sample = tuple[float, float, int, int]  # time [s], then as WHAT


def name_of(process: psutil.Process) -> str:
    """Return what a process is, by the words of its command."""
    words = [word for word in process.cmdline()[1:] if not word.startswith("-")]
    return f"{process.pid} {' '.join(Path(word).name for word in words[:3])[:40]}"


def sampled(command: list[str], every_s: float) -> tuple[int, dict[str, list[Sample]]]:
    """Run a command to its end; returns its exit code, and what it and its children had, now and then."""
    found: dict[str, list[Sample]] = defaultdict(list)
    with subprocess.Popen(command) as started:
        top = psutil.Process(started.pid)
        while started.poll() is None:
            with suppress(psutil.Error):
                for process in [top, *top.children(recursive=True)]:
                    with suppress(psutil.Error), process.oneshot():
                        had = process.memory_info().rss / 1e6, process.num_threads(), process.num_fds()
                        found[name_of(process)].append((CLOCK.now_ns() / S, *had))
            with suppress(subprocess.TimeoutExpired):
                started.wait(every_s)
    return started.returncode, found


def told(found: dict[str, list[Sample]], factor: float) -> None:
    """Print what each process had; ``factor``: hours of the run for each second of the clock."""
    for name, samples in found.items():
        rows = np.array(samples)
        late = rows[len(rows) // 2 :]
        if len(late) < 3:
            continue
        hours = (late[:, 0] - late[0, 0]) * factor
        each = (
            f"{what} {rows[:, k].max():.1f} at most, {np.polyfit(hours, late[:, k], 1)[0]:+.2f} an hour"
            for k, what in enumerate(WHAT, 1)
        )
        print(f"  {name}: {'; '.join(each)}")


def main() -> None:
    """Print the slopes of a run, and the most memory that its report had."""
    parser = program(__doc__, hours=1.0, real_time=False, every=(10.0, "seconds between two samples"))
    parser.add_argument("--out", type=Path, help="a folder to keep it in")
    told_to = parser.parse_args()
    robofleet = [sys.executable, "-m", "robofleet"]
    with tempfile.TemporaryDirectory() as spare:
        folder = told_to.out or Path(spare) / "run"
        how = [] if told_to.real_time else ["--lockstep", "--set=tracker.source=truth"]
        run = ["run", str(CONFIG), *how, *LASTING, "--quiet", "--out", str(folder)]
        began_s = CLOCK.now_ns() / S
        code, found = sampled([*robofleet, *run, f"--duration={told_to.hours * 3600:.0f}"], told_to.every)
        took_s = CLOCK.now_ns() / S - began_s
        print(f"a run of {told_to.hours:g} h: exit code {code}, {took_s / 3600:.2f} h of the clock")
        told(found, told_to.hours / took_s)
        print(f"  its file: {(folder / FILE).stat().st_size / 1e6:.0f} MB")
        code, found = sampled([*robofleet, "report", str(folder)], 0.2)
        most = max(sample[1] for samples in found.values() for sample in samples)
        print(f"its report: exit code {code}, memory at most {most:.0f} MB")


if __name__ == "__main__":
    main()

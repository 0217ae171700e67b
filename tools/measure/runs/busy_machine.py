"""The 88 s run of the platoon beside two busy loops: ``python -m tools.measure.runs.busy_machine --runs 5``.

The runs have no right to a higher priority, as on a laptop. Exit 1 unless each completes and says that the machine was
busy.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.measure.program import program

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
LOOPS = 2
_LOOP = "while True: pass"


@contextmanager
def busy_loops(count: int) -> Iterator[None]:
    loops = [subprocess.Popen([sys.executable, "-c", _LOOP]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def one_run(folder: Path, *overrides: str) -> dict[str, Any]:
    """Return the summary of a run; what it says goes to ``folder``'s ``said``."""
    ordinary = ["setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice"] if os.geteuid() == 0 else []
    changes = [word for change in ("arena.name=busy-machine", *overrides) for word in ("--set", change)]
    run = "run", str(PLATOON), "--out", str(folder / "run"), "--json"
    command = [*ordinary, sys.executable, "-m", "robofleet", *run]
    with (folder / "said").open("w") as log:
        done = subprocess.run(
            [*command, *changes], stdout=subprocess.PIPE, stderr=log, text=True, check=False,
            env=os.environ | {"XDG_STATE_HOME": str(folder)},
        )  # fmt: skip
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary


def main() -> int:
    parser = program(__doc__, runs=5)
    parser.add_argument("--set", action="append", default=[], dest="overrides", metavar="KEY=VALUE")
    arguments = parser.parse_args()
    good = 0
    for run in range(arguments.runs):
        with tempfile.TemporaryDirectory() as folder, busy_loops(LOOPS):
            summary = one_run(Path(folder), *arguments.overrides)
            warnings = (Path(folder) / "said").read_text().count("this machine is busy: ")
            if summary["outcome"] != "completed":
                shutil.copytree(folder, Path(tempfile.gettempdir()) / f"busy-machine-{os.getpid()}-{run + 1}")
        busy = summary["busy_machine"]
        good += summary["outcome"] == "completed" and busy is not None and warnings == 1
        stops = Counter(stop["cause"] for stop in summary["stops"]).most_common(3)
        print(
            f"{run + 1}: {summary['outcome']}, {summary['duration_s']:.1f} s, real time x {summary['real_time_factor']}"
        )
        print(
            f"   {summary['cause'] or 'no fault'}; said {warnings} times; {busy and busy['words']}; stops {stops}",
            flush=True,
        )
    print(f"{good} of {arguments.runs} completed and said once that the machine was busy")
    return int(good < arguments.runs)


if __name__ == "__main__":
    sys.exit(main())

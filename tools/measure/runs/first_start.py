"""A first and a later start, and Ctrl-C in them: ``python -m tools.measure.runs.first_start [--times N]``.

The compiled kernels of this installation are deleted for the first start, and made anew by it.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from robofleet.core.clock import S, WallClock
from robofleet.core.kernels import store
from tools.measure.program import program

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
SHOWN = ("starting", "compiling", "arming", "running")  # of the lines that a run says
_CLOCK = WallClock()


def start(folder: Path, interrupted_after_s: float | None = None) -> tuple[dict[str, float], int]:
    """Return when [s] a run of 3 s said what, when its page was there, and when it had ended; and its exit code."""
    began_ns = _CLOCK.now_ns()
    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "robofleet", "run", str(PLATOON), "--web", "--no-browser", "--duration", "3"),
            *("--set", "arena.name=first-start", "--out", str(folder / "run")),
        ],
        env=os.environ | {"XDG_STATE_HOME": str(folder)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    phases: dict[str, float] = {}
    if interrupted_after_s is not None:
        threading.Timer(interrupted_after_s, run.send_signal, [signal.SIGINT]).start()
    assert run.stdout is not None
    for line in run.stdout:
        what = "page" if "http://" in line else line.partition(" ")[0].strip()
        if what in (*SHOWN, "page"):
            phases.setdefault(what, (_CLOCK.now_ns() - began_ns) / S)
    code = run.wait()
    phases["ended"] = (_CLOCK.now_ns() - began_ns) / S - (interrupted_after_s or 0.0)
    return phases, code


def main() -> None:
    times = program(__doc__, times=(3, "of each")).parse_args().times
    for name, cold, after_s in (("first", True, None), ("later", False, None), ("Ctrl-C in a first one", True, 8.0)):
        for _ in range(times):
            if cold:
                shutil.rmtree(store.folder(), ignore_errors=True)
            with tempfile.TemporaryDirectory() as folder:
                phases, code = start(Path(folder), after_s)
            when = ", ".join(f"{what} {at_s:.1f} s" for what, at_s in phases.items())
            print(f"{name}: {when}; exit code {code}", flush=True)


if __name__ == "__main__":
    main()

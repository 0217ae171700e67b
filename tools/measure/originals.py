"""The Robotarium's own example scripts, here and in their own simulator: which run, and where the robots end.

    python -m tools.measure.originals CHECKOUT [--only NAME ...] [--here] [--ideal] [--real-time]

CHECKOUT is a clone of robotarium/robotarium_python_simulator: 6bb184e for version 1. It needs cvxopt, and scipy for
version 1. Each script runs unmodified; random draws are equal in both.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tools.measure.program import program

_SEEDED = Path(__file__).with_name("seeded.py")
_WITHIN_S = 600.0
_STEP_S = 0.033
_CAMERA = "--set", "tracker.source=camera"


class Compared(NamedTuple):
    """A script's end here and there."""

    name: str
    exit_code: int | None  # None: it did not end
    output: str
    ours: dict[str, Any] | None  # what seeded.py tells
    theirs: dict[str, Any] | None
    summary: dict[str, Any]

    @property
    def apart_mm(self) -> float:
        """The largest distance between where a robot ended here and there; NaN where one of them tells nothing."""
        if self.ours is None or self.theirs is None:
            return float("nan")
        apart = np.array(self.ours["last"])[:2] - np.array(self.theirs["last"])[:2]
        return float(np.hypot(*apart).max() * 1e3)

    @property
    def shape_mm(self) -> float:
        """The same when all robots here are moved and turned together as fits best: scripts without a place of their
        own end anywhere."""
        if self.ours is None or self.theirs is None:
            return float("nan")
        (x, y), (u, v) = (np.array(result["last"])[:2] for result in (self.ours, self.theirs))
        ours_centred, theirs_centred = x - x.mean() + 1j * (y - y.mean()), u - u.mean() + 1j * (v - v.mean())
        turn = np.vdot(ours_centred, theirs_centred)
        return float(np.abs(ours_centred * turn / abs(turn) - theirs_centred).max() * 1e3) if abs(turn) else 0.0


def version(checkout: Path) -> int:
    return 2 if "class ARobotarium" in (checkout / "rps" / "robotarium_abc.py").read_text() else 1


def scripts(checkout: Path) -> list[Path]:
    """Return the example scripts that make a Robotarium."""
    found = sorted((checkout / "rps" / "examples").rglob("*.py"))
    return [file for file in found if "Robotarium(" in file.read_text()]


def compared(checkout: Path, script: Path, how: Sequence[str] = (), theirs: bool = True) -> Compared:
    """Run a script here and, where wanted, there."""
    with tempfile.TemporaryDirectory() as folder:
        scripts_folder = Path(folder)
        env = {**os.environ, "PYTHONPATH": str(checkout), "MPLBACKEND": "Agg"}
        mine = [
            sys.executable, "-m", "robofleet", "robotarium", str(_SEEDED), "--api", str(version(checkout)),
            "--out", str(scripts_folder / "run"), *how, "--", str(script), str(scripts_folder / "ours"),
        ]  # fmt: skip
        exit_code, output = _ended(mine, scripts_folder, env)
        if theirs:
            _ended([sys.executable, str(_SEEDED), str(script), str(scripts_folder / "theirs")], scripts_folder, env)
        summary = scripts_folder / "run" / "summary.json"
        return Compared(
            script.stem, exit_code, output, _read(scripts_folder / "ours"), _read(scripts_folder / "theirs"),
            json.loads(summary.read_text()) if summary.is_file() else {},
        )  # fmt: skip


def _ended(command: Sequence[str], folder: Path, env: dict[str, str]) -> tuple[int | None, str]:
    """Run a command; return its exit code and what it said. None: it did not end."""
    with subprocess.Popen(
        command, cwd=folder, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:  # fmt: skip
        try:
            output, _ = process.communicate(timeout=_WITHIN_S)
            return process.returncode, output
        except subprocess.TimeoutExpired:
            process.terminate()
            output, _ = process.communicate()
            return None, output


def _read(file: Path) -> dict[str, Any] | None:
    return json.loads(file.read_text()) if file.is_file() else None


def _rows(checkout: Path, only: Sequence[str], how: Sequence[str], theirs: bool) -> Iterator[Compared]:
    for script in scripts(checkout):
        if not only or script.stem in only:
            yield compared(checkout, script, how, theirs)


def _speed(result: dict[str, Any]) -> float:
    """Return how many simulated seconds a second of CPU time gave."""
    return result["steps"] * _STEP_S / result["cpu_s"] if result and result["cpu_s"] else float("nan")


def main() -> None:
    parser = program(
        __doc__,
        here=(False, "not in their simulator"),
        ideal=(False, "robots without errors"),
        real_time=(False, "with a simulated camera"),
    )
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    arguments = parser.parse_args()
    how = [*(("--real-time", *_CAMERA) if arguments.real_time else ()), *(("--ideal",) if arguments.ideal else ())]
    print(
        f"{'script':36} exit  steps: ours theirs  apart mm  shape mm  barrier %  times real time: ours theirs  "
        "errors: ours / theirs"
    )
    for row in _rows(arguments.checkout.absolute(), arguments.only, how, not arguments.here):
        ours, theirs = row.ours or {}, row.theirs or {}
        changed = 100 * (row.summary.get("filtered_fraction") or 0.0)
        print(
            f"{row.name:36} {row.exit_code!s:>4}  {ours.get('steps', '-'):>11} {theirs.get('steps', '-'):>6}  "
            f"{row.apart_mm:8.1f}  {row.shape_mm:8.1f}  {changed:9.2f}  {_speed(ours):21.1f} {_speed(theirs):6.1f}  "
            f"{ours.get('errors')} / {theirs.get('errors')}", flush=True,
        )  # fmt: skip
        if row.exit_code != 0:
            print("    " + "\n    ".join(row.output.strip().splitlines()[-6:]), flush=True)


if __name__ == "__main__":
    main()

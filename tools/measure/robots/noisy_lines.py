"""Runs of a fleet whose serial lines are cut, spoilt and late: how many complete, and what moved that was not asked to.

    python -m tools.measure.robots.noisy_lines --runs 20 [--first K] [--seconds 20] [--share 0.01] [CONFIG]

Real processes, one run after the other, with seeds K, K + 1, ... The lines are disturbed from the moment when the fleet
runs: before, the checks refuse a robot that noise moves. Of a run that did not complete, the drivers' logs are shown.
A wrong motion is a target that a wheel-speed loop took, and that a firmware which heard every byte well did not have
within 0.3 s before.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.runs.realrun import own_folders
from tools.measure.program import program

SERIAL = Path(__file__).parents[3] / "configs" / "platoon-serial.yaml"
KINDS = ("line_cut", "line_garbage", "line_late")
_COUNTED = re.compile(r"(\w+): (\d+) wrong motions, at most ([\d.]+) rad/s from what was asked and (\d+) ms long")
_STRUCK = re.compile(r"(\d+) lines were struck")


def run(config: Path, folder: Path, seed: int, seconds: float, share: float) -> tuple[dict[str, Any], str]:
    """Return a run's summary, and what its twins said in the end."""
    faults = folder / "faults.yaml"
    lines = [f"  - {{kind: {kind}, share: {share}, at_s: 0}}" for kind in KINDS]
    faults.write_text("\n".join(["faults:", *lines]))
    command = [
        sys.executable, "-m", "robofleet", "run", str(config), "--out", str(folder / "run"), "--json", "--quiet",
        "--seed", str(seed), "--duration", str(seconds), "--faults", str(faults),
    ]  # fmt: skip
    done = subprocess.run(command, env=own_folders(folder), capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
    logs = folder / "run" / "log"
    summary: dict[str, Any] = json.loads(done.stdout)
    if summary["outcome"] != "completed":
        print(*(line for log in sorted(logs.glob("driver-*")) for line in log.read_text().splitlines()), sep="\n")
    return summary, (logs / "twins.log").read_text()


def main() -> None:
    parser = program(__doc__, runs=20, first=1, seconds=20.0, share=0.01)
    parser.add_argument("config", nargs="?", type=Path, default=SERIAL, metavar="CONFIG")
    arguments = parser.parse_args()
    completed, struck = 0, 0
    wrong: dict[str, list[tuple[int, float, int]]] = {}
    for seed in range(arguments.first, arguments.first + arguments.runs):
        with tempfile.TemporaryDirectory() as folder:
            summary, output = run(arguments.config, Path(folder), seed, arguments.seconds, arguments.share)
        completed += summary["outcome"] == "completed"
        struck += sum(map(int, _STRUCK.findall(output)))
        for robot, count, furthest, longest in _COUNTED.findall(output):
            wrong.setdefault(robot, []).append((int(count), float(furthest), int(longest)))
        error = summary["control_error_mm"]
        print(
            f"seed {seed}: {summary['outcome']}{': ' if summary['cause'] else ''}{summary['cause'] or ''}; "
            f"mean control error {error['mean'] if error else '-'} mm; wrong motions "
            + ", ".join(f"{robot}: {found[-1][0]}" for robot, found in wrong.items()),
            flush=True,
        )
    print(f"completed: {completed} of {arguments.runs}; lines struck: {struck}")
    for robot, found in wrong.items():
        counts, furthest, longest = zip(*found, strict=True)
        worst = f"at most {max(furthest):.3f} rad/s off, {max(longest)} ms at longest"
        print(f"{robot}: {sum(counts)} wrong motions, {worst}")


if __name__ == "__main__":
    main()

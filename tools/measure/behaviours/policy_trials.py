"""How often four robots arrive that a trained network drives, in lockstep: drawn starts and goals, camera, barrier.

    python -m tools.measure.behaviours.policy_trials [--seeds 100] [--first 1] [--jobs 2] [--source truth]

Starts and goals are drawn as in training. A run ends when all robots have been at their goals for half a second; one
that takes its whole time has not arrived.
"""

import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.policies.observations import drawn_poses
from robofleet.runs.check import load_checked
from robofleet.testing import run_lockstep
from tools.measure.program import program

CONFIG = Path(__file__).parents[3] / "configs" / "policy.yaml"


class Trial(NamedTuple):
    seed: int
    outcome: str
    cause: str | None
    seconds: float
    arrived: bool
    gap_mm: float  # between two robots, the smallest


def drive(source: str, policy: str, seed: int) -> Trial:
    shipped = load_config(CONFIG)
    team = groups.team(shipped, shipped.groups[0])
    starts, goals = drawn_poses(team, 2, np.random.default_rng(seed)).tolist()
    changes = {
        "tracker.source": source, "run.seed": seed, "groups.0.settings.file": policy,
        "groups.0.settings.task.goals": {
            robot: {"x_m": round(x, 4), "y_m": round(y, 4)}
            for robot, (x, y, _) in zip(team.robots, goals, strict=True)
        },
        **{
            f"robots.{k}.start": {"x_m": round(x, 4), "y_m": round(y, 4), "heading_deg": round(math.degrees(psi), 2)}
            for k, (x, y, psi) in enumerate(starts)
        },
    }  # fmt: skip
    run = run_lockstep(load_checked(CONFIG, [f"{k}={json.dumps(v)}" for k, v in changes.items()], lockstep=True))
    seconds = run.summary["duration_s"]
    arrived = run.outcome == "completed" and seconds < shipped.run.duration_s - 0.1
    return Trial(seed, run.outcome, run.cause, seconds, arrived, run.summary["min_gap_mm"])


def main() -> None:
    parser = program(
        __doc__, seeds=100, first=1, jobs=2, source="camera", policy=str(CONFIG.parent / "policies/go_to.onnx")
    )
    arguments = parser.parse_args()
    seeds, trials = range(arguments.first, arguments.first + arguments.seeds), []
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn")) as pool:
        for trial in pool.map(partial(drive, arguments.source, arguments.policy), seeds):
            trials.append(trial)
            print(trial, file=sys.stderr, flush=True)
    gaps, times = [trial.gap_mm for trial in trials], [trial.seconds for trial in trials if trial.arrived]
    print(f"{arguments.source}, {len(trials)} seeds: arrived {len(times)}, smallest gap {min(gaps):.1f} mm", end="")
    print(f", touches {sum(gap <= 0.0 for gap in gaps)}, time {np.median(times) if times else math.nan:.1f} s (median)")


if __name__ == "__main__":
    main()

"""Robots among obstacles, in lockstep with true poses: who arrives, and how near anybody comes to an obstacle.

    python -m tools.measure.behaviours.obstacle_trials [--seeds 200] [--first 1] [--jobs 2] [go_to cyclic_pursuit]

Four robots, and three obstacles across their ways: a disc, a polygon, and one that is not convex, at random places.
``go_to``: the robots change sides, from random poses to random ones. ``cyclic_pursuit``: the law knows no obstacle,
and those stand on the circle and around it; the barrier alone keeps the robots clear.
A scene that ``robofleet check`` refuses (a start or a goal beside an obstacle, no way) is drawn anew.
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

from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.runs.check import load_checked
from robofleet.testing import run_lockstep
from tools.measure.program import program

SHIPPED = Path(__file__).parents[3] / "configs" / "obstacles.yaml"
LONGEST_S = {"go_to": 90.0, "cyclic_pursuit": 40.0}
ROBOTS = ("r1", "r2", "r3", "r4")
RADIUS_M, SPEED_M_S = 0.6, 0.1  # of the pursuit's circle
LEAST_GAP_MM = 10.0

Pose = dict[str, float]


class Trial(NamedTuple):
    seed: int
    outcome: str
    cause: str | None
    seconds: float
    gap_mm: float  # to an obstacle, the smallest
    between_mm: float  # two robots


def star(rng: np.random.Generator, middle: tuple[float, float], corners: int, least: float) -> list[list[float]]:
    """Return a polygon about a middle; convex only by chance."""
    angle = (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) * math.tau / corners
    reach = rng.uniform(least, 0.22, corners)
    return [
        [round(middle[0] + r * math.cos(a), 3), round(middle[1] + r * math.sin(a), 3)]
        for a, r in zip(angle, reach, strict=True)
    ]


def drawn_obstacles(rng: np.random.Generator, behaviour: str) -> list[dict[str, object]]:
    """Return three obstacles, far enough from each other that robots pass between them."""
    places: list[tuple[float, float]] = []
    while len(places) < 3:
        if behaviour == "go_to":
            at = (float(rng.uniform(-0.7, 0.7)), float(rng.uniform(-0.6, 0.6)))
        else:
            angle, reach = rng.uniform(0.0, math.tau), RADIUS_M + rng.uniform(-0.15, 0.15)
            at = (float(reach * math.cos(angle)), float(reach * math.sin(angle)))
        if all(math.dist(at, other) > 0.6 for other in places):
            places.append(at)
    (x, y), first, other = places
    return [
        {"circle": {"x_m": round(x, 3), "y_m": round(y, 3), "radius_m": round(float(rng.uniform(0.03, 0.2)), 3)}},
        {"polygon_m": star(rng, first, 4, 0.14)},
        {"polygon_m": star(rng, other, 7, 0.05)},
    ]


def drawn_poses(rng: np.random.Generator, behaviour: str) -> tuple[list[Pose], list[Pose]]:
    """Return starts and goals: two robots on each side, who change sides."""

    def side(sign: int) -> list[tuple[float, float]]:
        while True:
            at = [(float(sign * rng.uniform(0.95, 1.4)), float(rng.uniform(-0.8, 0.8))) for _ in range(2)]
            if math.dist(*at) > 0.35:
                return at

    def posed(at: list[tuple[float, float]]) -> list[Pose]:
        return [
            {"x_m": round(x, 3), "y_m": round(y, 3), "heading_deg": round(rng.uniform(-180, 180), 1)} for x, y in at
        ]

    left, right = side(-1), side(1)
    return posed(left + right), posed(side(1) + side(-1))


def scene(behaviour: str, seed: int) -> tuple[Config, int]:
    """Return a configuration that can run, and how many drawn ones could not."""
    rng, refused = np.random.default_rng([seed, len(behaviour)]), 0
    while True:
        starts, goals = drawn_poses(rng, behaviour)
        settings: dict[str, object] = {"goals": dict(zip(ROBOTS, goals, strict=True))}
        if behaviour == "cyclic_pursuit":
            settings = {"radius_m": RADIUS_M, "speed_m_s": SPEED_M_S, "centre_m": [0.0, 0.0]}
        changes = {
            "tracker.source": "truth", "run.seed": seed, "run.duration_s": LONGEST_S[behaviour],
            "arena.obstacles": drawn_obstacles(rng, behaviour),
            "groups.0": {"behaviour": behaviour, "robots": ROBOTS, "settings": settings},
            **{f"robots.{k}.start": start for k, start in enumerate(starts)},
        }  # fmt: skip
        try:
            return load_checked(SHIPPED, [f"{k}={json.dumps(v)}" for k, v in changes.items()], lockstep=True), refused
        except ConfigError as error:
            if not any(word in str(error) for word in ("obstacle", "no way", "distance")):
                raise
            refused += 1


def drive(behaviour: str, seed: int) -> Trial:
    run = run_lockstep(scene(behaviour, seed)[0])
    figures = (run.summary[name] for name in ("duration_s", "min_obstacle_gap_mm", "min_gap_mm"))
    return Trial(seed, run.outcome, run.cause, *figures)


def arrived(behaviour: str, trial: Trial) -> bool:
    """Whether a run ended as it should: ``go_to`` ends when all have arrived."""
    in_time = behaviour != "go_to" or trial.seconds < LONGEST_S[behaviour] - 0.1
    return trial.outcome == "completed" and in_time


def main() -> None:
    parser = program(__doc__, seeds=200, first=1, jobs=2)
    parser.add_argument("behaviours", nargs="*", default=["go_to", "cyclic_pursuit"])
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn")) as pool:
        for behaviour in arguments.behaviours:
            trials = []
            for trial in pool.map(partial(drive, behaviour), seeds):
                trials.append(trial)
                if not arrived(behaviour, trial) or trial.gap_mm < LEAST_GAP_MM:
                    print(f"{behaviour}: {trial}", file=sys.stderr, flush=True)
            good, gaps = sum(arrived(behaviour, trial) for trial in trials), [trial.gap_mm for trial in trials]
            print(f"{behaviour}, {len(trials)} seeds: {'arrived' if behaviour == 'go_to' else 'completed'} {good}")
            print(f"  gap to an obstacle: smallest {min(gaps):.1f} mm, median {np.median(gaps):.1f} mm")
            print(f"  gap between robots: smallest {min(trial.between_mm for trial in trials):.1f} mm")
            print(f"  time: median {np.median([t.seconds for t in trials]):.1f} s", flush=True)


if __name__ == "__main__":
    main()

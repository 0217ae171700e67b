"""From random places to the platoon's start, and one lap: in lockstep, with the camera in the loop.

    python -m tools.measure.behaviours.to_start_trials [--seeds 20] [--first 1] [--duration 88]

The four robots of the shipped platoon stand anywhere on the floor, at least 1.3 body diameters apart. Every run is the
whole stack: checks, the way to the start, the lap.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from robofleet.config.load import load_config
from robofleet.testing import run_lockstep
from tools.measure.program import program

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
RADIUS, HALF = 0.055, (1.6, 1.0)  # of a GTernal's body, of the arena [m]
APART, INSIDE = 1.3 * 2 * RADIUS, RADIUS + 0.05  # the wheels are tried first: that needs some room


def starts(seed: int, count: int) -> list[tuple[float, float, float]]:
    """Return poses of the centres: x, y [m], heading [deg]."""
    rng, found = np.random.default_rng(seed), list[tuple[float, float, float]]()
    while len(found) < count:
        x, y = (float(rng.uniform(INSIDE - half, half - INSIDE)) for half in HALF)
        if all(math.dist((x, y), other[:2]) >= max(APART, 2 * RADIUS + 0.05) for other in found):
            found.append((round(x, 4), round(y, 4), round(float(rng.uniform(-180, 180)), 1)))
    return found


def drive(seed: int, duration_s: float) -> tuple[str, str | None, float, float]:
    """Return how a run ended, its cause, the smallest gap [mm], and the mean control error [mm]."""
    changes = ["run.begin=go_to_start", f"run.duration_s={duration_s}", f"run.seed={seed}"]
    for k, (x, y, psi) in enumerate(starts(seed, 4)):
        changes.append(f"robots.{k}.start={{x_m: {x}, y_m: {y}, heading_deg: {psi}}}")
    run = run_lockstep(load_config(PLATOON, changes))
    error, gap = run.summary["control_error_mm"], run.summary["min_gap_mm"]
    return run.outcome, run.cause, math.nan if gap is None else gap, math.nan if error is None else error["mean"]


def main() -> None:
    arguments = program(__doc__, seeds=20, first=1, duration=88.0).parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    completed = 0
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for seed, found in zip(seeds, pool.map(partial(drive, duration_s=arguments.duration), seeds), strict=True):
            outcome, cause, gap, error = found
            completed += outcome == "completed"
            print(f"seed {seed:4d}  {outcome}  gap {gap:6.1f} mm  control {error:5.2f} mm  {cause or ''}", flush=True)
    print(f"{completed} of {len(seeds)} completed")


if __name__ == "__main__":
    main()

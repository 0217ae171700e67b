"""Whether ``robofleet gap`` over several days names a robot that wears, and no other.

$ python -m tools.measure.robots.wear

A platoon drives once a day. After the first day it is identified; then both wheels of r2 lose so much of their radius a
day. Each day has its own seed: its own noise, the same robots.
"""

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from robofleet.calibration.commands.gap import gap
from robofleet.calibration.commands.identify import identify
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.operator.run import in_lockstep
from robofleet.runs.check import load_checked

CONFIG = Path("configs/platoon.yaml").resolve()
WORN = "r2"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--days", type=int, default=6)
    parser.add_argument("--wear", type=float, default=0.003, help="of the radius, a day")
    parser.add_argument("--seconds", type=float, default=40.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        days = [Path(f"day{k + 1}") for k in range(given.days)]
        for k, day in enumerate(days):
            day.mkdir()
            overrides = [f"run.seed={k + 1}", f"run.duration_s={given.seconds:g}"]
            config = as_bad_each_day(load_checked(CONFIG, overrides, lockstep=True), k * given.wear)
            in_lockstep(config, day.name, day, quiet=True)
        identify(days[:1], configs=Path("lab"))
        gap(days, configs=Path("lab"))


def as_bad_each_day(config: Config, wear: float) -> Config:
    """Return robots whose errors do not depend on the day's seed, one of them worn."""
    rng = np.random.default_rng(33)
    return config.model_copy(update={"robots": tuple(_robot(robot, rng, wear) for robot in config.robots)})


def _robot(robot: Robot, rng: np.random.Generator, wear: float) -> Robot:
    assert robot.vehicle.simulated is not None
    error, difference = rng.uniform(-0.02, 0.02, 2).tolist()
    errors = robot.vehicle.simulated.model_copy(
        update={
            "wheel_gain_error": error - (wear if robot.id == WORN else 0.0), "wheel_gain_difference": difference,
            "wheel_gain_spread": 0.0, "wheel_base_spread": 0.0,
        }
    )  # fmt: skip
    return robot.model_copy(update={"vehicle": robot.vehicle.model_copy(update={"simulated": errors})})


if __name__ == "__main__":
    main()

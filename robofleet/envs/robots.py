"""Robots that are drawn anew for each episode (domain randomisation): as far from each other as yours may be.

A robot that ``robofleet identify`` measured is drawn from the covariance of its parameters. Of another one the spreads
of its vehicle's ``simulated`` are drawn, as at the start of each run.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from robofleet.config import slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.vehicles.plant import Build, built

MOST_LATE_S = 0.075  # that a robot may obey later than its controller believes

Builds = Callable[[np.random.Generator], Sequence[Build]]


def builds(config: Config, scale: float = 1.0) -> Builds:
    """Return what draws the members (N,) of an episode.

    Args:
        config: The configuration of a run.
        scale: What standard deviations and spreads are multiplied by; 0: always the same robots.

    Raises:
        ValueError: A robot cannot be simulated: nothing says how it differs from an ideal one, or it obeys far later
            than its controller believes.
    """
    draws = [_draw(config, robot, scale) for robot in config.members]
    return lambda rng: [draw(rng) for draw in draws]


def _draw(config: Config, robot: Robot, scale: float) -> Callable[[np.random.Generator], Build]:
    p, drive = slices.imperfections(robot), slices.vehicle_drive(robot.vehicle)
    late_ns = round((config.lockstep.bus_delay_s + p.actuation_delay) * S) - slices.delay_ns(config, robot)
    if late_ns > MOST_LATE_S * S:
        raise ValueError(
            f"{robot.id} obeys {late_ns / S:.3f} s later than its controller believes, an environment takes at most "
            f"{MOST_LATE_S:g} s: mend controller.command_delay_s, or the robot's delay_s"
        )
    p = replace(
        p, wheel_gain_spread=scale * p.wheel_gain_spread, wheel_base_spread=scale * p.wheel_base_spread,
        actuation_delay=late_ns / S,
    )  # fmt: skip
    known = None if robot.calibration is None else robot.calibration.identified
    if known is None or not known.parameters:
        return lambda rng: built(drive, p, rng)
    names, root = known.parameters, scale * _square_root(np.array(known.covariance))

    def draw(rng: np.random.Generator) -> Build:
        off = (root @ rng.standard_normal(len(root))).tolist()
        return _changed(built(drive, p, rng), dict(zip(names, off, strict=True)))

    return draw


def _square_root(covariance: "np.ndarray[tuple[int, int], np.dtype[np.float64]]") -> np.ndarray:
    """Return a matrix whose product with its transpose is a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _changed(b: Build, off: dict[str, float]) -> Build:
    """Return a robot whose parameters, by the names of ``identify``, lie so far off; a time is never below 0."""
    radius = b.wheel_radius

    def least_0(value: float, name: str) -> float:
        return max(0.0, value + off.get(name, 0.0))

    return replace(
        b,
        left_gain=b.left_gain + off.get("left_radius_m", 0.0) / radius,
        right_gain=b.right_gain + off.get("right_radius_m", 0.0) / radius,
        wheel_base=b.wheel_base + off.get("wheel_base_m", 0.0),
        motor_lag=least_0(b.motor_lag, "motor_lag_s"),
        stop_lag=least_0(b.stop_lag, "stop_lag_s"),
        deadband=least_0(b.deadband, "deadband_rad_s"),
        breakaway=least_0(b.breakaway, "breakaway_rad_s"),
        max_wheel_speed=least_0(b.max_wheel_speed, "top_speed_rad_s"),
        slip=least_0(b.slip, "slip_s_per_rad"),
        delay_ns=round(min(max(0.0, b.delay_ns / S + off.get("delay_s", 0.0)), MOST_LATE_S) * S),
    )

"""A lap of a closed path: what a robot does that follows it without error, and where it stands still."""

import math
from dataclasses import dataclass

import numpy as np

from robofleet.behaviours.interface import Bound
from robofleet.control.path import Path
from robofleet.core.arrays import Array

STEPS = 1000  # a side: the fastest wheel is then known to about 1e-5 of itself
_STANDSTILL = 0.01  # of the mean |r'|: a path slower than this at a point has a cusp there


@dataclass(frozen=True)
class Lap:
    """A robot on its lap when it follows the path without error: arrays over the parameter, shape (n,)."""

    sigma: Array
    position: Array  # r, shape (n, 2) [m]
    speed: Array  # |r'| [m a side]
    v: Array  # of the body [m/s]
    omega: Array  # of the body [rad/s]
    centre: Array  # of the robot, shape (n, 2) [m]


def drive_lap(path: Path, rate: float, point_ahead: float, *, centre_tracked: bool) -> Lap:
    """Return the lap of a robot whose point p (or centre) moves exactly as r(gamma t); ``rate``: gamma [sides/s].

    p at r makes the heading follow psi' = (-sin psi r_x' + cos psi r_y') / l: solved exactly over steps with
    r' held, which is stable for every l > 0; the first of two laps forgets the start.
    """
    sigma = (np.arange(path.sides * STEPS) + 0.5) / STEPS
    derivative = path.derivative(sigma)
    speed = np.hypot(derivative[:, 0], derivative[:, 1])
    if centre_tracked:
        second = path.second_derivative(sigma)
        cross = derivative[:, 0] * second[:, 1] - derivative[:, 1] * second[:, 0]
        along, turn = speed, cross / np.maximum(speed, np.finfo(float).tiny) ** 2
        centre = path.position(sigma)
    else:
        decay = np.exp(-speed / (STEPS * point_ahead)).tolist()
        direction = np.arctan2(derivative[:, 1], derivative[:, 0]).tolist()
        psi = direction[-1]
        lags = []  # from r' to the heading, before and after each step [rad]
        for towards, factor in zip(direction * 2, decay * 2, strict=True):
            before = math.remainder(psi - towards, math.tau)
            after = 2 * math.atan(math.tan(before / 2) * factor)
            psi += after - before
            lags.append((before, after))
        lag = np.array(lags[len(sigma) :])
        along, turn = speed * np.cos(lag.mean(axis=1)), (lag[:, 1] - lag[:, 0]) * STEPS
        heading = np.array(direction) + lag.mean(axis=1)
        centre = path.position(sigma) - point_ahead * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return Lap(sigma, path.position(sigma), speed, along * rate, turn * rate, centre)


def no_cusp(lap: Lap, key: str) -> Bound:
    """Return the bound by which the path nowhere stands still; ``key``: where the path is written."""
    slowest = int(lap.speed.argmin())
    mend = f"it stands still at parameter {lap.sigma[slowest]:.2f}, so mend the derivatives of its knots"
    return Bound(
        key, "the path's smallest derivative", float(lap.speed[slowest]), _STANDSTILL * float(lap.speed.mean()),
        "m a side", mend, at_least=True,
    )  # fmt: skip


def rounded_down(value: float) -> float:
    """Return a number of three digits that is at most 1 % less, and not more."""
    return float(f"{0.995 * value:.3g}")

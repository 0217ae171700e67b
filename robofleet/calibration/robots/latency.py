"""A robot's delay and motor lag: the part of its model that ``latency`` keeps.

The delay is the time from the instant of a tick to the moment when the wheels begin to follow that tick's command;
the lag is the time constant with which they follow. Instants are of the controller's clock, poses at their
mid-exposure: so both are exactly what the fleet filter predicts with.
"""

from dataclasses import dataclass

import numpy as np

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.information import PARAMETERS as MODEL
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

PARAMETERS = ("delay_s", "motor_lag_s")

_LONGEST_S = 0.6
_WORST_SIGMA_S = 0.002
_NEGATIVE_DELAY_S = 0.003  # so far below zero it still counts as zero
_LEAST_CHANGES = 20  # of the wheels' commands


@dataclass(frozen=True)
class Latency:
    """What was found for one robot. ``covariance`` (2, 2): rows as PARAMETERS."""

    robot: str
    delay_s: float
    motor_lag_s: float
    covariance: Array
    found: Identification

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def refuse_unusable(drive: RobotDrive) -> None:
    """Raise a CalibrationError where the commands hardly change."""
    changes = int(np.abs(np.diff(drive.commands_rad_s, axis=0)).any(axis=1).sum())
    if changes < _LEAST_CHANGES:
        raise CalibrationError(
            f"{drive.robot}: its commands changed {changes} times only, {_LEAST_CHANGES} are needed for its delay: "
            "drive longer"
        )


def of(found: Identification) -> Latency:
    """Return a robot's delay and lag.

    Raises:
        CalibrationError: the drive does not determine them.
    """
    robot, delay_s, lag_s = found.robot, found.wheels.delay_s, found.wheels.motor_lag_s
    rows = [MODEL.index(name) for name in PARAMETERS]
    latency = Latency(robot, max(0.0, delay_s), lag_s, found.covariance[np.ix_(rows, rows)], found)
    sigma = latency.sigma
    if not max(sigma) <= _WORST_SIGMA_S:
        raise CalibrationError(
            f"{robot}: its delay is known to {1e3 * sigma[0]:.1f} ms and its lag to {1e3 * sigma[1]:.1f} only, "
            f"{1e3 * _WORST_SIGMA_S:.0f} are allowed: drive longer, or with more changes"
        )
    if not -_NEGATIVE_DELAY_S <= delay_s <= _LONGEST_S or lag_s >= _LONGEST_S:
        raise CalibrationError(
            f"{robot}: a delay of {1e3 * delay_s:.1f} ms and a lag of {1e3 * lag_s:.1f} ms cannot be: are the camera's "
            "time stamps right?"
        )
    return latency

"""A robot's delay and motor lag, by a joint fit of its commands and its measured poses.

The delay is the time from the instant of a tick to the moment when the wheels begin to follow that tick's command;
the lag is the time constant with which they follow. Instants are of the controller's clock, poses at their
mid-exposure: so both are exactly what the fleet filter predicts with.

For any delay and lag the wheels' angles follow from the commands, and the turn and the shift from pose to pose are
linear in them: their factors (wheel radii, base, the tag's place) are solved for on the way, and need not be known.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.increments import (
    Increments,
    Noise,
    increments,
    left_out,
    noise_of,
    refuse_unusable,
    through_gate,
    wheel_travel,
    whiten,
)
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

PARAMETERS = ("delay_s", "motor_lag_s")

_DELAYS = np.linspace(0.0, 0.35, 15).tolist()  # where the search begins [s]
_LAGS = (0.005, 0.03, 0.06, 0.12, 0.24, 0.5)
_DIFFERENCE_S = 2e-4
_SETTLED_S = 1e-6
_ROUNDS = 12
_PASSES = 3
_SMALL_LAG_S = 0.003  # one below cannot be told from a delay
_LOWEST, _HIGHEST = (-0.1, 0.0), (1.0, 1.0)  # delay and lag that are tried [s]
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
    left_out: int  # poses
    at_s: Array  # (n,) instants of increments
    turn_rad_s: Array  # (n,) measured rate of turning
    modelled_rad_s: Array  # (n,) and as the fit has it

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def find(drive: RobotDrive) -> Latency:
    """Find a robot's delay and lag.

    Raises:
        CalibrationError: the drive does not determine them.
    """
    refuse_unusable(drive)
    changes = int(np.abs(np.diff(drive.commands_rad_s, axis=0)).any(axis=1).sum())
    if changes < _LEAST_CHANGES:
        raise CalibrationError(
            f"{drive.robot}: its commands changed {changes} times only, {_LEAST_CHANGES} are needed for its delay: "
            "drive longer"
        )
    try:
        return _find(drive)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"{drive.robot}: what it did does not depend on its commands: drive again") from error


def _find(drive: RobotDrive) -> Latency:
    kept = np.ones(len(drive.poses_s), dtype=np.bool_)
    model = _Model(drive, kept)
    theta, free = model.coarse(), 2
    for _ in range(_PASSES):  # the first says little of the noise, as the grid is coarse, nor of outliers
        noises = tuple(noise_of(e[None], model.inc) for e in model.residuals(theta))
        theta, covariance = model.descend(theta, noises, free)
        small = _SMALL_LAG_S if theta[0] >= 0.0 else 2.0 * _SMALL_LAG_S
        if free == 2 and theta[1] < small:  # it is one with the delay
            free, theta = 1, np.array([theta.sum(), 0.0])
            theta, covariance = model.descend(theta, noises, free)
        kept = left_out(drive, kept, model.residuals(theta))
        model = _Model(drive, kept)
    measured, modelled = model.turns(theta)
    found = Latency(
        drive.robot, float(theta[0]), float(theta[1]), covariance, int((~kept).sum()), model.inc.at_s, measured,
        modelled,
    )  # fmt: skip
    _refuse(found)
    return replace(found, delay_s=max(0.0, found.delay_s))


def _refuse(found: Latency) -> None:
    robot, sigma = found.robot, found.sigma
    if not max(sigma) <= _WORST_SIGMA_S:
        raise CalibrationError(
            f"{robot}: its delay is known to {1e3 * sigma[0]:.1f} ms and its lag to {1e3 * sigma[1]:.1f} only, "
            f"{1e3 * _WORST_SIGMA_S:.0f} are allowed: drive longer, or with more changes"
        )
    if not -_NEGATIVE_DELAY_S <= found.delay_s <= _LONGEST_S or found.motor_lag_s >= _LONGEST_S:
        raise CalibrationError(
            f"{robot}: a delay of {1e3 * found.delay_s:.1f} ms and a lag of {1e3 * found.motor_lag_s:.1f} ms cannot "
            "be: are the camera's time stamps right?"
        )


class _Model:
    """Turns and shifts of the kept poses as functions of theta = (delay, lag) [s]."""

    def __init__(self, drive: RobotDrive, kept: NDArray[np.bool_]) -> None:
        self._at_s, poses = drive.poses_s[kept], drive.poses[kept]
        self._outputs = through_gate(drive)
        self.inc: Increments = increments(self._at_s, poses)

    def residuals(self, theta: Array) -> tuple[Array, ...]:
        """Return what is left of the three channels, unwhitened."""
        return tuple(_left(columns, y) for columns, y in self._channels(theta))

    def coarse(self) -> Array:
        """Return the best of a grid: the squares have more than one valley."""
        scale = [1.4826 * float(np.median(np.abs(y))) + 1e-12 for y in self.inc.channels]

        def cost(theta: Array) -> float:
            parts = zip(self.residuals(theta), scale, strict=True)
            return sum(float(np.minimum(np.abs(e / s), 10.0) @ np.minimum(np.abs(e / s), 10.0)) for e, s in parts)

        grid = [np.array([delay, lag]) for delay in _DELAYS for lag in _LAGS]
        return min(grid, key=cost)

    def descend(self, theta: Array, noises: tuple[Noise, ...], free: int) -> tuple[Array, Array]:
        """Return the least whitened squares from theta on (Gauss-Newton, steps halved), and theta's covariance.

        ``free``: 2, or 1 for the delay alone.
        """
        e = self._whitened(theta, noises)
        for _ in range(_ROUNDS):
            derivative = self._derivative(theta, noises)[:, :free]
            step = np.zeros(2)
            step[:free] = -np.linalg.lstsq(derivative, e, rcond=None)[0]
            for halved in range(8):
                trial = np.clip(theta + step / 2**halved, _LOWEST, _HIGHEST)
                left = self._whitened(trial, noises)
                if left @ left <= e @ e:
                    break
            moved, theta, e = np.abs(trial - theta).max(), trial, left
            if moved < _SETTLED_S:
                break
        derivative = self._derivative(theta, noises)[:, :free]
        covariance = np.diag((0.0, (_SMALL_LAG_S / 2.0) ** 2))
        covariance[:free, :free] = np.linalg.inv(derivative.T @ derivative) * float(e @ e) / len(e)
        return theta, covariance

    def turns(self, theta: Array) -> tuple[Array, Array]:
        e = self.residuals(theta)[0]
        return self.inc.turn / self.inc.duration_s, (self.inc.turn - e) / self.inc.duration_s

    def _channels(self, theta: Array) -> list[tuple[Array, Array]]:
        angles = np.diff(wheel_travel(*self._outputs, theta[0], theta[1], self._at_s), axis=0)
        rate = np.abs(angles[:, 1] - angles[:, 0]) / self.inc.duration_s
        turning = np.column_stack([angles, rate * (angles[:, 1] - angles[:, 0])])  # the last: what slips
        shifting = np.column_stack([angles, self.inc.turn])
        return [(turning, self.inc.turn), (shifting, self.inc.shift[:, 0]), (shifting, self.inc.shift[:, 1])]

    def _whitened(self, theta: Array, noises: tuple[Noise, ...]) -> Array:
        parts = []
        for (columns, y), noise in zip(self._channels(theta), noises, strict=True):
            white = whiten(np.column_stack([columns, y]), self.inc, noise)
            parts.append(_left(white[:, :-1], white[:, -1]))
        return np.concatenate(parts)

    def _derivative(self, theta: Array, noises: tuple[Noise, ...]) -> Array:
        columns = []
        for k in range(2):
            ahead, behind = theta + _DIFFERENCE_S * np.eye(2)[k], theta - _DIFFERENCE_S * np.eye(2)[k]
            behind[1] = max(behind[1], 0.0)
            change = self._whitened(ahead, noises) - self._whitened(behind, noises)
            columns.append(change / (ahead - behind)[k])
        return np.column_stack(columns)


def _left(columns: Array, y: Array) -> Array:
    """Return what is left of y when its best combination of columns is taken away."""
    return np.asarray(y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0])

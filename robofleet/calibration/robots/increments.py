"""Least squares on the motion of a robot from pose to pose.

An increment is the difference of two measured poses, so two that follow each other share the noise of the pose
between them, with opposite signs; slip adds to each its own. Both parts are estimated from the residuals, and the
increments are whitened by them: this weighs a drive as the poses themselves would, and lets it wander off the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array
from robofleet.safety.gate import RAMP_NS

_FEWEST_SAMPLES = 3  # of an angle
_OUTLIER_SHARE = 0.2  # of the poses, at most
_SHORTEST_LAG_S = 1e-6
_SAME_RAD = 1e-6
_RAMP_S = RAMP_NS * 1e-9
_SPIKE_SIGMA = 6.0  # of a pose that is left out
_SEEN_SHARE = 0.6  # of the images, at least
_LONGEST_GAP_S = 1.0
_ALMOST_NOTHING = 1e-9  # noise of poses that have none [rad, m]
_NOISE_RATIOS = np.geomspace(1e-3, 1e3, 13).tolist()  # of what slip adds in a second to a pose's variance [1/s]


@dataclass(frozen=True)
class Noise:
    """Variances of an increment: of each pose behind it, and of what slip adds in a second."""

    pose: float
    wander: float


@dataclass(frozen=True)
class Increments:
    """From pose to pose: instants (n,) of the later one [s], duration (n,) [s], turn (n,) [rad], shift (n, 2) [m].

    The shift is seen in the frame of the tag half way.
    """

    at_s: Array
    duration_s: Array
    turn: Array
    shift: Array

    @property
    def channels(self) -> tuple[Array, Array, Array]:
        """Turn, shift along the tag's x, and along its y."""
        return self.turn, self.shift[:, 0], self.shift[:, 1]


@dataclass(frozen=True)
class Solution:
    """What least squares found."""

    values: Array  # (p,)
    covariance: Array  # (p, p)
    residuals: Array  # (m, n) of the increments
    noise: Noise


def refuse_unusable(drive: RobotDrive) -> None:
    """Raise a CalibrationError if a robot was not seen well enough, or stood still."""
    if len(drive.told_s) < _FEWEST_SAMPLES:
        raise CalibrationError(f"{drive.robot}: its driver did not report the wheels' commands: drive again")
    start_s, end_s = drive.commands_s[[0, -1]] if len(drive.commands_s) else (0.0, 0.0)
    seen = drive.poses_s[(drive.poses_s >= start_s) & (drive.poses_s <= end_s)]
    gap_s = float(np.diff(np.concatenate([[start_s], seen, [end_s]])).max())
    fraction = len(seen) / max(1, len(drive.commands_s))
    if gap_s > _LONGEST_GAP_S or fraction < _SEEN_SHARE:
        raise CalibrationError(
            f"{drive.robot}: it was seen in {100 * fraction:.0f} % of the images, and once not for {gap_s:.1f} s: "
            "light its tag, clear the view, and drive again"
        )
    far = np.ptp(drive.poses[:, :2], axis=0).max(), np.ptp(np.unwrap(drive.poses[:, 2]))
    if far[0] < 0.01 and far[1] < 0.3:
        raise CalibrationError(f"{drive.robot}: it was told to move and did not: is it switched on?")


def increments(at_s: Array, poses: Array) -> Increments:
    """Return what happened between poses (M, 3) of a tag."""
    heading = np.unwrap(poses[:, 2])
    middle = (heading[1:] + heading[:-1]) / 2.0
    c, s = np.cos(middle), np.sin(middle)
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    shift = np.column_stack([c * dx + s * dy, c * dy - s * dx])
    return Increments(at_s[1:], np.diff(at_s), np.diff(heading), shift)


def through_gate(drive: RobotDrive) -> tuple[Array, Array]:
    """Return instants (K,) [s] and wheel speeds (K, 2) [rad/s] that the gate makes of a drive's commands.

    It lets the wheels follow with limited acceleration: without that a jump would look like a delay.
    """
    ends_s = [*drive.commands_s[1:].tolist(), np.inf]
    instants, rows, last_s, output = [], [], -np.inf, np.zeros(2)
    for tick_s, end_s, command in zip(drive.commands_s.tolist(), ends_s, drive.commands_rad_s, strict=True):
        at_s, arrives = tick_s, False
        while at_s < end_s and not arrives:
            reach = drive.acceleration_rad_s2 * min(at_s - last_s, _RAMP_S)
            furthest = float(np.abs(command - output).max())
            arrives = furthest <= reach
            output = command if arrives else output + reach / furthest * (command - output)
            instants.append(at_s)
            rows.append(output)
            last_s, at_s = at_s, at_s + _RAMP_S
    return np.array(instants), np.array(rows)


def as_told(drive: RobotDrive, at_s: Array, outputs: Array) -> tuple[Array, Array]:
    """Return outputs (K, 2) that begin at instants (K,), as ``through_gate``, corrected by what the gate told.

    Between two statuses it told its wheels to turn by so much: commands came late, it was stepped more often than its
    ramp needs, or it was closed. The difference is spread over the time between the statuses.
    """
    told_s = drive.told_s
    short = np.diff(drive.told_rad - wheel_travel(at_s, outputs, 0.0, 0.0, told_s), axis=0)
    speeds = np.where(np.abs(short) > _SAME_RAD, short, 0.0) / np.diff(told_s)[:, None]
    every_s = np.union1d(at_s, told_s)
    k = np.searchsorted(at_s, every_s, side="right") - 1
    between = np.searchsorted(told_s, every_s, side="right") - 1
    corrections = np.vstack([speeds, np.zeros((1, 2))])[np.clip(between, -1, len(speeds))]
    return every_s, np.where(k[:, None] >= 0, outputs[k], 0.0) + corrections


def wheel_travel(commands_s: Array, commands: Array, delay_s: float, lag_s: float, at_s: Array) -> Array:
    """Return the angles (M, 2) that wheels at rest at first have turned at instants (M,) [rad].

    Commands (K, 2) act ``delay_s`` after their ticks (K,); the wheels follow with a first-order lag.
    """
    acts_s = commands_s + delay_s
    lag_s = max(lag_s, _SHORTEST_LAG_S)
    steps = np.diff(acts_s)
    kept = np.exp(-steps / lag_s)
    speed, angle = np.zeros_like(commands), np.zeros_like(commands)  # when each command begins to act
    for side in range(2):
        w, turned = 0.0, 0.0
        commanded = commands[:, side].tolist()
        history = [(w, turned)]
        for command, step, part in zip(commanded, steps.tolist(), kept.tolist(), strict=False):
            ahead = w - command
            turned += command * step + ahead * lag_s * (1.0 - part)
            w = command + ahead * part
            history.append((w, turned))
        speed[:, side], angle[:, side] = np.array(history).T
    k = np.searchsorted(acts_s, at_s, side="right") - 1
    since = np.where(k >= 0, at_s - acts_s[k], 0.0)[:, None]
    travel = angle[k] + commands[k] * since + (speed[k] - commands[k]) * (lag_s * -np.expm1(-since / lag_s))
    return np.where(k[:, None] >= 0, travel, 0.0)


def lagging(at_s: Array, commanded: Array, lag_s: float) -> Array:
    """Return the angles (T, 2) of wheels that follow, with a first-order lag, what they were told to turn (T, 2).

    They are told evenly from sample to sample, and stand where they were told at the first.
    """
    speeds = np.diff(commanded, axis=0) / np.diff(at_s)[:, None]
    return np.asarray(commanded[0] + wheel_travel(at_s, np.vstack([speeds, speeds[-1:]]), 0.0, lag_s, at_s))


def solve(columns: Array, y: Array, inc: Increments) -> Solution:
    """Fit y (m, n) by columns (m, n, p): m axes share the parameters, and the size of their noise.

    Raises:
        numpy.linalg.LinAlgError: the columns do not determine the parameters.
    """
    values: Array = np.asarray(np.linalg.lstsq(columns.reshape(-1, columns.shape[-1]), y.ravel(), rcond=None)[0], float)
    covariance: Array = np.empty(0)
    for _ in range(2):
        noise = noise_of(y - columns @ values, inc)
        a = np.concatenate([whiten(axis, inc, noise) for axis in columns])
        b = whiten(y.T, inc, noise).T.ravel()
        inverse = np.linalg.inv(a.T @ a)
        values = inverse @ (a.T @ b)
        left = b - a @ values
        covariance = np.asarray(inverse * float(left @ left) / max(1, len(b) - len(values)))
    return Solution(values, covariance, y - columns @ values, noise)


def noise_of(residuals: Array, inc: Increments) -> Noise:
    """Return the two variances that make residuals (m, n) likeliest, by a search over their ratio."""
    best, likeliest = Noise(_ALMOST_NOTHING**2, 0.0), -np.inf
    for ratio in _NOISE_RATIOS:
        scales, shares = _triangular(inc, Noise(1.0, ratio))
        white = np.array([_whitened(axis, scales, shares) for axis in residuals])
        variance = max(float((white**2).mean()), _ALMOST_NOTHING**2)
        likelihood = -float(np.log(scales).sum()) * len(white) - 0.5 * white.size * float(np.log(variance))
        if likelihood > likeliest:
            best, likeliest = Noise(variance, ratio * variance), likelihood
    return best


def whiten(columns: Array, inc: Increments, noise: Noise) -> Array:
    """Return columns (n, p) of increments as columns of independent noise of variance 1."""
    scales, shares = _triangular(inc, noise)
    return np.array([_whitened(column, scales, shares) for column in columns.T]).T


def _triangular(inc: Increments, noise: Noise) -> tuple[list[float], list[float]]:
    """Return the two diagonals of L, with L L' the increments' covariance, which has three."""
    scales, shares, below = [], [], 0.0
    for own in (2.0 * noise.pose + noise.wander * inc.duration_s).tolist():
        scale = (own - below * below) ** 0.5
        scales.append(scale)
        shares.append(below)
        below = -noise.pose / scale
    return scales, shares


def _whitened(column: Array, scales: list[float], shares: list[float]) -> list[float]:
    """Return L^-1 column."""
    white, before = [], 0.0
    for value, scale, share in zip(column.tolist(), scales, shares, strict=True):
        before = (value - share * before) / scale
        white.append(before)
    return white


def left_out(drive: RobotDrive, kept: NDArray[np.bool_], residuals: Sequence[Array]) -> NDArray[np.bool_]:
    """Return ``kept`` (M,) without the poses whose increments' residuals show them to be outliers.

    Raises:
        CalibrationError: there are too many.
    """
    fewer = kept.copy()
    fewer[np.flatnonzero(kept)[_spikes(residuals)]] = False
    if (~fewer).mean() > _OUTLIER_SHARE:
        raise CalibrationError(
            f"{drive.robot}: {100 * (~fewer).mean():.0f} % of its poses do not fit any motion: did something else "
            "move it, or is its tag hard to see?"
        )
    return fewer


def _spikes(residuals: Sequence[Array]) -> NDArray[np.bool_]:
    """Return which of the poses (n + 1,) behind increments (n,) are outliers: there and back again in a channel."""
    out = np.zeros(len(residuals[0]) + 1, dtype=np.bool_)
    for e in residuals:
        spike = np.concatenate([[0.0, 0.0], np.abs(e[:-1] - e[1:]) / 2.0, [0.0, 0.0]])
        sigma = 1.4826 * float(np.median(spike))
        beside = np.maximum(spike[:-2], spike[2:])  # a pose that is wrong makes its neighbours look wrong too
        out |= (spike[1:-1] > _SPIKE_SIGMA * max(sigma, _ALMOST_NOTHING)) & (spike[1:-1] >= beside)
    return out

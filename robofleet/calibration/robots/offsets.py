"""Where the tag sits on its robot, and the wheels' true radius and base: from a drive, by linear least squares.

With q the tag's place in the tag's frame and h its heading on the robot, the tag moves between two poses by
(R' - R) q + s R'' f: R, R' are the tag's rotations, R'' the one half way, s is the wheels' mean angle, and
f = radius (cos h, -sin h).
Spins determine q, straights f. The two wheels are told apart by the turns that their angles explain, less what slips:
a fraction of the motion in proportion to the rate of turning.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.robots import latency
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.increments import (
    Increments,
    Solution,
    increments,
    lagging,
    left_out,
    refuse_unusable,
    solve,
)
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import TagOffset
from robofleet.core.arrays import Array
from robofleet.vehicles.differential_drive import DifferentialDrive

PARAMETERS = ("forward_m", "left_m", "heading_deg", "wheel_radius_m", "wheel_base_m")

_SMOOTHED_POSES = 15
_SMOOTHED_STATUSES = 25  # half a second
_OUTLIER_ROUNDS = 6
_IN_TIME_S = 2e-4
_LEAST_TURN = 1.5 * math.pi  # each way [rad]
_LEAST_WAY = 0.05  # [m]
_WORST_PLACE, _WORST_HEADING_DEG = 0.0005, 0.3  # sigma that is refused [m, deg]


@dataclass(frozen=True)
class Offsets:
    """What was found for one robot. ``covariance`` (5, 5): rows as PARAMETERS."""

    robot: str
    tag_offset: TagOffset
    wheel_radius_m: float
    wheel_base_m: float
    covariance: Array
    by_encoders: bool  # else by the commands
    left_out: int  # poses
    at_s: Array  # (n,) instants of the residuals
    residuals_mm: Array  # (n, 2) of the increments, along the world's x and y

    @property
    def values(self) -> Array:
        o = self.tag_offset
        return np.array([o.forward_m, o.left_m, o.heading_deg, self.wheel_radius_m, self.wheel_base_m])

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def find(drive: RobotDrive, believed: DifferentialDrive) -> Offsets:
    """Find a robot's offsets: by what its wheels were told, put right by its encoders where it has some.

    Raises:
        CalibrationError: the drive does not determine them.
    """
    refuse_unusable(drive)
    by_encoders = len(drive.encoders_s) > _SMOOTHED_STATUSES
    try:
        lag_s = latency.find(drive).motor_lag_s
    except CalibrationError:
        if not by_encoders:
            raise
        lag_s = believed.motor_lag  # what is wrong with it the encoders put right
    at_s, angles = drive.told_s, lagging(drive.told_s, drive.told_rad, lag_s)
    if by_encoders:
        at_s, angles = drive.encoders_s, _put_right(at_s, angles, drive.encoders_s, drive.encoders_rad)
    late_s = 0.0  # of their instants: what the bus takes at least, and what the robot does
    kept = np.ones(len(drive.poses_s), dtype=np.bool_)
    try:
        for _ in range(_OUTLIER_ROUNDS):
            wheels = _between(at_s, angles, drive.poses_s + late_s)
            fit = _Fit(drive, wheels, kept, believed)
            later_s, fewer = fit.late_s(wheels[kept]), left_out(drive, kept, fit.residuals)
            if abs(later_s) < _IN_TIME_S and (fewer == kept).all():
                break
            late_s, kept = late_s + later_s, fewer
        covariance = fit.covariance()
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"{drive.robot}: its wheels hardly turned: drive again") from error
    values = fit.values().tolist()
    found = Offsets(
        drive.robot, TagOffset(forward_m=values[0], left_m=values[1], heading_deg=values[2]), values[3], values[4],
        covariance, by_encoders, int((~kept).sum()), fit.inc.at_s, 1e3 * np.column_stack(fit.residuals[1:]),
    )  # fmt: skip
    _refuse(found, fit)
    return found


class _Fit:
    """One round of both stages: first the turns, then the shifts."""

    def __init__(self, drive: RobotDrive, wheels: Array, kept: NDArray[np.bool_], believed: DifferentialDrive) -> None:
        self._angles = np.diff(wheels[kept], axis=0)
        self._poses, measured = drive.poses[kept], np.unwrap(drive.poses[kept, 2])
        self.inc: Increments = increments(drive.poses_s[kept], self._poses)
        turn = believed.wheel_radius / believed.wheel_base * (self._angles[:, 1] - self._angles[:, 0])
        self._rate = np.abs(turn) / self.inc.duration_s
        sides = np.column_stack([-self._angles[:, 0], self._angles[:, 1], -self._rate * turn])
        self._turning = solve(sides[None], self.inc.turn[None], self.inc)
        reckoned = np.concatenate([[0.0], np.cumsum(sides @ self._turning.values)])
        self.heading = reckoned + _smoothed(measured - reckoned, _SMOOTHED_POSES)
        self._shifting = self._shifts(self._turning.values)

    def _shifts(self, per_side: Array) -> Solution:
        """Fit q and f in the world's frame with what the turns say of the left and right wheel, and of slip.

        A tag's heading is measured like its place; the way of its robot between two poses needs a steadier one.
        """
        turn, sides = np.diff(self.heading), per_side[:2] / per_side[:2].sum()
        forward = self._angles @ sides * (1.0 - per_side[2] * self._rate) * np.sinc(turn / math.tau)
        middle = (self.heading[1:] + self.heading[:-1]) / 2.0
        way = forward * np.cos(middle), forward * np.sin(middle)
        c, s = np.diff(np.cos(self._poses[:, 2])), np.diff(np.sin(self._poses[:, 2]))
        x, y = np.column_stack([c, -s, way[0], -way[1]]), np.column_stack([s, c, way[1], way[0]])
        return solve(np.array([x, y]), np.diff(self._poses[:, :2], axis=0).T, self.inc)

    @property
    def angle(self) -> float:
        """What the wheels turned forward or backward together [rad]."""
        return float(np.abs(self._angles.mean(axis=1)).sum())

    @property
    def residuals(self) -> tuple[Array, Array, Array]:
        """Of the turns, and of the shifts along the world's x and y."""
        x, y = self._shifting.residuals
        return self._turning.residuals[0], x, y

    def late_s(self, wheels: Array) -> float:
        """Return how much later the turns' residuals say that the wheels (M, 2) did what they did."""
        speeds = np.gradient(wheels, self.inc.duration_s.mean(), axis=0)
        change = np.diff(speeds, axis=0) @ (self._turning.values[:2] * (-1.0, 1.0))
        return float(solve(change[None, :, None], self._turning.residuals, self.inc).values[0])

    def values(self) -> Array:
        """Return what the parameters are."""
        return _physical(np.concatenate([self._turning.values, self._shifting.values]))

    def covariance(self) -> Array:
        """Covariance of the five: that of what was fitted, through the derivative of the way to the five."""
        spread = np.zeros((7, 7))
        spread[:3, :3], spread[3:, 3:] = self._turning.covariance, self._shifting.covariance
        fitted = np.concatenate([self._turning.values, self._shifting.values])
        derivative = np.empty((5, 7))
        for k, step in enumerate(np.sqrt(np.diag(spread))):
            moved = fitted + step * np.eye(7)[k]
            if k < 3:  # the shifts are fitted with it
                moved = np.concatenate([moved[:3], self._shifts(moved[:3]).values])
            derivative[:, k] = (_physical(moved) - _physical(fitted)) / step
        covariance = derivative @ spread @ derivative.T
        ahead = self._angles.mean(axis=1) ** 2  # where it drove, the tag's heading was measured so often
        covariance[2, 2] += np.rad2deg(1.0) ** 2 * self._turning.noise.pose * (ahead**2).sum() / ahead.sum() ** 2
        return np.asarray(covariance)


def _physical(fitted: Array) -> Array:
    """Return the five from the turns' and the shifts' parameters: left, right, slip; q, f."""
    left_turn, right_turn, _, q_x, q_y, f_x, f_y = fitted.tolist()
    h = math.atan2(-f_y, f_x)
    c, s = math.cos(h), math.sin(h)
    radius = math.hypot(f_x, f_y)
    base = 2 * radius / (left_turn + right_turn)
    return np.array([c * q_x - s * q_y, s * q_x + c * q_y, math.degrees(h), radius, base])


def _between(at_s: Array, angles: Array, asked_s: Array) -> Array:
    """Return the angles (M, 2) between samples (E, 2), by cubics: wheels speed up between two samples."""
    slopes = np.gradient(angles, at_s, axis=0)
    k = np.clip(np.searchsorted(at_s, asked_s, side="right") - 1, 0, len(at_s) - 2)
    step = np.diff(at_s)[k][:, None]
    u = np.clip((asked_s - at_s[k])[:, None] / step, 0.0, 1.0)
    rise = angles[k + 1] - angles[k]
    start, end = step * slopes[k] - rise, rise - step * slopes[k + 1]
    return np.asarray(angles[k] + u * rise + u * (1.0 - u) * ((1.0 - u) * start + u * end))


def _put_right(told_s: Array, expected: Array, at_s: Array, counted: Array) -> Array:
    """Return what was expected of the wheels with what encoders (E, 2) say slowly: half a second's mean.

    A robot is asked for its counts, or says them in its own time, so the newest are up to 30 ms old, now more, now
    less: taken as they are they would make every turn look smaller. First the mean of that age is found.
    """
    late_s = 0.0
    for _ in range(_OUTLIER_ROUNDS):
        model = _between(told_s, expected, at_s - late_s)
        speed, error = np.gradient(model, at_s, axis=0), counted - model
        quick, off = speed - _smoothed(speed, _SMOOTHED_STATUSES), error - _smoothed(error, _SMOOTHED_STATUSES)
        late_s -= float((off * quick).sum() / (quick * quick).sum())
    return model + _smoothed(error, _SMOOTHED_STATUSES)


def _smoothed(values: Array, width: int) -> Array:
    """Return the running mean of values (n, ...), which change slowly, while their noise does not."""
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    k = np.arange(len(values))
    before, after = np.maximum(k - width // 2, 0), np.minimum(k + width // 2 + 1, len(values))
    return np.asarray(((sums[after] - sums[before]).T / (after - before)).T)


def _refuse(found: Offsets, fit: _Fit) -> None:
    robot, sigma = found.robot, found.sigma
    turn, forward = np.diff(fit.heading), fit.angle * found.wheel_radius_m
    ways = float(turn[turn > 0].sum()), -float(turn[turn < 0].sum())
    if min(ways) < _LEAST_TURN:
        raise CalibrationError(
            f"{robot}: it turned {math.degrees(ways[0]):.0f} deg to the left and {math.degrees(ways[1]):.0f} to the "
            f"right, {math.degrees(_LEAST_TURN):.0f} each way are needed to place its tag: let it spin both ways"
        )
    if forward < _LEAST_WAY:
        raise CalibrationError(
            f"{robot}: it drove {100 * forward:.1f} cm straight, {100 * _LEAST_WAY:.0f} are needed for its tag's "
            "heading: give it room"
        )
    if max(sigma[:2]) > _WORST_PLACE or sigma[2] > _WORST_HEADING_DEG:
        raise CalibrationError(
            f"{robot}: its tag is placed to {1e3 * max(sigma[:2]):.2f} mm and {sigma[2]:.2f} deg only, "
            f"{1e3 * _WORST_PLACE:.1f} and {_WORST_HEADING_DEG:.1f} are allowed: longer drives, or a better camera"
        )

"""Multiple shooting: what a robot's model makes of the commands, from pose to pose, against the poses as measured.

The model is the plant of ``vehicles/plant.py`` itself, without its random parts. A recording is cut into shots of some
seconds, each of which begins at a pose of its own: what adds up in reality and not in the model stays within a shot.
In a shot a Kalman filter carries the pose along, so that each residual is the part of a measured pose that nothing
before it explains: of independent noise of variance 1, where the model, the poses' covariances and the wander are
right. The wander is what adds to the way of each wheel: by slip, as in the plant, and with the way itself.
"""

import math
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from robofleet.calibration.robots import inputs
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.encoders import Encoders
from robofleet.core.arrays import Array, Flags
from robofleet.core.clock import S
from robofleet.core.kernels import kernel
from robofleet.simulation.bodies import BODY, BUILD, COMING, advance, command
from robofleet.vehicles import plant

SHOT_S = 2.0

_NOBODY, _NO_ESTIMATES = np.zeros(0, dtype=np.bool_), np.empty((0, 3))
_WRONG_BEGINNINGS, _WRONG_SHARE = 3, 0.5
_LONGEST_OUTLIER = 3  # poses
_UNKNOWN_POSE = np.array([3e-4**2, 0.0, 3e-4**2, 0.0, 0.0, 0.004**2])  # covariance of poses that have none
_LEAST_VARIANCE = np.array([1e-6**2, 1e-6**2, 1e-5**2])  # of a simulated pose without noise [m^2, m^2, rad^2]
_QUIET = np.zeros(8192)  # the plant's random numbers: none
_LONGEST_STEP_NS = S
_UNMOVED = dict.fromkeys(("tag_forward_m", "tag_left_m", "tag_heading_rad", "left_encoder", "right_encoder"), 0.0)


@dataclass(frozen=True, kw_only=True)
class Wheels:
    """A robot's model: what can be told from its commands and poses. Units as in the names."""

    left_radius_m: float
    right_radius_m: float
    wheel_base_m: float
    motor_lag_s: float
    stop_lag_s: float  # of a wheel that is commanded to stand
    delay_s: float  # from a tick to the wheels
    deadband_rad_s: float
    breakaway_rad_s: float
    top_speed_rad_s: float
    top_speed_sag: float
    slip_s_per_rad: float
    tag_forward_m: float
    tag_left_m: float
    tag_heading_rad: float
    left_encoder: float  # what is counted of a wheel's angle
    right_encoder: float
    encoder_offset_s: float  # how much later than its stamp an angle was counted


@dataclass(frozen=True)
class Noise:
    """Scales of the poses' noise against their covariances, and the wander of each wheel's way."""

    position: float = 1.0
    heading: float = 1.0
    slip: float = 1e-5  # standard deviation of a way of 1 m at 1 rad/s, for 1 s [m s^0.5]
    way: float = 1e-4  # standard deviation of a way of 1 m [m^0.5]
    stamp_s: float = 1e-4  # standard deviation of an encoder's time stamp
    wander: float = 1e-3  # standard deviation of a wheel's angle against its command, after 1 rad [rad^0.5]


class Motion(NamedTuple):
    """What a model makes of the commands."""

    steps: Array  # (M - 1, 3) from each pose to the next in the frame of the former [m, m, rad]
    angles: Array  # (E, 2) of the wheels when the encoders were read [rad]


class Shots:
    """One recording of one robot, cut into shots."""

    def __init__(self, drive: RobotDrive, *, loop_period_s: float, battery_life_s: float) -> None:
        self.drive = drive
        self._life_s = battery_life_s
        self._loop_ns = round(loop_period_s * S)
        outputs_s, self._outputs = inputs.as_told(drive, *inputs.through_gate(drive))
        self._outputs_ns = np.round(outputs_s * S).astype(np.int64)
        self.at_s, self.poses = drive.poses_s, drive.poses
        self._poses_ns = np.round(self.at_s * S).astype(np.int64)
        covariances = (
            drive.pose_covariances if len(drive.pose_covariances) else np.tile(_UNKNOWN_POSE, (len(self.at_s), 1))
        )
        self._covariances = covariances[:, [0, 1, 3, 1, 2, 4, 3, 4, 5]].reshape(-1, 3, 3)
        self.shot = ((self.at_s - self.at_s[0]) / SHOT_S).astype(np.int64)
        self._begins = np.diff(self.shot, prepend=-1) > 0
        self.kept = np.ones(len(self.at_s), dtype=np.bool_)  # poses that are no outliers
        counted = np.floor((drive.encoders_s - self.at_s[0]) / SHOT_S).astype(np.int64)
        self.encoders = Encoders(drive.encoders_s, drive.encoders_rad, counted)
        self._newest: tuple[Wheels, Motion] | None = None  # a derivative by what moves nothing needs it again

    @cached_property
    def used_s(self) -> float:
        """How long the battery had been used when the recording began, as it told then."""
        return (1.0 - float(self.drive.battery[0])) * self._life_s if len(self.drive.battery) else 0.0

    def near_s(self, speed_rad_s: float, within_rad_s: float) -> float:
        """Return how long wheels were commanded to turn about so fast, either way [s]."""
        speeds = np.abs(self._outputs[:-1])
        near = (speeds > 0.0) & (np.abs(speeds - speed_rad_s) < within_rad_s)
        return float((near * (np.diff(self._outputs_ns) / S)[:, None]).sum())

    def motion(self, wheels: Wheels) -> Motion:
        """Return the model's motion."""
        moving = replace(wheels, **_UNMOVED)
        if self._newest is None or self._newest[0] != moving:
            self._newest = moving, self._simulated(moving)
        return self._newest[1]

    def _simulated(self, w: Wheels) -> Motion:
        radius = (w.left_radius_m + w.right_radius_m) / 2.0
        build = plant.Build(
            wheel_radius=radius, wheel_base=w.wheel_base_m, max_wheel_speed=w.top_speed_rad_s,
            motor_lag=w.motor_lag_s, stop_lag=w.stop_lag_s,
            speed_quantum=0.0, loop_period=self._loop_ns / S, deadband=w.deadband_rad_s,
            breakaway=max(w.deadband_rad_s, w.breakaway_rad_s), slip=w.slip_s_per_rad, slip_noise=0.0,
            top_speed_sag=w.top_speed_sag, battery_life=self._life_s, left_gain=w.left_radius_m / radius,
            right_gain=w.right_radius_m / radius, left_sign=1.0, right_sign=1.0, swapped=False,
            longest_step_ns=self._loop_ns, delay_ns=0,
        )  # fmt: skip
        acts_ns = self._outputs_ns + round(w.delay_s * S)
        counted_ns = np.round((self.encoders.at_s + w.encoder_offset_s) * S).astype(np.int64)
        begin_ns = int(min(acts_ns[0], self._poses_ns[0], *counted_ns[:1])) - 1
        body = replace(plant.placed((0.0, 0.0, 0.0), begin_ns), used=self.used_s)
        poses, angles = np.empty((len(self._poses_ns), 3)), np.empty((len(counted_ns), 2))
        _follow(
            np.array([astuple(body)], BODY), np.array([astuple(build)], BUILD),
            np.zeros((1, plant.capacity(0)), COMING), _QUIET, acts_ns, self._outputs, self._poses_ns, poses,
            counted_ns, angles,
        )  # fmt: skip
        return Motion(relative(poses[:-1], poses[1:]), angles)

    def residuals(self, wheels: Wheels, noise: Noise, motion: Motion, chosen: Flags) -> tuple[Array, float]:
        """Return the whitened residuals (M, 3) of the poses of ``chosen`` shots, 0 where there is none, and their
        log-determinant: that of the covariances by which they were whitened.
        """
        return self._filtered(wheels, noise, motion, self._begins, chosen & self.kept, chosen)

    def _filtered(
        self, wheels: Wheels, noise: Noise, motion: Motion, begins: Flags, kept: Flags, chosen: Flags, *,
        estimates: Array = _NO_ESTIMATES, gate: float = np.inf, outliers: Flags = _NOBODY,
    ) -> tuple[Array, float]:  # fmt: skip
        """Return residuals and log-determinant as ``residuals``; the rest as ``_filter`` takes it."""
        residuals = np.zeros((len(self.at_s), 3))
        log_determinant = _filter(
            motion.steps, np.diff(self.at_s), self.poses, self._noise_covariances(noise), _offset(wheels),
            wheels.wheel_base_m, noise.slip, noise.way, begins, kept, chosen, residuals, estimates, gate, outliers,
        )  # fmt: skip
        return residuals, float(log_determinant)

    def encoder_residuals(self, wheels: Wheels, noise: Noise, motion: Motion, chosen: Flags) -> tuple[Array, float]:
        """Return the whitened residuals (E, 2) of the ``chosen`` angles of the encoders (E,), and the like."""
        return self.encoders.residuals(motion.angles, _scales(wheels), noise.stamp_s, noise.wander, chosen)

    def all_residuals(self, wheels: Wheels, noise: Noise, seen: Flags, counted: Flags) -> Array:
        """Return the whitened residuals (3 M + 2 E,) of poses that are ``seen`` (M,) and angles ``counted`` (E,)."""
        motion = self.motion(wheels)
        poses, _ = self.residuals(wheels, noise, motion, seen)
        angles, _ = self.encoder_residuals(wheels, noise, motion, counted)
        return np.concatenate([poses.ravel(), angles.ravel()])

    def encoder_outliers(self, wheels: Wheels, noise: Noise, gate: float) -> Flags:
        """Return which angles of the encoders (E, 2) are further than so many standard deviations off."""
        return self.encoders.outliers(self.motion(wheels).angles, _scales(wheels), noise.stamp_s, noise.wander, gate)

    def outliers(self, wheels: Wheels, noise: Noise, gate: float, *, misfits: bool) -> Flags:
        """Return which poses (M,) are further than so many standard deviations from where the others put the robot.

        Where a shot begins with one, all others would be: it is the first one then. ``misfits``: with those of which
        many follow each other: they are no noise, but the model is wrong there.
        """
        motion, everything = self.motion(wheels), np.ones(len(self.at_s), dtype=np.bool_)
        found, beginnings = ~everything, ~everything
        for _ in range(_WRONG_BEGINNINGS):
            found[:] = False
            self._filtered(wheels, noise, motion, self._begins, ~beginnings, everything, gate=gate, outliers=found)
            share = np.bincount(self.shot, found) / np.maximum(1, np.bincount(self.shot, ~beginnings))
            wrong = np.flatnonzero(share > _WRONG_SHARE)
            if not len(wrong):
                break
            for shot in wrong.tolist():
                beginnings[np.flatnonzero((self.shot == shot) & ~beginnings)[:1]] = True
        found |= beginnings
        change = np.flatnonzero(np.diff(found, prepend=False, append=False))
        for start, end in change.reshape(-1, 2).tolist():
            if end - start > _LONGEST_OUTLIER and not misfits:
                found[start:end] = False
        return found

    def ahead(self, wheels: Wheels, noise: Noise, horizon_s: float) -> tuple[Array, Array, Array]:
        """Return open-loop predictions: instants (P,) [s], predicted and measured poses (P, 3) of the tag.

        Each starts at what the filter knows so far, and ends ``horizon_s`` later, with the commands alone.
        """
        motion, everything = self.motion(wheels), np.ones(len(self.at_s), dtype=np.bool_)
        begins = np.diff(self.at_s, prepend=-np.inf) > SHOT_S
        estimates = np.empty((len(self.at_s), 3))
        self._filtered(wheels, noise, motion, begins, self.kept, everything, estimates=estimates)
        ends = np.searchsorted(self.at_s, self.at_s + horizon_s - self._half_interval_s)
        start = np.flatnonzero((ends < len(self.at_s)) & (self.at_s > self.at_s[0] + SHOT_S / 2.0))
        start = start[self.kept[ends[start]]]
        path = accumulated(motion.steps)
        step = relative(path[start], path[ends[start]])
        return self.at_s[start], compose(compose(estimates[start], step), _offset(wheels)), self.poses[ends[start]]

    def pose_noise(self, noise: Noise) -> tuple[float, float]:
        """Return the standard deviation of a pose's position [mm] and of its heading [deg], as the fit takes them."""
        x, y, heading = np.sqrt(np.diagonal(self._noise_covariances(noise), axis1=1, axis2=2).mean(axis=0)).tolist()
        return 1e3 * math.sqrt((x * x + y * y) / 2.0), math.degrees(heading)

    @cached_property
    def _half_interval_s(self) -> float:
        return float(np.median(np.diff(self.at_s))) / 2.0

    def _noise_covariances(self, noise: Noise) -> Array:
        scale = np.array([noise.position, noise.position, noise.heading])
        return np.asarray(self._covariances * scale[:, None] * scale + np.diag(_LEAST_VARIANCE))


def _offset(wheels: Wheels) -> Array:
    return np.array([wheels.tag_forward_m, wheels.tag_left_m, wheels.tag_heading_rad])


def _scales(wheels: Wheels) -> Array:
    return np.array([wheels.left_encoder, wheels.right_encoder])


def relative(start: Array, end: Array) -> Array:
    """Return poses (n, 3) in the frames of others (n, 3)."""
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    x, y = (end - start)[:, :2].T
    poses: Array = np.column_stack([c * x + s * y, c * y - s * x, wrapped(end[:, 2] - start[:, 2])])
    return poses


def compose(start: Array, step: Array) -> Array:
    """Return poses (n, 3) that are given in the frames of others (n, 3); ``step`` may be one for all (3,)."""
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    x, y, psi = np.broadcast_to(step, start.shape).T
    return np.column_stack([start[:, 0] + c * x - s * y, start[:, 1] + s * x + c * y, wrapped(start[:, 2] + psi)])


def accumulated(motion: Array) -> Array:
    """Return the path (M, 3) of motions (M - 1, 3), from the origin on."""
    heading = np.concatenate([[0.0], np.cumsum(motion[:, 2])])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x, y = motion[:, 0], motion[:, 1]
    return np.column_stack(
        [*(np.concatenate([[0.0], np.cumsum(way)]) for way in (c * x - s * y, s * x + c * y)), heading]
    )


def wrapped(angle: Array) -> Array:
    """Return angles within half a turn [rad]."""
    return np.asarray(angle - math.tau * np.round(angle / math.tau))


@kernel
def _follow(bodies, builds, coming, noise, at_ns, outputs, poses_ns, poses, counted_ns, angles):  # type: ignore[no-untyped-def]
    """Let a robot follow outputs (K, 2) that begin to act at instants (K,); fill in where it is, and its wheels' angles
    at others (M,), (E,).
    """
    b, p, waiting = bodies[0], builds[0], coming[0]
    k = row = count = 0
    while row < len(poses_ns) or count < len(counted_ns):
        is_pose = count == len(counted_ns) or (row < len(poses_ns) and poses_ns[row] <= counted_ns[count])
        until_ns = poses_ns[row] if is_pose else counted_ns[count]
        while k < len(at_ns) and at_ns[k] <= until_ns:
            _pass_until(b, p, waiting, noise, at_ns[k])
            command(b, p, waiting, outputs[k, 0], outputs[k, 1], plant.NEVER_NS)
            k += 1
        _pass_until(b, p, waiting, noise, until_ns)
        if is_pose:
            poses[row, 0], poses[row, 1], poses[row, 2] = b.x, b.y, b.psi
            row += 1
        else:
            angles[count, 0], angles[count, 1] = b.left_angle, b.right_angle
            count += 1


@kernel
def _pass_until(b, p, coming, noise, until_ns):  # type: ignore[no-untyped-def]
    while b.reached_ns < until_ns:
        b.drawn = 0
        advance(b, p, coming, noise, min(until_ns, b.reached_ns + _LONGEST_STEP_NS))


@kernel
def _filter(  # type: ignore[no-untyped-def]  # noqa: PLR0912, PLR0915
    motion,
    duration,
    measured,
    weights,
    offset,
    base,
    slip,
    way,
    first,
    kept,
    chosen,
    residuals,
    estimates,
    gate,
    outliers,
):
    """Carry the pose of a robot's centre along its motion, and correct it by the tag's poses where they are ``kept``.

    At ``first`` it begins anew. Fill in whitened residuals of those that are ``chosen`` and kept; and, where there is
    room for them, the estimates, and which are outliers: further off than ``gate``, they correct nothing. Return half
    the log-determinant of the residuals' covariances.
    """
    forward, left, turned = offset
    x = y = psi = total = 0.0
    P, S, moved, K = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    known = False
    for k in range(len(measured)):
        if first[k]:
            known = False
        elif known:
            dx, dy, dpsi = motion[k - 1]
            h = max(duration[k - 1], 1e-9)
            left_way, right_way = abs(dx - dpsi * base / 2.0), abs(dx + dpsi * base / 2.0)
            left_variance = (slip * dpsi / h * left_way) ** 2 / h + way * way * left_way + 1e-16
            right_variance = (slip * dpsi / h * right_way) ** 2 / h + way * way * right_way + 1e-16
            c, s = math.cos(psi), math.sin(psi)
            a, b = -s * dx - c * dy, c * dx - s * dy
            _turned(P, a, b, moved)
            along = math.cos(psi + dpsi / 2.0), math.sin(psi + dpsi / 2.0), 0.0
            turn = a / 2.0, b / 2.0, 1.0
            for i in range(3):
                of_left, of_right = along[i] / 2.0 - turn[i] / base, along[i] / 2.0 + turn[i] / base
                for j in range(3):
                    P[i, j] = (
                        moved[i, j]
                        + left_variance * of_left * (along[j] / 2.0 - turn[j] / base)
                        + right_variance * of_right * (along[j] / 2.0 + turn[j] / base)
                    )
            x, y, psi = x + c * dx - s * dy, y + s * dx + c * dy, psi + dpsi
        if kept[k] and not known:
            known = True
            psi = measured[k, 2] - turned
            c, s = math.cos(psi), math.sin(psi)
            arm_x, arm_y = c * forward - s * left, s * forward + c * left
            x, y = measured[k, 0] - arm_x, measured[k, 1] - arm_y
            _turned(weights[k], arm_y, -arm_x, P)
        elif kept[k]:
            c, s = math.cos(psi), math.sin(psi)
            arm_x, arm_y = c * forward - s * left, s * forward + c * left
            _turned(P, -arm_y, arm_x, S)
            S += weights[k]
            e0, e1 = measured[k, 0] - x - arm_x, measured[k, 1] - y - arm_y
            e2 = measured[k, 2] - psi - turned
            e2 -= math.tau * math.floor(e2 / math.tau + 0.5)
            l00 = math.sqrt(S[0, 0])
            l10, l20 = S[1, 0] / l00, S[2, 0] / l00
            l11 = math.sqrt(S[1, 1] - l10 * l10)
            l21 = (S[2, 1] - l20 * l10) / l11
            l22 = math.sqrt(S[2, 2] - l20 * l20 - l21 * l21)
            w0 = e0 / l00
            w1 = (e1 - l10 * w0) / l11
            w2 = (e2 - l20 * w0 - l21 * w1) / l22
            if len(outliers) and w0 * w0 + w1 * w1 + w2 * w2 > gate * gate:
                outliers[k] = True
                continue
            if chosen[k]:
                residuals[k, 0], residuals[k, 1], residuals[k, 2] = w0, w1, w2
                total += math.log(l00 * l11 * l22)
            for i in range(3):  # K = P H' L'^-1: the gain for the whitened residuals
                K[i, 0] = (P[i, 0] - arm_y * P[i, 2]) / l00
                K[i, 1] = (P[i, 1] + arm_x * P[i, 2] - l10 * K[i, 0]) / l11
                K[i, 2] = (P[i, 2] - l20 * K[i, 0] - l21 * K[i, 1]) / l22
            x += K[0, 0] * w0 + K[0, 1] * w1 + K[0, 2] * w2
            y += K[1, 0] * w0 + K[1, 1] * w1 + K[1, 2] * w2
            psi += K[2, 0] * w0 + K[2, 1] * w1 + K[2, 2] * w2
            for i in range(3):
                for j in range(3):
                    P[i, j] -= K[i, 0] * K[j, 0] + K[i, 1] * K[j, 1] + K[i, 2] * K[j, 2]
        if len(estimates):
            estimates[k, 0], estimates[k, 1], estimates[k, 2] = x, y, psi
    return total


@kernel
def _turned(P, a, b, result):  # type: ignore[no-untyped-def]
    """Fill in J P J' of a covariance (3, 3), where J is 1 but for a and b: by how much a heading moves x and y."""
    p02, p12, p22 = P[0, 2], P[1, 2], P[2, 2]
    result[0, 0] = P[0, 0] + 2.0 * a * p02 + a * a * p22
    result[0, 1] = result[1, 0] = P[0, 1] + a * p12 + b * p02 + a * b * p22
    result[1, 1] = P[1, 1] + 2.0 * b * p12 + b * b * p22
    result[0, 2] = result[2, 0] = p02 + a * p22
    result[1, 2] = result[2, 1] = p12 + b * p22
    result[2, 2] = p22

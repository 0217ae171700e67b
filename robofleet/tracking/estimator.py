"""Where every robot is when its next command acts: a filter of a pose and two wheel efficiencies a robot.

Between images the pose moves along the arcs of the wheel speeds that were commanded, behind a dead time (in the
commands' instants) and a first-order motor lag; an image's pose corrects it at the image's own mid-exposure. The
prediction for the future is the same motion continued with the commands that are under way.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

UNUSED, USED, CARRIED = 0, 1, 2

_HISTORY = 64  # commands
_LONGEST_STEP_NS = 17_000_000
_MOST_EFFICIENT = 2.0
_CARRIED_AFTER = 5  # outliers in a row that agree with each other

_arc = kernel(differential_drive.arc)
_body_from_wheels = kernel(differential_drive.body_from_wheels)


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations: of a measurement, and of the prediction after one second.

    ``efficiency``: of a wheel's true travel over the believed one, in the long run; 0 takes every wheel as believed.
    It is forgotten with the time constant ``efficiency_time`` [s].
    """

    position: float  # [m]
    heading: float  # [rad]
    position_drift: float  # [m/sqrt(s)]
    heading_drift: float  # [rad/sqrt(s)]
    gate_sigma: float  # Mahalanobis distance of an outlier
    efficiency: float = 0.0
    efficiency_time: float = 1.0


class FleetFilter:
    """Poses (N, 3): x, y [m], psi [rad] of the robots' centres in the world frame, and their wheels' efficiencies."""

    def __init__(self, drives: tuple[DifferentialDrive, ...], noise: FilterNoise) -> None:
        n = len(drives)
        self._motion = np.array([(d.wheel_radius, d.wheel_base, d.motor_lag) for d in drives])
        self._variance = np.array([noise.position, noise.position, noise.heading]) ** 2
        self._drift = np.array([noise.position_drift, noise.position_drift, noise.heading_drift]) ** 2
        self._wander = np.array([noise.efficiency**2, noise.efficiency_time])
        self._gate = noise.gate_sigma**2
        self._state = np.zeros((n, 5))  # x, y, psi, efficiency of the left and of the right wheel
        self._state[:, 3:] = 1.0
        self._covariance = np.zeros((n, 5, 5))
        self._wheels = np.zeros((n, 2))  # as modelled, at the filter's instant [rad/s]
        self._instant_ns = 0
        self._act_ns = np.zeros(_HISTORY, dtype=np.int64)
        self._commands = np.zeros((_HISTORY, n, 2))
        self._moved = np.zeros((n, 3))  # as modelled, since the newest measurement used
        self._outliers = np.zeros(n, dtype=np.int64)
        self._outlier_pose = np.full((n, 3), np.nan)
        self.measured_ns = np.zeros(n, dtype=np.int64)  # newest measurement used; 0: never seen

    def command(self, act_ns: int, wheels: Array) -> None:
        """Remember commands (N, 2) [rad/s] that act from ``act_ns`` on."""
        self._act_ns[:-1] = self._act_ns[1:]
        self._commands[:-1] = self._commands[1:]
        self._act_ns[-1] = act_ns
        self._commands[-1] = wheels

    def observe(self, exposure_ns: int, poses: Array) -> NDArray[np.int64]:
        """Use an image taken at ``exposure_ns``: ``poses`` (N, 3), NaN where a robot was not seen.

        Returns for each robot UNUSED, USED, or CARRIED (used, and the filter started anew). An image older than the
        newest one is not used.
        """
        used = np.zeros(len(poses), dtype=np.int64)
        if self._instant_ns == 0:
            self._instant_ns = exposure_ns - 1
        if exposure_ns > self._instant_ns:
            _observe(
                self._state, self._covariance, self._wheels, self._instant_ns, exposure_ns, self._act_ns,
                self._commands, self._motion, self._drift, self._wander, self._variance, self._gate, poses,
                self._moved, self._outliers, self._outlier_pose, self.measured_ns, used,
            )  # fmt: skip
            self._instant_ns = exposure_ns
        return used

    def predict(self, first_ns: int, second_ns: int) -> tuple[Array, Array]:
        """Return the poses (N, 3) at two instants after the newest image, by the commands that act until then."""
        first, wheels = self._state.copy(), self._wheels.copy()
        if self._instant_ns == 0:  # no image yet: nothing to move, and the clock's zero may be weeks ago
            return first[:, :3].copy(), first[:, :3].copy()  # contiguous, as ever: another layout is another kernel
        travel, then_ns = np.zeros_like(wheels), max(self._instant_ns, first_ns)
        _advance(first, wheels, travel, self._instant_ns, first_ns, self._act_ns, self._commands, self._motion)
        second = first.copy()
        _advance(second, wheels, travel, then_ns, second_ns, self._act_ns, self._commands, self._motion)
        return first[:, :3].copy(), second[:, :3].copy()

    def disturbance(self, poses: Array, point_ahead: float) -> Array:
        """Return w (N, 2): the velocity of the points p that the newest commands do not explain [m/s; world]."""
        return _disturbance(self._state, self._commands[-1], self._motion, poses, point_ahead)


@kernel
def _advance(
    state: Array, wheels: Array, travel: Array, start_ns: int, end_ns: int,
    act_ns: Instants, commands: Array, motion: Array,
) -> None:  # fmt: skip
    """Move poses and modelled wheel speeds from one instant to a later one, command by command.

    The wheels' believed ``travel`` (N, 2) [m] is added up.
    """
    now = start_ns
    newest = -1  # command in force at the start; -1: none, the wheels are asked to rest
    for k in range(len(act_ns)):
        if act_ns[k] <= now:
            newest = k
    while now < end_ns:
        until = min(end_ns, now + _LONGEST_STEP_NS)
        if newest + 1 < len(act_ns):
            until = min(until, max(act_ns[newest + 1], now))
        duration = (until - now) * 1e-9
        for i in range(len(state)):
            radius, base, lag = motion[i]
            left_command = commands[newest, i, 0] if newest >= 0 else 0.0
            right_command = commands[newest, i, 1] if newest >= 0 else 0.0
            left, wheels[i, 0] = _lagged(wheels[i, 0], left_command, lag, duration)
            right, wheels[i, 1] = _lagged(wheels[i, 1], right_command, lag, duration)
            travel[i, 0] += radius * left * duration
            travel[i, 1] += radius * right * duration
            v, omega = _body_from_wheels(state[i, 3] * left, state[i, 4] * right, radius, base)
            state[i, :3] = _arc(state[i, 0], state[i, 1], state[i, 2], v, omega, duration)
        now = until
        if newest + 1 < len(act_ns) and act_ns[newest + 1] <= now:
            newest += 1


@kernel
def _disturbance(state: Array, commands: Array, motion: Array, poses: Array, point_ahead: float) -> Array:
    w = np.empty((len(state), 2))
    for i in range(len(state)):
        missing_left, missing_right = (state[i, 3] - 1.0) * commands[i, 0], (state[i, 4] - 1.0) * commands[i, 1]
        v, omega = _body_from_wheels(missing_left, missing_right, motion[i, 0], motion[i, 1])
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        w[i, 0] = c * v - s * point_ahead * omega
        w[i, 1] = s * v + c * point_ahead * omega
    return w


@kernel
def _lagged(speed: float, command: float, lag: float, duration: float) -> tuple[float, float]:
    """Return the mean speed over ``duration`` and the speed at its end, for a first-order lag."""
    if lag == 0.0 or duration == 0.0:
        return command, command if duration > 0.0 else speed
    decay = np.exp(-duration / lag)
    ahead = speed - command
    return command + ahead * (1.0 - decay) * lag / duration, command + ahead * decay


@kernel
def _observe(
    state: Array, covariance: Array, wheels: Array, start_ns: int, exposure_ns: int, act_ns: Instants,
    commands: Array, motion: Array, drift: Array, wander: Array, variance: Array, gate: float, measured: Array,
    moved: Array, outliers: Instants, outlier_pose: Array, measured_ns: Instants, used: Instants,
) -> None:  # fmt: skip
    before, travel = state.copy(), np.zeros_like(wheels)
    _advance(state, wheels, travel, start_ns, exposure_ns, act_ns, commands, motion)
    duration = (exposure_ns - start_ns) * 1e-9
    for i in range(len(state)):
        x, p = state[i], covariance[i]
        step = x[:3] - before[i, :3]
        step[2] = _wrapped(step[2])
        _predict_covariance(x, p, step, travel[i], motion[i, 1], duration, drift, wander)
        moved[i] += step
        if np.isnan(measured[i, 0]):
            continue
        innovation = measured[i] - x[:3]
        innovation[2] = _wrapped(innovation[2])
        known = measured_ns[i] > 0
        if known and (
            _correct(x, p, p, innovation, variance, gate)
            or _correct(x, p, _held_up(p, moved[i]), innovation, variance, gate)
        ):
            outliers[i] = 0
            used[i] = USED
        else:
            away = np.abs(measured[i] - outlier_pose[i])
            agrees = away[0] < 0.03 and away[1] < 0.03 and abs(_wrapped(away[2])) < 0.3
            outliers[i] = outliers[i] + 1 if agrees else 1
            outlier_pose[i] = measured[i]
            if known and outliers[i] < _CARRIED_AFTER:
                continue
            _start_anew(x, p, measured[i], variance, wander)
            outliers[i] = 0
            used[i] = CARRIED
        x[2] = _wrapped(x[2])
        measured_ns[i] = exposure_ns
        moved[i] = 0.0


@kernel
def _start_anew(x: Array, p: Array, measured: Array, variance: Array, wander: Array) -> None:
    x[:3] = measured
    p[:] = 0.0
    for k in range(3):
        p[k, k] = variance[k]
    for k in range(3, 5):
        x[k] = 1.0
        p[k, k] = wander[0]


@kernel
def _predict_covariance(
    x: Array, p: Array, moved: Array, travel: Array, base: float, duration: float, drift: Array, wander: Array
) -> None:
    """P <- F P F' + Q, F the derivative of the motion: a wrong heading turns the way that was covered, a wrong
    efficiency lengthens one wheel's part of it. Efficiencies forget towards 1.
    """
    heading = x[2] - moved[2] / 2.0
    kept = np.exp(-duration / wander[1])
    f = np.eye(5)
    f[0, 2], f[1, 2] = -moved[1], moved[0]
    for side in range(2):
        k = 3 + side
        f[0, k], f[1, k] = travel[side] / 2.0 * np.cos(heading), travel[side] / 2.0 * np.sin(heading)
        f[2, k] = travel[side] / base * (1.0 if side == 1 else -1.0)
        f[k, k] = kept
        x[k] = 1.0 + (x[k] - 1.0) * kept
    p[:] = _product(f, _product(f, p).T)
    for k in range(3):
        p[k, k] += drift[k] * duration
    for k in range(3, 5):
        p[k, k] += wander[0] * (1.0 - kept * kept)


@kernel
def _product(a: Array, b: Array) -> Array:
    """a b for small square matrices: numba's own needs scipy."""
    n = len(a)
    result = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            if a[i, k] != 0.0:
                for j in range(n):
                    result[i, j] += a[i, k] * b[k, j]
    return result


@kernel
def _held_up(p: Array, moved: Array) -> Array:
    """The covariance of a robot that may have done all, none or twice of the motion since it was seen last.

    Blocked motors and spinning wheels are no outliers: without this a robot that is held up would be refused for
    several images, and believed to drive on.
    """
    wide = p.copy()
    for i in range(3):
        for j in range(3):
            wide[i, j] += moved[i] * moved[j]
    return wide


@kernel
def _correct(x: Array, p: Array, prior: Array, innovation: Array, variance: Array, gate: float) -> bool:
    """Correct state and covariance ``p``, with ``prior`` in its place, unless the innovation is beyond the gate.

    The three coordinates are independent measurements: they correct one after the other.
    """
    n = len(x)
    change, gain, trial = np.zeros(n), np.empty(n), prior.copy()
    distance = 0.0
    for k in range(3):
        s = trial[k, k] + variance[k]
        residual = innovation[k] - change[k]
        distance += residual * residual / s
        for i in range(n):
            gain[i] = trial[i, k] / s
            change[i] += gain[i] * residual
        for j in range(n):
            shared = trial[k, j]
            for i in range(n):
                trial[i, j] -= gain[i] * shared
    if distance > gate:
        return False
    for i in range(n):
        x[i] += change[i]
    for k in range(3, n):
        x[k] = min(max(x[k], 0.0), _MOST_EFFICIENT)
    p[:] = trial
    return True


@kernel
def _wrapped(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))

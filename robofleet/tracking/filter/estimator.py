"""Where every robot is when its next command acts: an extended Kalman filter of a pose and two
wheel efficiencies a robot.

Between images the pose moves by dead reckoning with the commands that were given; a measured pose corrects it at its
own mid-exposure, which a rolling shutter makes another one for every robot of an image. The prediction for the future
is the same motion continued with the commands that are under way.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.config.controller import FilterSettings
from robofleet.core.arrays import Array, Instants
from robofleet.core.kernels import kernel
from robofleet.tracking.filter import reckoning
from robofleet.tracking.filter.correction import (
    copy,
    correct,
    covariance_of,
    held_up,
    predict_covariance,
    start_anew,
    whitening,
    wrapped,
)
from robofleet.tracking.filter.reckoning import advance
from robofleet.vehicles.differential_drive import DifferentialDrive

FilterState = tuple[NDArray[Any], ...]

UNUSED, USED, CARRIED = 0, 1, 2  # CARRIED: a kidnapped robot, which somebody carried away

COLUMNS = 9  # of a measurement: x, y [m], psi [rad] and their covariance
_TAG_NUMBERS = 1 << 16  # of a message
_NOBODY = -1
_COMMANDS = 64
_KNOWN_S = 0.5  # since a robot was measured: an older expectation says nothing
_VELOCITY_TIME_S = 0.1  # time constant of a bystander's velocity: noise of 0.4 mm then makes 4 mm/s
_CARRIED_AFTER = 5  # outliers in a row that agree with each other


class FleetFilter:
    """Poses (N, 3): x, y [m], psi [rad] of the robots' centres in the world frame, and their wheels' efficiencies.

    ``delays_ns`` (N,): from a tick to the moment when each robot's command of that tick acts. ``noise``: of a
    measurement that does not tell its own; with ``efficiency_sigma`` 0 every wheel travels as believed.
    """

    def __init__(
        self, drives: tuple[DifferentialDrive, ...], delays_ns: tuple[int, ...], noise: FilterSettings
    ) -> None:
        n = len(drives)
        self._motion = np.array([(d.wheel_radius, d.wheel_base, d.motor_lag) for d in drives])
        self._delays_ns = np.array(delays_ns, dtype=np.int64)
        self._variance = np.array([noise.position_noise_m, noise.position_noise_m, noise.heading_noise_rad]) ** 2
        self._drift = np.array([noise.position_drift_m, noise.position_drift_m, noise.heading_drift_rad]) ** 2
        self._wander = np.array([noise.efficiency_sigma**2, noise.efficiency_time_s])
        self._gate = noise.gate_sigma**2
        self._state = np.zeros((n, 5))  # x, y, psi, efficiency of the left and of the right wheel
        self._state[:, 3:] = 1.0
        self._covariance = np.zeros((n, 5, 5))
        self._wheels = np.zeros((n, 2))  # as modelled, at the state's instant [rad/s]
        self.instants_ns = np.zeros(n, dtype=np.int64)  # of each robot's state; 0: never seen
        self._twice_ticks_ns = np.zeros(2 * _COMMANDS, dtype=np.int64)  # each is written twice, _HISTORY apart:
        self._twice_commands = np.zeros((2 * _COMMANDS, n, 2))  # so the newest ones always lie side by side
        self._command_count = 0  # commands so far
        self._ticks_ns, self._commands = self._twice_ticks_ns[:_COMMANDS], self._twice_commands[:_COMMANDS]
        self._moved = np.zeros((n, 3))  # as modelled, since the newest measurement used
        self._outliers = np.zeros(n, dtype=np.int64)
        self._outlier_pose = np.full((n, 3), np.nan)
        self.measured_ns = np.zeros(n, dtype=np.int64)  # newest measurement used; 0: never seen

    def command(self, tick_ns: int, wheels: Array) -> None:
        """Remember a tick's commands (N, 2) [rad/s]; each acts when its robot's delay has passed."""
        first = self._command_count % _COMMANDS
        for column in (first, first + _COMMANDS):
            self._twice_ticks_ns[column] = tick_ns
            self._twice_commands[column] = wheels
        self._command_count += 1
        newest = slice(first + 1, first + 1 + _COMMANDS)
        self._ticks_ns, self._commands = self._twice_ticks_ns[newest], self._twice_commands[newest]

    def observe(self, instants_ns: Instants, poses: Array) -> NDArray[np.int64]:
        """Use an image: ``poses`` (N, 3), NaN where a robot was not seen, each at its own mid-exposure (N,).

        With nine columns, the others are the measurements' covariances, as ``measurements`` writes them. Where they
        are 0, or not there, the filter's own noise counts.

        Returns for each robot UNUSED, USED, or CARRIED (used, and the filter started anew). What is older than the
        newest of a robot is not used; a robot that was not seen is moved on.
        """
        used = np.zeros(len(poses), dtype=np.int64)
        if poses.shape[1] == 3:
            poses = np.pad(poses, ((0, 0), (0, 6)))
        _observe(
            self._state, self._covariance, self._wheels, self.instants_ns, instants_ns, self._ticks_ns,
            self._delays_ns, self._commands, self._motion, self._drift, self._wander, self._variance, self._gate,
            poses, self._moved, self._outliers, self._outlier_pose, self.measured_ns, used,
        )  # fmt: skip
        return used

    def predict(self, tick_ns: int) -> tuple[Array, Array, Array]:
        """Return the poses (N, 3) at a tick; and at the moment when each robot's command of that tick acts, with the
        wheels' speeds (N, 2) then, as modelled [rad/s]."""
        return reckoning.predict(
            self._state, self._wheels, self.instants_ns, tick_ns, self._ticks_ns, self._delays_ns, self._commands,
            self._motion,
        )  # fmt: skip

    def expected(self, memory: FilterState, instants_ns: Instants) -> Array:
        """Return where the robots (N, 3) are, each at its own instant (N,), as far as an earlier ``memory`` knows it.

        NaN where it does not: of a robot that was not measured for long by then.
        """
        state, _, wheels, since_ns, *_, measured_ns = memory
        first_ns, last_ns = int(instants_ns.min()), int(instants_ns.max()) + 1
        begin, then = (
            reckoning.predict(state, wheels, since_ns, at_ns, self._ticks_ns, self._delays_ns, self._commands,
                              self._motion)[0]
            for at_ns in (first_ns, last_ns)
        )  # fmt: skip
        share = (instants_ns - first_ns) / (last_ns - first_ns)
        known = (instants_ns > since_ns) & (ages(measured_ns, last_ns) < _KNOWN_S)
        return np.where(known[:, None], begin + share[:, None] * (then - begin), np.nan)

    def memory(self) -> FilterState:
        """Return all that images change, for ``go_back``."""
        return tuple(each.copy() for each in self._changed())

    def go_back(self, memory: FilterState) -> None:
        """Be as at an earlier ``memory``; the commands since then stay known."""
        for each, before in zip(self._changed(), memory, strict=True):
            each[...] = before

    def _changed(self) -> FilterState:
        return (
            self._state, self._covariance, self._wheels, self.instants_ns, self._moved, self._outliers,
            self._outlier_pose, self.measured_ns,
        )  # fmt: skip

    def disturbance(self, poses: Array, point_ahead: float) -> Array:
        """Return w (N, 2): the velocity of the points p that the newest commands do not explain [m/s; world]."""
        return reckoning.disturbance(self._state, self._commands[-1], self._motion, poses, point_ahead)


@kernel
def _correct(x: Array, p: Array, moved: Array, innovation: Array, w: Array, gate: float, room: Array) -> bool:
    """As ``correct``; a robot whose measurement is an outlier may be held up."""
    for trial in range(2):  # one call: a second one would be compiled once more
        prior = p if trial == 0 else held_up(p, moved, room[8:])
        if correct(x, p, prior, innovation, w, gate, room[:8]):
            return True
    return False


@kernel
def _observe(
    state: Array, covariance: Array, wheels: Array, instants_ns: Instants, exposures_ns: Instants, ticks_ns: Instants,
    delays_ns: Instants, commands: Array, motion: Array, drift: Array, wander: Array, variance: Array, gate: float,
    measured: Array, moved: Array, outliers: Instants, outlier_pose: Array, measured_ns: Instants, used: Instants,
) -> None:  # fmt: skip
    before, travel, step, innovation, room = np.empty(3), np.empty(2), np.empty(3), np.empty(3), np.empty((13, 5))
    r, w = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(state)):
        seen = not np.isnan(measured[i, 0])
        if exposures_ns[i] <= instants_ns[i] or (instants_ns[i] == 0 and not seen):
            continue
        if instants_ns[i] == 0:
            instants_ns[i] = exposures_ns[i] - 1
        x, p = state[i], covariance[i]
        copy(before, x)
        travel[0] = travel[1] = 0.0
        advance(
            x, wheels[i], travel, instants_ns[i], exposures_ns[i], ticks_ns, delays_ns[i], commands[:, i], motion[i]
        )
        duration = (exposures_ns[i] - instants_ns[i]) * 1e-9
        instants_ns[i] = exposures_ns[i]
        for k in range(3):
            step[k] = x[k] - before[k]
        step[2] = wrapped(step[2])
        predict_covariance(x, p, step, travel, motion[i, 1], duration, drift, wander, room[:8])
        for k in range(3):
            moved[i, k] += step[k]
            innovation[k] = measured[i, k] - x[k]
        if not seen:
            continue
        innovation[2] = wrapped(innovation[2])
        covariance_of(measured[i], variance, r)
        whitening(r, w)
        known = measured_ns[i] > 0
        if known and _correct(x, p, moved[i], innovation, w, gate, room):
            outliers[i] = 0
            used[i] = USED
        else:
            for k in range(3):
                step[k] = abs(measured[i, k] - outlier_pose[i, k])
            agrees = step[0] < 0.03 and step[1] < 0.03 and abs(wrapped(step[2])) < 0.3
            outliers[i] = outliers[i] + 1 if agrees else 1
            copy(outlier_pose[i], measured[i, :3])
            if known and outliers[i] < _CARRIED_AFTER:
                continue
            start_anew(x, p, measured[i], r, wander)
            outliers[i] = 0
            used[i] = CARRIED
        x[2] = wrapped(x[2])
        measured_ns[i] = exposures_ns[i]
        for k in range(3):
            moved[i, k] = 0.0


@kernel
def ages(measured_ns: Instants, now_ns: int) -> Array:
    """Return how old each newest measurement is [s]; infinite for one that never was."""
    found = np.empty(len(measured_ns))
    for i in range(len(found)):
        found[i] = (now_ns - measured_ns[i]) / 1e9 if measured_ns[i] > 0 else np.inf
    return found


def rows_of(tags: dict[int, int]) -> Instants:
    """Return the row of each tag, for ``measurements``; ``tags``: the robots' rows by their tags."""
    rows = np.full(_TAG_NUMBERS, _NOBODY)
    rows[list(tags)] = list(tags.values())
    return rows


@kernel
def measurements(
    tag_poses: NDArray[Any], rows: Instants, exposure_ns: int, latest_ns: int, poses: Array, instants_ns: Instants
) -> None:
    """Write what an image measured, TagPose (K,), into poses (M, 9), NaN where nothing was, and the robots'
    own mid-exposures (M,). What is predicted, or later than ``latest_ns``, is no measurement.

    Columns: x, y [m], psi [rad], and their covariance in the message's order; zeros where nobody knows it.
    """
    for row in range(len(poses)):
        for k in range(COLUMNS):
            poses[row, k] = np.nan
        instants_ns[row] = exposure_ns
    for tag_pose in tag_poses:
        row, instant_ns = rows[tag_pose["tag"]], exposure_ns + tag_pose["after_ns"]
        if row != _NOBODY and tag_pose["coasted_ns"] == 0 and instant_ns <= latest_ns:
            poses[row, 0], poses[row, 1], poses[row, 2] = tag_pose["x_m"], tag_pose["y_m"], tag_pose["psi_rad"]
            poses[row, 3], poses[row, 4], poses[row, 5] = tag_pose["xx_m2"], tag_pose["xy_m2"], tag_pose["yy_m2"]
            poses[row, 6], poses[row, 7], poses[row, 8] = (
                tag_pose["xpsi_m_rad"],
                tag_pose["ypsi_m_rad"],
                tag_pose["psipsi_rad2"],
            )
            instants_ns[row] = instant_ns


KERNELS = (ages, measurements, _observe, reckoning.predict, reckoning.disturbance)  # that are called from Python


class Bystanders:
    """Where the robots stand that nobody drives: as last seen, moved on for a moment if a hand pushes them.

    The fleet's filter believes that a robot moves by its commands. These have none, so nothing is assumed of them.
    Poses (N, 3): x, y [m], psi [rad], and velocities (N, 2) [m/s] in the world frame.

    ``jump`` (N,): one that is seen so far from where it was [m] was carried there, and stands.
    ``longest`` [s]: one that is not seen is moved on for no longer.
    """

    def __init__(self, jump: Array, longest: float) -> None:
        n = len(jump)
        self._jump, self._longest = jump, longest
        self._poses = np.zeros((n, 3))
        self.velocities = np.zeros((n, 2))
        self.measured_ns = np.zeros(n, dtype=np.int64)  # newest pose; 0: never seen

    def observe(self, instants_ns: Instants, poses: Array) -> None:
        """Use an image: ``poses`` (N, 3), NaN where one was not seen, each at its own mid-exposure (N,)."""
        for row in np.flatnonzero(np.isfinite(poses).all(axis=1) & (instants_ns > self.measured_ns)).tolist():
            duration = (instants_ns[row] - self.measured_ns[row]) * 1e-9
            moved = poses[row, :2] - self._poses[row, :2]
            if self.measured_ns[row] and math.hypot(*moved) <= self._jump[row]:
                share = 1.0 - math.exp(-duration / _VELOCITY_TIME_S)
                self.velocities[row] += share * (moved / duration - self.velocities[row])
            else:
                self.velocities[row] = 0.0
            self._poses[row] = poses[row]
            self.measured_ns[row] = instants_ns[row]

    def predict(self, instant_ns: int) -> Array:
        """Return the poses (N, 3) at an instant."""
        predicted = self._poses.copy()
        after = np.clip((instant_ns - self.measured_ns) * 1e-9, 0.0, self._longest)
        predicted[:, :2] += self.velocities * after[:, None]
        return predicted

"""The drive that tells most of a robot: manoeuvres chosen by their Fisher information.

Each candidate is driven by the model in thought. The residuals' derivatives there are its information, those of the fit
itself; the thresholds of a wheel have their likelihood on a grid. Manoeuvres begin and end at rest, so what they tell
adds up. One after the other is taken that lowers the logarithm of the determinant of the stated covariance most for
each second of driving (D-optimal, greedy).
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from robofleet.behaviours.excitation import LONGEST_LINE_M, REST_S, Manoeuvre, leaves_place, there_and_back, turning_s
from robofleet.calibration.robots import believed
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.information import (
    ENCODERS,
    HELD_OUT,
    PARAMETERS,
    SMOOTH_ROWS,
    SYSTEMATIC_VARIANCE,
    THRESHOLDS,
    Prior,
    Residuals,
    covariance,
    derivative,
    squares,
)
from robofleet.calibration.robots.shooting import Noise, Wheels, accumulated, compose
from robofleet.config import slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.vehicles.differential_drive import DifferentialDrive

_SHARES = 0.15, 0.4, 0.7, 1.0  # of a wheel's top speed
_CREEP_SHARES = 0.06, 0.1, 0.16
_STEP_SHARES = (0.5, -0.5), (0.5, 0.25), (0.25, 0.5), (0.8, -0.3)
_SPIN_S, _TOP_S, _CREEP_S, _STEP_S, _STEPS = 2.5, 0.7, 3.0, 0.165, 8
_SHORTEST_LINE_M = 0.1
_TRUTHS = -1.5, -0.75, 0.0, 0.75, 1.5  # where a threshold may be, in its standard deviations from what is believed
_LEAST_TRUTH = 0.1  # [rad/s]
_FINEST = 0.0075  # step of the fit's own grid [rad/s]
_OFFSETS = _FINEST * np.array([0, 1, 2, 3, 4, 6, 8, 11, 15, 20, 28, 40, 60, 90, 140])
_LEAST_VARIANCE = 1e-12
_FALLS_SHORT = 0.995  # of the commanded top speed: a wheel that reaches it does not tell its own
NOISE = {  # of poses and wheels, where nobody identified the robot: of the simulated camera through the tracker
    "noise_position_mm": 0.01, "noise_heading_deg": 0.03, "wander_slip": 4e-4, "wander_way": 3e-4,
    "noise_stamp_ms": 0.02, "wander_wheel": 1e-3,
}  # fmt: skip
_ROUNDING = 1e-11  # variance in units of the prior
_SIMULATED = [row for row, name in enumerate(PARAMETERS) if name not in ENCODERS]
_STATUS_S = 0.02  # from one reading of encoders to the next


@dataclass(frozen=True, kw_only=True)
class Design:
    """What one robot shall drive, and the standard deviations (P,) of PARAMETERS that are stated before and after."""

    robot: str
    manoeuvres: tuple[Manoeuvre, ...]
    duration_s: float
    before: Array
    expected: Array


@dataclass(frozen=True)
class Knowledge:
    """What is known of a robot, or what a manoeuvre tells."""

    information: Array  # (n, n) of SMOOTH, in units of the priors' standard deviations
    squares: Mapping[str, Array]  # of a threshold: (truths, grid), the sums of squares

    def __add__(self, other: "Knowledge") -> "Knowledge":
        return Knowledge(
            self.information + other.information,
            {name: each + other.squares[name] for name, each in self.squares.items()},
        )


@dataclass(frozen=True)
class _Candidate:
    manoeuvre: Manoeuvre
    duration_s: float
    leaves_place: bool
    tells: Knowledge


def design(config: Config, robot: Robot, seconds: float, line_m: float = LONGEST_LINE_M, robots: int = 1) -> Design:
    """Choose a robot's manoeuvres for so many seconds, on a free line of so many metres.

    Of so many ``robots``, which drive one after the other from full batteries on, it is one in the middle.
    """
    designer = Designer(config, robot, robots * seconds / 2.0)
    drive = slices.drive(robot)
    candidates = [
        _Candidate(each, duration_s, leaves_place(drive, each), designer.tells(each))
        for each in manoeuvres(drive, line_m)
        if (duration_s := list(there_and_back(drive, each, 0.0))[-1].end) <= seconds - REST_S
    ]
    chosen: list[Manoeuvre] = []
    knowledge, duration_s, turn_s = designer.known, REST_S, turning_s(drive)
    while True:

        def cost_s(each: _Candidate, turn_s: float = turn_s) -> float:
            return each.duration_s + (turn_s if each.leaves_place else 0.0)

        now = designer.log_determinant(knowledge)
        gains = {
            k: (now - designer.log_determinant(knowledge + each.tells)) / cost_s(each)
            for k, each in enumerate(candidates)
            if duration_s + cost_s(each) <= seconds
        }
        if not gains:
            break
        best = candidates[max(gains, key=gains.__getitem__)]
        duration_s += cost_s(best)
        turn_s = 0.0 if best.leaves_place else turn_s
        knowledge += best.tells
        chosen.append(best.manoeuvre)
    return Design(
        robot=robot.id, manoeuvres=tuple(chosen), duration_s=duration_s,
        before=designer.sigmas(designer.known), expected=designer.sigmas(knowledge),
    )  # fmt: skip


def manoeuvres(drive: DifferentialDrive, line_m: float) -> Iterator[Manoeuvre]:
    """Yield candidates: spins, lines, bends, creeps through the dead band, top speed, steps."""
    highest = drive.max_wheel_speed
    fastest = min(highest, drive.max_speed / drive.wheel_radius)
    for share in _SHARES:
        w = share * highest
        yield Manoeuvre(left_rad_s=-w, right_rad_s=w, duration_s=_SPIN_S)
        v = share * fastest
        line_s = line_m / (v * drive.wheel_radius)
        for slower in (1.0, 0.5, 0.0):
            if line_m >= _SHORTEST_LINE_M:
                yield Manoeuvre(left_rad_s=v, right_rad_s=slower * v, duration_s=line_s)
                if slower < 1.0:
                    yield Manoeuvre(left_rad_s=slower * v, right_rad_s=v, duration_s=line_s)
    yield Manoeuvre(left_rad_s=-highest, right_rad_s=highest, duration_s=_TOP_S)
    for share in _CREEP_SHARES:
        w = share * highest
        for creep_s in (_CREEP_S / 2.0, _CREEP_S, 2.0 * _CREEP_S):
            yield Manoeuvre(left_rad_s=-w, right_rad_s=w, duration_s=creep_s, ramp=True)
            if w * drive.wheel_radius * creep_s / 2.0 <= line_m:
                yield Manoeuvre(left_rad_s=w, right_rad_s=w, duration_s=creep_s, ramp=True)
    for left, right in _STEP_SHARES:
        for step_s in (_STEP_S, 2.0 * _STEP_S):
            yield Manoeuvre(left_rad_s=left * highest, right_rad_s=right * highest, duration_s=step_s, times=_STEPS)


class Designer:
    """Says what manoeuvres tell of one robot, whose battery has been used for so long then."""

    def __init__(self, config: Config, robot: Robot, used_s: float = 0.0) -> None:
        errors = believed.believed_errors(robot)
        self._charge = max(0.0, 1.0 - used_s / errors.battery_life_s)
        self._count = errors.speed_quantum_rad_s * errors.loop_period_s  # of its encoders [rad]; 0: it has none
        self._robot, self._drive, self._prior = robot, slices.drive(robot), believed.prior(config, robot)
        self._tick_s = config.controller.tick_s
        self._acceleration = robot.vehicle.max_wheel_acceleration_rad_s2
        source = None if robot.calibration is None else robot.calibration.identified
        stated, figures = np.diag(self._prior.sigmas**2), dict(NOISE)
        if source is not None and source.parameters == PARAMETERS:
            stated = np.array(source.covariance)
            figures |= {name: value for name, value in source.figures.items() if name in figures and value is not None}
        position, heading = 1e-3 * figures["noise_position_mm"], math.radians(figures["noise_heading_deg"])
        self._pose_covariance = position**2, 0.0, position**2, 0.0, 0.0, heading**2
        self._noise = Noise(
            slip=figures["wander_slip"], way=figures["wander_way"], stamp_s=1e-3 * figures["noise_stamp_ms"],
            wander=figures["wander_wheel"],
        )  # fmt: skip
        top = min(self._prior.values.top_speed_rad_s, _FALLS_SHORT * self._drive.max_wheel_speed)
        self._wheels = replace(self._prior.values, top_speed_rad_s=top)
        self._stated = np.sqrt(np.maximum(np.diag(stated) - SYSTEMATIC_VARIANCE, _LEAST_VARIANCE))
        self._truths = {name: self._truths_of(name) for name in THRESHOLDS}
        self.known = Knowledge(_information(stated, self._prior), {name: self._believed(name) for name in THRESHOLDS})

    def tells(self, manoeuvre: Manoeuvre) -> Knowledge:
        """Return what a manoeuvre tells, of which the fit leaves a part out."""
        drive = self._driven(manoeuvre)
        j = derivative(self._residuals(drive, self._wheels), self._wheels, self._prior)
        share = (HELD_OUT - 1) / HELD_OUT
        found = {}
        for name in THRESHOLDS:
            rows = []
            for truth in self._truths[name] if manoeuvre.ramp else ():
                wheels = self._with(name, truth)
                rows.append(squares(self._residuals(drive, wheels), wheels, name, truth + _grid(truth)))
            found[name] = share * np.array(rows) if rows else np.zeros_like(self.known.squares[name])
        return Knowledge(share * j.T @ j, found)

    def log_determinant(self, knowledge: Knowledge) -> float:
        """Return that of the covariance that would be stated of what the robot is simulated by."""
        scale = np.outer(self._prior.sigmas, self._prior.sigmas)
        return float(np.linalg.slogdet((self._covariance(knowledge) / scale)[np.ix_(_SIMULATED, _SIMULATED)])[1])

    def sigmas(self, knowledge: Knowledge) -> Array:
        """Return the standard deviations (P,) that would be stated."""
        return np.sqrt(np.diag(self._covariance(knowledge)))

    def _covariance(self, knowledge: Knowledge) -> Array:
        thresholds = {name: self._threshold(name, each) for name, each in knowledge.squares.items()}
        return covariance(knowledge.information, self._prior, thresholds)

    def _threshold(self, name: str, total: Array) -> float:
        """Return a threshold's standard deviation, the root mean square over where it may be."""
        variances = []
        for truth, row in zip(self._truths[name], total, strict=True):
            grid = truth + _grid(truth)
            weights = np.gradient(grid) * np.exp(-0.5 * (row - row.min()))
            weights /= weights.sum()
            mean = weights @ grid
            variances.append(weights @ (grid - mean) ** 2 + _FINEST**2 / 12.0)
        return math.sqrt(float(np.mean(variances)))

    def _truths_of(self, name: str) -> list[float]:
        value, sigma = getattr(self._wheels, name), self._stated[PARAMETERS.index(name)]
        least = _LEAST_TRUTH + (0.0 if name == "deadband_rad_s" else self._wheels.deadband_rad_s)
        return [max(least, value + sigma * share) for share in _TRUTHS]

    def _believed(self, name: str) -> Array:
        value, sigma = getattr(self._wheels, name), self._stated[PARAMETERS.index(name)]
        return np.array([((truth + _grid(truth) - value) / sigma) ** 2 for truth in self._truths[name]])

    def _with(self, name: str, truth: float) -> Wheels:
        wheels = replace(self._wheels, **{name: truth})
        return replace(wheels, breakaway_rad_s=max(wheels.deadband_rad_s, wheels.breakaway_rad_s))

    def _driven(self, manoeuvre: Manoeuvre) -> RobotDrive:
        """Return the drive of a manoeuvre, without what is measured."""
        spells = list(there_and_back(self._drive, manoeuvre, 0.0))
        at_s = np.arange(0.0, spells[-1].end, self._tick_s)
        ends = np.array([spell.end for spell in spells])
        rows = np.searchsorted(ends, at_s, side="right")
        wheels = [spells[row].wheels(t) for row, t in zip(rows.tolist(), at_s.tolist(), strict=True)]
        counted_s = np.arange(0.0, spells[-1].end, _STATUS_S) if self._count else np.empty(0)
        return RobotDrive(
            self._robot.id, at_s, np.array(wheels), at_s + self._tick_s / 2.0, np.zeros((len(at_s), 3)), np.empty(0),
            np.empty((0, 2)), counted_s, np.zeros((len(counted_s), 2)), 0.0, self._acceleration,
            pose_covariances=np.tile(self._pose_covariance, (len(at_s), 1)), battery=np.full(len(at_s), self._charge),
        )  # fmt: skip

    def _residuals(self, drive: RobotDrive, truth: Wheels) -> Residuals:
        """Return the function from models to residuals (R,), of poses without noise of a robot that is so."""
        motion = believed.shots(self._robot, drive).motion(truth)
        tag = np.array([truth.tag_forward_m, truth.tag_left_m, truth.tag_heading_rad])
        angles = motion.angles * (truth.left_encoder, truth.right_encoder)
        if self._count:
            angles = self._count * np.round(angles / self._count)
        shots = believed.shots(
            self._robot, replace(drive, poses=compose(accumulated(motion.steps), tag), encoders_rad=angles)
        )
        chosen = np.ones_like(shots.shot, dtype=np.bool_), np.ones_like(shots.encoders.shot, dtype=np.bool_)
        return lambda wheels: shots.all_residuals(wheels, self._noise, *chosen)


def _information(stated: Array, prior: Prior) -> Array:
    """Return the information (n, n) of SMOOTH in a stated covariance, without what residuals do not show."""
    scale = prior.sigmas[SMOOTH_ROWS]
    random = (stated - np.diag(SYSTEMATIC_VARIANCE))[np.ix_(SMOOTH_ROWS, SMOOTH_ROWS)] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(random)
    return np.asarray(vectors / np.maximum(values, _ROUNDING) @ vectors.T)


def _grid(truth: float) -> Array:
    """Return where a threshold is looked for, from the true one [rad/s]."""
    return np.asarray(np.maximum(-truth, np.concatenate([-_OFFSETS[:0:-1], _OFFSETS])))

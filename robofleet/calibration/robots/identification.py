"""Identifies a robot's model from recordings: least squares on the residuals of ``shooting.py``.

Each parameter has a prior, which is what the configuration believes, with a wide standard deviation. What the
recordings do not tell is found by the Fisher information against these priors, is named, and stays at its prior. The
two thresholds of a wheel (dead band, breakaway) are found by their posterior on a grid (``thresholds.py``), all others
by Gauss-Newton steps (``scipy.optimize.least_squares``). The noise's scales and the wander are those that are likeliest
by the residuals and by their own priors. Every fifth shot is held out: it takes no part in the fit.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from scipy.optimize import least_squares, minimize

from robofleet.calibration.robots import thresholds
from robofleet.calibration.robots.held_out import HeldOut, held_out_errors
from robofleet.calibration.robots.information import (
    HELD_OUT,
    LEAST,
    OUTLIER_SIGMA,
    PARAMETERS,
    SMOOTH,
    SMOOTH_ROWS,
    THRESHOLDS,
    TOP_SPEED,
    Prior,
    covariance,
    derivative,
    determined,
    unsaturated,
)
from robofleet.calibration.robots.shooting import Noise, Shots, Wheels, relative
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

_OF_STOPS = ("stop_lag_s",)

_MOST = {"motor_lag_s": 2.0, "stop_lag_s": 2.0, "delay_s": 1.0, "slip_s_per_rad": 0.5}
_DELAYS_S, _LAGS_S = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3), (0.01, 0.04, 0.08, 0.15, 0.3)
_SPLITS_S = np.geomspace(0.005, 0.4, 16).tolist()
_AT_FIRST = Noise(position=5.0, heading=5.0, way=3e-3, stamp_s=5e-3, wander=3e-2)
_ROUNDS = 3
_LOSS_SCALE = 3.0  # from so many sigmas on a residual counts less
_OUTLIER_SHARE = 0.2
_OUTLIER_PASSES = 2
_NOISE_SIGMA = np.log(3.0)  # of the logarithms of a noise, around what is believed
_FEWEST_POSES = 100
_LEAST_WAY_M, _LEAST_TURN_RAD = 0.2, 1.0
_NEAR = 0.7  # of a threshold, or its prior's standard deviation: commands so far from it are about as fast
_LEAST_NEAR_S = 1.0  # of commands about as fast as a threshold: with less it is not told


@dataclass(frozen=True, kw_only=True)
class Identification:
    """What was found of one robot."""

    robot: str
    prior: Prior
    wheels: Wheels
    noise: Noise
    covariance: Array  # (p, p) of PARAMETERS
    determined: tuple[str, ...]
    weakest: tuple[str, ...]  # the combination of parameters that is told least
    left_out: int  # poses that were outliers
    misfits: int  # poses in a row that the model does not explain: there it is wrong
    poses: int
    chi_square: float  # mean square of the whitened residuals, without outliers and misfits
    correlation: float  # of each residual with the next one; 0: white
    held_out_chi_square: float
    held_out: tuple[HeldOut, ...]
    residuals: tuple[Array, ...]  # (M, 3) of each recording, whitened; 0: none
    encoder_chi_square: float  # as those of the poses; NaN: it has no encoders
    encoder_correlation: float

    @property
    def sigma(self) -> dict[str, float]:
        """The parameters' standard deviations."""
        return dict(zip(PARAMETERS, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The parameters that the recordings do not tell, which stayed at their priors."""
        return tuple(name for name in PARAMETERS if name not in self.determined)


def identify(recordings: Sequence[Shots], prior: Prior) -> Identification:
    """Identify one robot from its recordings.

    Raises:
        CalibrationError: they are too short or too still, or the fit does not converge.
    """
    refuse_unusable(recordings)
    fit = _Fit(recordings, prior)
    fit.run()
    return fit.found()


def refuse_unusable(recordings: Sequence[Shots]) -> None:
    """Raise a CalibrationError where too little was seen, or the robot hardly moved."""
    robot = recordings[0].drive.robot
    poses = sum(len(shots.at_s) for shots in recordings)
    if poses < _FEWEST_POSES:
        raise CalibrationError(
            f"{robot}: it was seen in {poses} images while it was driven, {_FEWEST_POSES} are needed: record longer"
        )
    way_m, turn = 0.0, 0.0
    for shots in recordings:
        every = slice(None, None, 15)  # noise adds up over every pose
        step = relative(shots.poses[every][:-1], shots.poses[every][1:])
        way_m += float(np.hypot(step[:, 0], step[:, 1]).sum())
        turn += float(np.abs(step[:, 2]).sum())
    if way_m < _LEAST_WAY_M or turn < _LEAST_TURN_RAD:
        raise CalibrationError(
            f"{robot}: it drove {way_m:.2f} m and turned {turn:.1f} rad, {_LEAST_WAY_M:g} m and {_LEAST_TURN_RAD:g} "
            "rad are needed: let it drive further, with curves"
        )


class _Fit:
    def __init__(self, recordings: Sequence[Shots], prior: Prior) -> None:
        self._recordings, self._prior = recordings, prior
        self._robot = recordings[0].drive.robot
        self._centre, self._sigma = prior.centre, prior.sigmas
        self._wheels, self._noise = prior.values, _AT_FIRST
        self._threshold_sigma = {name: prior.sigma[name] for name in THRESHOLDS}
        self._fixed: set[str] = set()  # what is not told
        self._frozen: dict[str, float] = {}  # what was told by poses that are left out now, and its variance
        self._held_out = [shots.shot % HELD_OUT == HELD_OUT - 1 for shots in recordings]
        self._training = [~own for own in self._held_out]
        self._counted = [shots.encoders.shot % HELD_OUT != HELD_OUT - 1 for shots in recordings]

    def run(self) -> None:
        self._start()
        self._leave_out()
        for _ in range(_ROUNDS):
            self._follow_valley()
            self._descend()
            self._estimate_noise()
            for _ in range(_OUTLIER_PASSES):
                self._leave_out()
                self._estimate_noise()
            self._find_thresholds()
        found = self._covariance()
        self._fixed = set(PARAMETERS) - set(determined(found, self._prior))
        untold = self._fixed.difference(TOP_SPEED)  # of a top speed it is known at least that it was reached
        self._wheels = replace(self._wheels, **{name: getattr(self._prior.values, name) for name in untold})
        rows = [PARAMETERS.index(name) for name in _OF_STOPS]
        self._frozen = dict(zip(_OF_STOPS, np.diag(found)[rows].tolist(), strict=True))
        for _ in range(_OUTLIER_PASSES):  # what the model cannot explain shall not bend the rest
            self._leave_out(misfits=True)
            self._estimate_noise()
            self._descend(must_converge=True)
        self._estimate_noise()

    # what is minimised

    def _residuals(self, wheels: Wheels) -> Array:
        each = zip(self._recordings, self._training, self._counted, strict=True)
        return np.concatenate([shots.all_residuals(wheels, self._noise, *chosen) for shots, *chosen in each])

    def _scaled(self, wheels: Wheels) -> Array:
        return np.asarray((np.array(astuple(wheels)) - self._centre) / self._sigma)

    def _moved(self, x: Array, names: Sequence[str]) -> Wheels:
        """Return the model with parameters x (p,) of these names, counted from their priors in their sigmas."""
        rows = [PARAMETERS.index(name) for name in names]
        values = (self._centre[rows] + x * self._sigma[rows]).tolist()
        return replace(self._wheels, **dict(zip(names, values, strict=True)))

    # how

    def _start(self) -> None:
        """Take the tag's heading from how it drove, and delay and lag from a grid: the squares have several valleys."""
        way = np.concatenate([_ways(shots, self._wheels) for shots in self._recordings])
        turned = -float(np.angle(way.sum()))
        self._wheels = replace(self._wheels, tag_heading_rad=turned)

        def cost(wheels: Wheels) -> float:
            e = self._residuals(wheels)
            return float(np.minimum(e * e, OUTLIER_SIGMA**2).sum())

        grid = (
            replace(self._wheels, delay_s=delay, motor_lag_s=lag, stop_lag_s=lag)
            for delay in _DELAYS_S
            for lag in _LAGS_S
        )
        self._wheels = min(grid, key=cost)

    def _follow_valley(self) -> None:
        """Take the best split of delay and lag: their sum is told by every drive, each of them by quick changes."""
        together_s = self._wheels.delay_s + self._wheels.motor_lag_s
        splits = [lag_s for lag_s in _SPLITS_S if together_s - lag_s > LEAST["delay_s"]]
        models = [replace(self._wheels, motor_lag_s=lag_s, delay_s=together_s - lag_s) for lag_s in splits]
        self._wheels = min([self._wheels, *models], key=lambda model: float((self._residuals(model) ** 2).sum()))

    def _smooth(self) -> tuple[str, ...]:
        return tuple(name for name in PARAMETERS if name not in (*self._fixed, *self._frozen, *THRESHOLDS))

    def _descend(self, *, must_converge: bool = False) -> None:
        names = self._smooth()
        rows = [PARAMETERS.index(name) for name in names]
        low, high = (
            (np.array([limits.get(name, far) for name in names]) - self._centre[rows]) / self._sigma[rows]
            for limits, far in ((LEAST, -np.inf), (_MOST, np.inf))  # not a large number: the solver scales by it
        )

        def residuals(x: Array) -> Array:
            return np.concatenate([self._residuals(self._moved(x, names)), x])

        def jacobian(x: Array) -> Array:
            return np.vstack(
                [derivative(self._residuals, self._moved(x, names), self._prior, names), np.eye(len(names))]
            )

        start = np.clip(self._scaled(self._wheels)[rows], low + 1e-9, high - 1e-9)
        solved = least_squares(
            residuals, start, jacobian, bounds=(low, high), loss="soft_l1", f_scale=_LOSS_SCALE, max_nfev=30, xtol=1e-7,
            ftol=1e-7,
        )  # fmt: skip
        if must_converge and not (solved.success and np.isfinite(solved.cost)):
            raise CalibrationError(
                f"{self._robot}: the fit does not converge: do its tag and its time stamps belong to this drive?"
            )
        self._wheels = self._moved(solved.x, names)

    def _estimate_noise(self) -> None:
        """Take the likeliest noise; what no noise explains counts as an outlier's does."""
        motions = [shots.motion(self._wheels) for shots in self._recordings]
        believed = np.log(np.array(astuple(self._prior.noise)))

        def minus_log_likelihood(logs: Array) -> float:
            noise = Noise(*np.exp(np.clip(logs, -20.0, 5.0)).tolist())
            total = 0.5 * float((((logs - believed) / _NOISE_SIGMA) ** 2).sum())
            each = zip(self._recordings, motions, self._training, self._counted, strict=True)
            for shots, motion, seen, counted in each:
                model = self._wheels, noise, motion
                for e, log_determinant in (shots.residuals(*model, seen), shots.encoder_residuals(*model, counted)):
                    total += 0.5 * float(np.minimum(e * e, OUTLIER_SIGMA**2).sum()) + log_determinant
            return total

        start = np.log(np.array(astuple(self._noise)))
        simplex = start + np.vstack([np.zeros(len(start)), np.eye(len(start))])
        found = minimize(
            minus_log_likelihood, start, method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 0.02, "fatol": 0.1, "maxfev": 600},
        )  # fmt: skip
        self._noise = Noise(*np.exp(np.clip(found.x, -20.0, 5.0)).tolist())

    def _leave_out(self, *, misfits: bool = False) -> None:
        """Leave out poses that are outliers; ``misfits``: and those where the model is wrong."""
        for shots in self._recordings:
            shots.kept = ~shots.outliers(self._wheels, self._noise, OUTLIER_SIGMA, misfits=misfits)
            shots.encoders.kept = ~shots.encoder_outliers(self._wheels, self._noise, OUTLIER_SIGMA)
        share = np.mean([not kept for shots in self._recordings for kept in shots.kept])
        if misfits and share > _OUTLIER_SHARE:
            raise CalibrationError(
                f"{self._robot}: {100 * share:.0f} % of its poses do not fit any motion: did something else move it, "
                "or is its tag hard to see?"
            )

    def _find_thresholds(self) -> None:
        """Take the means of the thresholds' posterior; of one that no command is near, what is believed."""
        cost = thresholds.cost(self._residuals, self._wheels, self._prior, self._smooth())
        means, sigmas = (each.tolist() for each in thresholds.posterior(cost, self._wheels))
        for name, mean, sigma in zip(THRESHOLDS, means, sigmas, strict=True):
            believed, wide = getattr(self._prior.values, name), self._prior.sigma[name]
            near = sum(shots.near_s(mean, max(_NEAR * mean, wide)) for shots in self._recordings) >= _LEAST_NEAR_S
            self._wheels = replace(self._wheels, **{name: mean if near else believed})
            self._threshold_sigma[name] = sigma if near else wide

    # what came out

    def _covariance(self) -> Array:
        """Return the covariance of all parameters: of the fit, with their priors; of thresholds by their posteriors."""
        j = derivative(self._residuals, self._wheels, self._prior)
        for name, column in unsaturated(self._residuals, self._wheels, self._prior).items():
            j[:, SMOOTH.index(name)] = column
        information = j.T @ j + np.eye(j.shape[1])
        found = covariance(information, self._prior, self._threshold_sigma)
        for name, sigma in self._threshold_sigma.items():  # where it is another one, so are the others
            value = getattr(self._wheels, name)
            high, low = (
                self._residuals(replace(self._wheels, **{name: max(0.0, value + change)})) for change in (sigma, -sigma)
            )
            shift = -self._sigma[SMOOTH_ROWS] * np.linalg.solve(information, j.T @ ((high - low) / 2.0))
            found[np.ix_(SMOOTH_ROWS, SMOOTH_ROWS)] += np.outer(shift, shift)
            row = PARAMETERS.index(name)
            found[row, SMOOTH_ROWS] = found[SMOOTH_ROWS, row] = sigma * shift
        for name, variance in self._frozen.items():
            row = PARAMETERS.index(name)
            found[row, :] = found[:, row] = 0.0
            found[row, row] = variance
        return found

    def _weakest(self, found: Array) -> tuple[str, ...]:
        """Return which combination of told parameters is told least."""
        rows = [k for k, name in enumerate(PARAMETERS) if name not in self._fixed]
        _, vectors = np.linalg.eigh(found[np.ix_(rows, rows)] / np.outer(self._sigma[rows], self._sigma[rows]))
        parts = sorted(zip(np.abs(vectors[:, -1]).tolist(), rows, strict=True), reverse=True)
        return tuple(PARAMETERS[k] for part, k in parts[:3] if part > 0.3)

    def _everything(self, shots: Shots) -> tuple[Array, Array]:
        """Return the residuals (M, 3) of a recording's poses, and (2 E,) of its encoders, one wheel after the other."""
        model = self._wheels, self._noise, shots.motion(self._wheels)
        poses, _ = shots.residuals(*model, np.ones_like(shots.shot, dtype=np.bool_))
        angles, _ = shots.encoder_residuals(*model, np.ones_like(shots.encoders.shot, dtype=np.bool_))
        return poses, angles.T.ravel()

    def found(self) -> Identification:
        poses, encoders = zip(*(self._everything(shots) for shots in self._recordings), strict=True)
        found = self._covariance()
        own = [e[chosen][e[chosen].any(axis=1)] for e, chosen in zip(poses, self._training, strict=True)]
        others = [e[chosen][e[chosen].any(axis=1)] for e, chosen in zip(poses, self._held_out, strict=True)]
        counted = np.concatenate([e[e != 0.0] for e in encoders])
        white, held_out = np.concatenate(own), np.concatenate(others)
        gate = self._wheels, self._noise, OUTLIER_SIGMA
        single = sum(int(shots.outliers(*gate, misfits=False).sum()) for shots in self._recordings)
        without = sum(int((~shots.kept).sum()) for shots in self._recordings)
        return Identification(
            robot=self._robot,
            prior=self._prior,
            wheels=self._wheels,
            noise=self._noise,
            covariance=found,
            determined=tuple(name for name in PARAMETERS if name not in self._fixed),
            weakest=self._weakest(found),
            left_out=single,
            misfits=max(0, without - single),
            poses=sum(len(shots.at_s) for shots in self._recordings),
            chi_square=_mean_square(white),
            correlation=_correlation(white),
            held_out_chi_square=_mean_square(held_out),
            held_out=held_out_errors(self._recordings, self._held_out, self._wheels, self._prior.values, self._noise),
            residuals=poses,
            encoder_chi_square=_mean_square(counted),
            encoder_correlation=_correlation(counted),
        )


def _mean_square(white: Array) -> float:
    return float((white**2).mean()) if len(white) else math.nan


def _correlation(white: Array) -> float:
    """Return how far residuals (n,) or (n, 3) depend on the ones before."""
    return float((white[1:] * white[:-1]).mean() / (white**2).mean()) if len(white) else math.nan


def _ways(shots: Shots, wheels: Wheels) -> Array:
    """Return each step of the tag, in its own frame, times the model's conjugate: complex, its angle is the tag's."""
    model, seen = shots.motion(wheels).steps, relative(shots.poses[:-1], shots.poses[1:])
    straight = np.abs(model[:, 2]) < 0.2 * np.abs(model[:, 0]) / wheels.wheel_base_m
    return np.asarray(((seen[:, 0] + 1j * seen[:, 1]) * (model[:, 0] - 1j * model[:, 1]))[straight])

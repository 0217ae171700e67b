"""What residuals say of a robot's model: their derivatives, the Fisher information, and the covariance that follows.

The two thresholds of a wheel (dead band, breakaway) make the squares a staircase, which has no derivative: of them
there is a likelihood on a grid. The fit uses both afterwards, a plan of a drive before.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, fields, replace

import numpy as np

from robofleet.calibration.robots.shooting import Noise, Wheels
from robofleet.core.arrays import Array

PARAMETERS = tuple(field.name for field in fields(Wheels))
THRESHOLDS = "deadband_rad_s", "breakaway_rad_s"
ENCODERS = "left_encoder", "right_encoder", "encoder_offset_s"
SMOOTH = tuple(name for name in PARAMETERS if name not in THRESHOLDS)
SMOOTH_ROWS = [PARAMETERS.index(name) for name in SMOOTH]
LEAST = {  # values of parameters
    "motor_lag_s": 1e-4, "stop_lag_s": 1e-4, "deadband_rad_s": 0.0, "breakaway_rad_s": 0.0, "delay_s": -0.02,
    "slip_s_per_rad": -0.5,
}  # fmt: skip
OUTLIER_SIGMA = 6.0  # a residual counts as so much at most
DETERMINED = 0.3  # a parameter is determined where its standard deviation is so much less than its prior's
HELD_OUT = 5  # of so many shots one takes no part in a fit

_STEPS = {  # of numerical derivatives
    "left_radius_m": 1e-6, "right_radius_m": 1e-6, "wheel_base_m": 1e-5, "motor_lag_s": 2e-4, "stop_lag_s": 2e-4,
    "delay_s": 2e-4, "top_speed_rad_s": 0.01, "top_speed_sag": 1e-2,
    "slip_s_per_rad": 1e-4, "tag_forward_m": 1e-5, "tag_left_m": 1e-5, "tag_heading_rad": 1e-4,
    "left_encoder": 1e-4, "right_encoder": 1e-4, "encoder_offset_s": 2e-4,
}  # fmt: skip
TOP_SPEED = "top_speed_rad_s", "top_speed_sag"
_HIGHER = {  # steps to a higher top speed, of the parameters that it has
    "top_speed_rad_s": (0.01, 0.02, 0.05, 0.1, 0.2, 0.4), "top_speed_sag": (-0.01, -0.02, -0.05, -0.1, -0.2, -0.4),
}  # fmt: skip
# What the residuals do not show. Commands act, and images are exposed, at instants that are known to a millisecond: of
# a firmware's loop, an exposure, the simulated truth between two samples. Poses bend over the arena by some hundredths
# of a millimetre and of a degree: measured on simulated platoons through the tracker. A threshold is passed on a ramp
# whose instants are as uncertain: measured on simulated excitations.
_SYSTEMATIC = {
    "left_radius_m": 1.5e-6, "right_radius_m": 1.5e-6, "wheel_base_m": 3e-5, "motor_lag_s": 5e-4, "stop_lag_s": 1e-3,
    "deadband_rad_s": 8e-3, "breakaway_rad_s": 8e-3,
    "delay_s": 5e-4, "slip_s_per_rad": 5e-4, "tag_forward_m": 3e-5, "tag_left_m": 1e-4, "tag_heading_rad": 5e-5,
    "encoder_offset_s": 5e-4,
}  # fmt: skip
SYSTEMATIC_VARIANCE = np.array([_SYSTEMATIC.get(name, 0.0) ** 2 for name in PARAMETERS])

Residuals = Callable[[Wheels], Array]


@dataclass(frozen=True)
class Prior:
    """What is believed of a robot: values, and standard deviations by their names; its poses' noise and its wander."""

    values: Wheels
    sigma: Mapping[str, float]
    noise: Noise

    @property
    def centre(self) -> Array:
        """The values (P,) of PARAMETERS."""
        return np.array(astuple(self.values))

    @property
    def sigmas(self) -> Array:
        """The standard deviations (P,) of PARAMETERS."""
        return np.array([self.sigma[name] for name in PARAMETERS])


def derivative(residuals: Residuals, wheels: Wheels, prior: Prior, names: tuple[str, ...] = SMOOTH) -> Array:
    """Return the residuals' derivative (R, n) by parameters in units of their priors' standard deviations."""
    columns = []
    for name in names:
        step, value = _STEPS[name], getattr(wheels, name)
        low = max(value - step, LEAST.get(name, -np.inf))
        change = residuals(replace(wheels, **{name: value + step})) - residuals(replace(wheels, **{name: low}))
        columns.append((change / (value + step - low) * prior.sigma[name]).ravel())
    return np.column_stack(columns)


def unsaturated(residuals: Residuals, wheels: Wheels, prior: Prior) -> Mapping[str, Array]:
    """Return the derivatives (R,) by a higher top speed: a wheel that reaches its command does not tell its own.

    The step is the first of ``_HIGHER`` by which the sum of squares rises by one, which is a standard deviation: a
    wheel that falls short of its command by less than that tells its top speed to neither side.
    """
    fitted, found = residuals(wheels), {}
    for name, steps in _HIGHER.items():
        for step in steps:
            change = (residuals(replace(wheels, **{name: getattr(wheels, name) + step})) - fitted).ravel()
            if change @ change >= 1.0:
                break
        found[name] = np.asarray(change / step * prior.sigma[name])
    return found


def squares(residuals: Residuals, wheels: Wheels, name: str, grid: Array) -> Array:
    """Return the sum of squares at each value (n,) of a parameter; what no noise explains counts as an outlier."""
    values = (residuals(replace(wheels, **{name: value})) for value in grid.tolist())
    return np.array([float(np.minimum(e * e, OUTLIER_SIGMA**2).sum()) for e in values])


def covariance(information: Array, prior: Prior, thresholds: Mapping[str, float]) -> Array:
    """Return the covariance (P, P) of PARAMETERS, with what residuals do not show.

    Args:
        information: (n, n) of SMOOTH, in units of the priors' standard deviations, prior included.
        prior: These standard deviations.
        thresholds: Standard deviations of the thresholds.
    """
    sigmas = prior.sigmas[SMOOTH_ROWS]
    found = np.diag([thresholds.get(name, 0.0) ** 2 for name in PARAMETERS] + SYSTEMATIC_VARIANCE)
    found[np.ix_(SMOOTH_ROWS, SMOOTH_ROWS)] += np.linalg.inv(information) * np.outer(sigmas, sigmas)
    return found


def determined(found: Array, prior: Prior) -> tuple[str, ...]:
    """Return which parameters a covariance (P, P) leaves much less uncertain than their priors."""
    share = np.sqrt(np.diag(found)) / prior.sigmas
    return tuple(name for name, each in zip(PARAMETERS, share.tolist(), strict=True) if each < DETERMINED)

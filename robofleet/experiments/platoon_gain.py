"""The gain from robot to robot of a platoon, over frequency.

Measured without noise, on a circle, where the platoon's linearisation does not change with time.
"""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours.platoon import Platoon
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control import wheels
from robofleet.control.path import Path
from robofleet.control.platoon import INPUTS, PlatoonLaw, PlatoonSettings
from robofleet.core.arrays import Array
from robofleet.core.settings import Model, Positive
from robofleet.vehicles.differential_drive import DifferentialDrive

Integrator = Literal["exact", "euler"]
INTEGRATORS: tuple[Integrator, Integrator] = ("exact", "euler")
_CIRCLE_SIDES = 16
_SIGNAL_TO_FLOOR = 30.0  # at a frequency at which nobody shakes


class GainParameters(Model):
    """The multi-sine."""

    robots: Annotated[int, Field(ge=3)]
    period_s: Positive
    periods: Annotated[tuple[Annotated[int, Field(gt=0)], ...], Field(min_length=1, strict=False)]
    amplitude_s: Positive


def settings_of(base: Config) -> Platoon.Settings:
    """Return the settings of a configuration's one group, which is a platoon."""
    (group,) = base.groups
    return Platoon.Settings.model_validate(group.settings)


def robot_gains(parameters: GainParameters, base: Config, integrator: Integrator) -> list[float | None]:
    """Return the largest gain from any robot to the next, at each frequency.

    The leader's time is shaken by sines; along the path, each robot's motion is compared with that of the same run
    without them, after one period in which the platoon settles. Robots in which the sine drowns in what the platoon
    does by itself do not count; NaN where it drowns in all of them.
    """
    shaken, still = (_along(parameters, base, integrator, a) for a in (parameters.amplitude_s, 0.0))
    motion = shaken - still
    turns = np.arange(len(motion)) / len(motion)

    def amplitudes(periods: int) -> Array:
        return np.asarray(np.abs((motion * np.exp(-2j * np.pi * periods * turns)[:, None]).mean(axis=0)))

    gains: list[float | None] = []
    for periods in parameters.periods:
        amplitude, floor = amplitudes(periods), amplitudes(periods + 1)  # nobody shakes at the next frequency
        strong = amplitude > _SIGNAL_TO_FLOOR * floor
        both = strong[1:] & strong[:-1]
        gains.append(float((amplitude[1:] / amplitude[:-1])[both].max()) if both.any() else None)
    return gains


def _along(parameters: GainParameters, base: Config, integrator: Integrator, amplitude_s: float) -> Array:
    """Drive ideal robots with motor lag around a circle; where each is along it over one period (K, N) [m]."""
    own, c = settings_of(base), base.controller
    radius = 1.5 * parameters.robots * own.spacing_m / math.tau
    angle = np.arange(_CIRCLE_SIDES) * math.tau / _CIRCLE_SIDES
    at = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    handle = 12 * radius * math.tan(math.tau / _CIRCLE_SIDES / 4) / 3  # Hermite's best arc
    path = Path.hermite(at, handle * np.column_stack([-np.sin(angle), np.cos(angle)]))
    given = own.path.path()
    speed = own.path_rate * given.length() / given.sides
    settings = PlatoonSettings(
        c.alpha, c.horizon_s, c.point_ahead_m, own.spacing_m, speed * path.sides / path.length(), c.tick_s,
        integrator, "point",
    )  # fmt: skip
    vehicle = slices.drive(base.members[0])
    law = PlatoonLaw(path, settings, (vehicle,) * parameters.robots)
    fleet = _Circling(vehicle, radius, own.spacing_m, parameters.robots, c.point_ahead_m)
    driving, of_body = np.ones(parameters.robots, dtype=np.bool_), np.zeros(parameters.robots, dtype=np.bool_)
    limits = wheels.limits(law.vehicles)
    ticks = round(parameters.period_s / c.tick_s)
    along = []
    for k in range(2 * ticks):
        t = k * c.tick_s
        shake = sum(math.sin(math.tau * n * k / ticks + n) for n in parameters.periods)
        requested = law.tick(t + amplitude_s * shake, fleet.poses, driving)[:, INPUTS]
        request = wheels.limited(requested, of_body, fleet.poses, c.point_ahead_m, limits, driving)
        law.changed(request.u)
        fleet.move(request.wheels, c.tick_s)
        along.append(fleet.along())
    return np.array(along[ticks:])


class _Circling:
    """Ideal robots with motor lag, all at once; along the circle they are seen by the angle of their points p."""

    def __init__(
        self, drive: DifferentialDrive, radius: float, spacing: float, robots: int, point_ahead: float
    ) -> None:
        at = -2.0 * math.asin(spacing / 2.0 / radius) * np.arange(robots)
        self.poses = np.column_stack([radius * np.cos(at), radius * np.sin(at), at + math.pi / 2.0])
        self._wheels = np.zeros((robots, 2))
        self._drive, self._radius, self._l = drive, radius, point_ahead
        self._angle = at

    def move(self, commands: Array, duration: float) -> None:
        """Advance by one tick of constant commands (N, 2) [rad/s]."""
        lag, d = self._drive.motor_lag, self._drive
        decay = math.exp(-duration / lag)
        ahead = self._wheels - commands
        mean = commands + ahead * (1.0 - decay) * lag / duration
        self._wheels = commands + ahead * decay
        v = d.wheel_radius * mean.sum(axis=1) / 2.0
        turn = d.wheel_radius * (mean[:, 1] - mean[:, 0]) / d.wheel_base * duration
        chord = v * duration * np.sinc(turn / math.tau)
        heading = self.poses[:, 2] + turn / 2.0
        self.poses[:, 0] += chord * np.cos(heading)
        self.poses[:, 1] += chord * np.sin(heading)
        self.poses[:, 2] += turn

    def along(self) -> Array:
        """Return the way of each point p around the circle so far (N,) [m]."""
        x = self.poses[:, 0] + self._l * np.cos(self.poses[:, 2])
        y = self.poses[:, 1] + self._l * np.sin(self.poses[:, 2])
        angle = np.arctan2(y, x)
        self._angle = self._angle + np.remainder(angle - self._angle + math.pi, math.tau) - math.pi
        return np.asarray(self._radius * self._angle)

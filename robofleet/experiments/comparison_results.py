"""What a comparison of controllers is asked for, and what it measures of each."""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.config.files.parameters import Parameters
from robofleet.core.arrays import Array
from robofleet.core.settings import Model, Positive
from robofleet.experiments.baselines.choice import Key, Laws
from robofleet.experiments.baselines.problem import Drive, Problem
from robofleet.experiments.closed_curve import Track
from robofleet.experiments.curves import lane_change
from robofleet.experiments.driving import Speeds
from robofleet.vehicles.bicycle import FALCONE_2007, ZHOU_2017

CORNER, NOISE, SOFT_TYRES = "corner", "noise", "soft tyres"  # cases
ROLLED = ", rolled"  # of a case whose delay is rolled forward over
Delays = Annotated[tuple[Positive, ...], Field(strict=False)]


class Limits(Model):
    """Of both inputs."""

    acceleration_m_s2: Positive
    steering_rad: Positive


class Trouble(Model):
    """What is done to the loop, one thing at a time."""

    speed_m_s: Positive
    delays_s: Delays
    position_noise_m: Positive
    stiffness: Positive
    seed: Annotated[int, Field(ge=0)]
    left_out: Annotated[tuple[Key, ...], Field(strict=False)]  # too slow, and like another one


class ClosedCurve(Model):
    """The first ``drive_m`` of the track."""

    speed_km_h: Positive
    drive_m: Positive
    track: Track


class ComparisonParameters(Parameters):
    """``configs/paper/comparison.yaml``."""

    controllers: Annotated[tuple[Key, ...], Field(min_length=1, strict=False)]
    speeds_m_s: Speeds
    drive_m: Positive
    curve_length_m: Positive
    control_step_s: Positive
    plant_step_s: Positive
    computing_delay_s: Positive
    limits: Limits
    turn: Annotated[int, Field(ge=2)]
    laws: Laws
    trouble: Trouble
    closed_curve: ClosedCurve

    def complaints(self) -> Iterator[Complaint]:
        """Steps that do not divide; no flow to compare with; a curve that ends before the predictions do."""
        step = self.control_step_s
        if "flow" in self.trouble.left_out:
            yield "trouble.left_out", "must not contain flow: the others are compared with it"
        if "flow" not in self.controllers:
            yield "controllers", "must contain flow: the others are compared with it"
        for key, value, unit in (
            ("control_step_s", step, self.plant_step_s),
            ("computing_delay_s", self.computing_delay_s, step),
            *((f"trouble.delays_s.{k}", delay, step) for k, delay in enumerate(self.trouble.delays_s)),
        ):
            if abs(value / unit - round(value / unit)) > 1e-6:
                yield key, f"must be a whole multiple of {unit:g}, not {value:g}"
        laws, fastest = self.laws, max(*self.speeds_m_s, self.trouble.speed_m_s)
        ahead = max(laws.mpc.horizon_s, laws.flow.horizon_s, laws.flow_paper.horizon_s)
        ahead += max(self.computing_delay_s, *self.trouble.delays_s, 0.0) + step
        if self.curve_length_m < (needed := self.drive_m + fastest * ahead):
            yield "curve_length_m", f"must be at least {needed:.0f}: drive_m and what is predicted at {fastest:g} m/s"

    @property
    def lane_changes(self) -> dict[str, float]:
        """The speeds [m/s] of the undisturbed lane changes, by the names of the cases."""
        return {f"{speed:g} m/s": speed for speed in self.speeds_m_s}

    @property
    def fastest(self) -> str:
        """The name of the fastest undisturbed lane change."""
        return max(self.lane_changes, key=self.lane_changes.__getitem__)

    @property
    def delays(self) -> dict[str, int]:
        """The delays of the trouble in control periods, by the names of the cases in which nobody is told of them."""
        return {f"{1e3 * delay:g} ms": self.samples(delay) for delay in self.trouble.delays_s}

    @property
    def troubles(self) -> list[str]:
        """The names of the cases with one thing wrong."""
        return [*(case for name in self.delays for case in (name, f"{name}{ROLLED}")), NOISE, SOFT_TYRES]

    def lane_change(self, speed: float) -> Problem:
        """Return the lane change at a speed [m/s]."""
        reference = lane_change(1.0, self.curve_length_m)
        limits = self.limits.acceleration_m_s2, self.limits.steering_rad
        return Problem(FALCONE_2007, reference, speed, self.control_step_s, self.plant_step_s, *limits)

    def corner(self) -> Problem:
        """Return the drive on the closed curve."""
        track, speed = self.closed_curve.track.reference(), self.closed_curve.speed_km_h / 3.6
        return dataclasses.replace(self.lane_change(speed), model=ZHOU_2017, reference=track)

    def samples(self, delay: float) -> int:
        """Return a delay [s] in control periods."""
        return round(delay / self.control_step_s)


@dataclass(frozen=True)
class Updates:
    """Durations of one controller's updates through its Python API [us]."""

    warm: Array  # just after another of its own
    first: Array  # just after other controllers', which have the processor's caches

    @property
    def p50(self) -> float:
        """Median of the warm ones."""
        return float(np.median(self.warm))


@dataclass(frozen=True)
class Compared:
    """Everything measured of one controller."""

    name: str
    cold_ms: float | None  # building it and its first update; None: its code was there already
    drives: dict[str, Drive]  # by the names of the cases; none of the trouble's, where they are left out
    failures: int  # updates of the undisturbed lane changes whose solver gave up
    updates: Updates | None = None  # on one sequence of states, in turns with the others

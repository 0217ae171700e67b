"""What the two experiments with the dynamic bicycle (III-A, III-B) share: parameters, peaks, panels."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.config.files.parameters import Parameters
from robofleet.control.flow import FlowSettings
from robofleet.core.arrays import Array
from robofleet.core.settings import Model, NonNegative, Positive
from robofleet.experiments.curves import Reference
from robofleet.experiments.results import Cell, Curve, Figure, Panel, Table
from robofleet.experiments.simulate import Drive, Loop

OTHER_MODELS = "the sources' columns are other models on other roads: no claim of being better rests on them"


Pair = tuple[Cell, Cell]  # a peak lateral error [cm] and a peak heading error [deg]
NOT_GIVEN: tuple[Pair, Pair] = ((None, None), (None, None))
Group = tuple[str, Sequence[tuple[str, Array, Drive]]]  # title; label, abscissa [m] and drive of each curve
_TOPICS: tuple[tuple[str, str, str, Callable[[Drive], Array]], ...] = (
    ("control-error", "control error", "cm", lambda d: 1e2 * d.control_error),
    ("acceleration", "longitudinal acceleration", "m/s²", lambda d: d.inputs[:, 0]),
    ("lateral-error", "lateral error", "cm", lambda d: 1e2 * d.lateral),
    ("heading-error", "heading error", "deg", lambda d: np.asarray(np.degrees(d.heading))),
)


class FlowParameters(Model):
    """Parameters of the law."""

    horizon_s: Positive
    alpha: Positive
    integrator: Literal["exact", "euler"]

    def settings(self, step: float, delay: float = 0.0) -> FlowSettings:
        """Return the law's settings; ``delay`` [s] is what it knows of the delay."""
        return FlowSettings(self.alpha, self.horizon_s, step, self.integrator, delay=delay)

    def __str__(self) -> str:
        return f"T {self.horizon_s:g} s, alpha {self.alpha:g} 1/s, {self.integrator}"


class DriveParameters(Parameters):
    """How the bicycle is driven; all figures of a drive are taken at the control instants."""

    duration_s: Positive
    control_step_s: Positive
    plant_step_s: Positive
    computing_delay_s: NonNegative
    long_delay_s: Positive
    reference_lead_s: Positive
    settle_s: NonNegative
    recommended: FlowParameters

    def loop(self, delay: float | None = None, lead: float = 0.0) -> Loop:
        """Return the loop, with another computing delay [s] and a reference that is ``lead`` [s] too far ahead."""
        delay = self.computing_delay_s if delay is None else delay
        return Loop(self.duration_s, self.control_step_s, self.plant_step_s, delay, lead)

    def complaints(self) -> Iterator[Complaint]:
        """Steps that do not divide, times that do not fit."""
        step = self.control_step_s
        if not _multiple(step, self.plant_step_s):
            yield "control_step_s", f"must be a whole multiple of plant_step_s, {self.plant_step_s:g}, not {step:g}"
        for key in ("computing_delay_s", "long_delay_s", "duration_s"):
            if not _multiple(value := getattr(self, key), step):
                yield key, f"must be a whole multiple of control_step_s, {step:g}, not {value:g}"
        if self.settle_s >= self.duration_s:
            yield "settle_s", f"must be less than duration_s, {self.duration_s:g}, not {self.settle_s:g}"

    def statement(self) -> tuple[str, ...]:
        """Return the settings of the simulation, and what the errors are."""
        return (
            f"control step {self.control_step_s:g} s with zero-order hold, computing delay {self.computing_delay_s:g} "
            f"s, plant by RK4 at {1e3 * self.plant_step_s:g} ms, {self.duration_s:g} s, reference by arc length",
            "the paper gives no computing delay: this one is ours, also where the law is as printed",
            "lateral error: distance of the centre of gravity from the curve; heading error: heading minus the "
            "tangent at the nearest point",
        )

    def transient_notes(self) -> tuple[str, ...]:
        """Return what the rows of the start-up transient are."""
        return (
            f"start: the whole drive, r(t + T) taken {1e3 * self.reference_lead_s:g} ms too far ahead, about one "
            "sample: the paper's transient looks like that; taken at t + T, as printed, there is none",
            f"later: r(t + T) as printed, from {self.settle_s:g} s on",
        )


Speeds = Annotated[tuple[Positive, ...], Field(min_length=1, strict=False)]


@dataclass(frozen=True)
class Peaks:
    """The largest absolute values of a drive, after ``since`` [s]."""

    lateral_cm: float
    heading_deg: float
    control_error_cm: float
    acceleration: float  # a_l [m/s^2]


def peaks(drive: Drive, since: float = 0.0) -> Peaks:
    chosen = drive.t >= since
    return Peaks(
        _largest(drive.lateral[chosen]) * 1e2,
        float(np.degrees(_largest(drive.heading[chosen]))),
        _largest(drive.control_error[chosen]) * 1e2,
        _largest(drive.inputs[chosen, 0]),
    )


def peaks_at(drive: Drive, values: Array, above: float) -> list[float]:
    """Return z1 [m] where |values| (K,) of a drive have maxima larger than ``above``."""
    size = np.abs(values)
    found = (size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:]) & (size[1:-1] > above)
    return [round(float(z), 1) for z in drive.states[1:-1, 0][found]]


def road(reference: Reference, drives: Sequence[tuple[str, Drive]], title: str = "", until: float = np.inf) -> Panel:
    """Return the panel with the reference and the trajectories, up to z1 = ``until`` [m]."""
    ways = [Curve(name, found.states[:, 0], found.states[:, 1]) for name, found in drives]
    ways.append(Curve("reference", reference.positions[::5, 0], reference.positions[::5, 1], "dashed"))
    shown = tuple(replace(way, x=way.x[way.x <= until], y=way.y[way.x <= until]) for way in ways)
    return Panel("z₁, m", "z₂, m", shown, title, equal=reference.closed)


def topics(groups: Sequence[Group], x_label: str, what: str) -> list[Figure]:
    """Return a figure a topic, a panel a group."""
    figures = []
    for name, topic, unit, values_of in _TOPICS:
        panels = [
            Panel(
                x_label,
                f"{topic}, {unit}",
                tuple(Curve(label, x, values_of(d)[: len(x)]) for label, x, d in drives),
                title,
            )
            for title, drives in groups
        ]
        figures.append(Figure(name, f"{what}: {topic}", tuple(panels)))
    return figures


def peak_tables(
    title: str, speeds: Sequence[str], columns: Mapping[str, Sequence[Pair]], notes: tuple[str, ...], heading_form: str
) -> tuple[Table, Table]:
    """Return the tables of the peak lateral and heading errors, with a row a speed and a column a source."""
    kinds = ("lateral error, cm", ".1f", ()), ("heading error, deg", heading_form, notes)
    tables = []
    for k, (what, form, own_notes) in enumerate(kinds):
        rows = zip(speeds, *([pair[k] for pair in pairs] for pairs in columns.values()), strict=True)
        formats = "", *(form for _ in columns)
        tables.append(Table(f"{title}: peak {what}", ("speed", *columns), tuple(rows), own_notes, formats))
    return tables[0], tables[1]


def errors(drives: Sequence[Drive]) -> list[Pair]:
    """Return the peaks of each drive as ``peak_tables`` shows them."""
    return [(found.lateral_cm, found.heading_deg) for found in map(peaks, drives)]


def _largest(values: Array) -> float:
    return float(np.abs(values).max())


def _multiple(value: float, step: float) -> bool:
    return abs(value / step - round(value / step)) < 1e-6

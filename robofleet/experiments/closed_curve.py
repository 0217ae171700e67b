"""Table 1 and Figs 3-7 (III-A): the dynamic bicycle on a closed curve at 15, 25 and 35 km/h.

The paper's curve is not published; ours is a rounded rectangle (``configs/paper/closed-curve.yaml``).
"""

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import Plant
from robofleet.core.settings import Model, Positive
from robofleet.experiments.curves import Reference
from robofleet.experiments.driving import (
    NOT_GIVEN,
    OTHER_MODELS,
    DriveParameters,
    FlowParameters,
    Speeds,
    errors,
    peak_tables,
    peaks,
    road,
    topics,
)
from robofleet.experiments.results import Cell, Figure, Result, Table
from robofleet.experiments.simulate import Drive, drive
from robofleet.vehicles.bicycle import ZHOU_2017

# Table 1, by speed [km/h]: peak lateral error [cm] and heading error [deg], the paper's and its source's
TABLE_1 = {15.0: ((2.0, 3.0), (36.0, 3.3)), 25.0: ((5.0, 2.8), (23.0, 2.8)), 35.0: ((8.0, 2.2), (17.0, 2.6))}
_START_UP_M = 40.0  # what is drawn of the transient


class Track(Model):
    """A rounded rectangle."""

    straights_m: Annotated[tuple[Positive, Positive], Field(strict=False)]  # along x, along y
    corner_radius_m: Positive
    curvature_ramp_m: Positive  # length over which the curvature grows to 1/radius, and over which it falls

    def reference(self) -> Reference:
        return Reference.rounded_rectangle(self.straights_m, self.corner_radius_m, self.curvature_ramp_m)


class ClosedCurveParameters(DriveParameters):
    """``configs/paper/closed-curve.yaml``."""

    speeds_km_h: Speeds
    flow: FlowParameters
    track: Track
    other_corner_radii_m: Annotated[tuple[Positive, ...], Field(strict=False)]  # driven too: what the choice does

    def complaints(self) -> Iterator[Complaint]:
        """Also: corners with no arc between their ramps."""
        yield from super().complaints()
        longest, ramp = self.track.corner_radius_m * np.pi / 2.0, self.track.curvature_ramp_m
        for k, radius in enumerate(self.other_corner_radii_m):
            if ramp > radius * np.pi / 2.0:
                yield (
                    f"other_corner_radii_m.{k}",
                    f"too small for curvature ramps of {ramp:g} m: a corner turns 90 degrees",
                )
        if ramp > longest:
            yield "track.curvature_ramp_m", f"must be at most {longest:.1f}: a corner turns 90 degrees"


def run(parameters: ClosedCurveParameters) -> Result:
    """Drive the track at each speed: the paper's law, its start-up transient, this project's setting."""
    track, speeds = parameters.track.reference(), parameters.speeds_km_h
    paper = [driven(parameters, track, speed) for speed in speeds]
    early = [driven(parameters, track, speed, lead=parameters.reference_lead_s) for speed in speeds]
    ours = [driven(parameters, track, speed, ours=True) for speed in speeds]
    printed = [TABLE_1.get(speed, NOT_GIVEN) for speed in speeds]
    columns = {
        "here": errors(paper),
        "paper": [row[0] for row in printed],
        "Zhou 17": [row[1] for row in printed],
        "own setting": errors(ours),
    }
    lateral, heading = peak_tables("Table 1, closed curve", _names(parameters), columns, _notes(parameters), ".1f")
    transient, choice = _transient(parameters, paper, early, ours), _choice(parameters, paper)
    return Result(
        (lateral, heading, choice, transient), _figures(parameters, track, paper, early), {"lap_m": track.length}
    )


def driven(
    parameters: ClosedCurveParameters, track: Reference, speed_km_h: float, *, lead: float = 0.0, ours: bool = False,
    model: Plant | None = None,
) -> Drive:  # fmt: skip
    """Drive one speed; ``model``: what the flow takes the vehicle for, if not what it is."""
    flow, step = parameters.recommended if ours else parameters.flow, parameters.control_step_s
    settings = flow.settings(step, parameters.computing_delay_s if ours else 0.0)
    return drive(bicycle_plant(ZHOU_2017), settings, parameters.loop(lead=lead), track, speed_km_h / 3.6, model=model)


def _names(parameters: ClosedCurveParameters) -> list[str]:
    return [f"{speed:g} km/h" for speed in parameters.speeds_km_h]


def _notes(parameters: ClosedCurveParameters) -> tuple[str, ...]:
    track = parameters.track
    return (
        f"here: {parameters.flow}; own setting: {parameters.recommended}, computing delay rolled forward",
        f"track: ours, the paper's is not published: a rounded rectangle, counterclockwise, straights "
        f"{track.straights_m[0]:g} m and {track.straights_m[1]:g} m, corners of radius {track.corner_radius_m:g} m, "
        f"curvature ramps of {track.curvature_ramp_m:g} m; start in the middle of a long straight at the speed",
        f"the radius of {track.corner_radius_m:g} m was chosen because it gives about the paper's figures",
        *parameters.statement(),
        f"Zhou 17: {OTHER_MODELS}",
    )


def _choice(parameters: ClosedCurveParameters, chosen: list[Drive]) -> Table:
    """Return what the corners' radius, which is ours, does to the paper's law."""
    speeds, track = parameters.speeds_km_h, parameters.track
    drives = {track.corner_radius_m: chosen}
    for radius in parameters.other_corner_radii_m:
        other = track.model_copy(update={"corner_radius_m": radius}).reference()
        drives[radius] = [driven(parameters, other, speed) for speed in speeds]
    rows: list[tuple[Cell, ...]] = []
    for radius, found in sorted(drives.items()):
        of_it = [peaks(run) for run in found]
        rows.append((f"{radius:g}", *(p.lateral_cm for p in of_it), *(p.heading_deg for p in of_it)))
    columns = ("radius m", *(f"{what}, {name}" for what in ("cm", "deg") for name in _names(parameters)))
    notes = (
        f"peak lateral error, cm, and heading error, deg, of the paper's law; {track.corner_radius_m:g} m is Table 1's",
        "the paper's track is not published: that one radius agrees with it shows no more than that some radius does",
    )
    formats = ("", *(".1f" for _ in columns[1:]))
    return Table("Closed curve: what the radius of the corners does", columns, tuple(rows), notes, formats)


def _transient(parameters: ClosedCurveParameters, paper: list[Drive], early: list[Drive], ours: list[Drive]) -> Table:
    after = [peaks(found, parameters.settle_s) for found in paper]
    during, best = [peaks(found) for found in early], [peaks(found) for found in ours]
    rows: tuple[tuple[Cell, ...], ...] = (
        ("control error, later, cm", *(p.control_error_cm for p in after), "about 2"),
        ("control error, start, cm", *(p.control_error_cm for p in during), "about 12.5"),
        ("control error, own setting, cm", *(p.control_error_cm for p in best), None),
        ("acceleration, later, m/s²", *(p.acceleration for p in after), "under 0.1"),
        ("acceleration, start, m/s²", *(p.acceleration for p in during), "under 0.8"),
        ("acceleration, own setting, m/s²", *(p.acceleration for p in best), None),
    )
    columns = ("peak", *_names(parameters), "paper")
    formats = ("", *(".2f" for _ in parameters.speeds_km_h), "")
    return Table(
        "Closed curve: control error, acceleration and the start-up transient",
        columns,
        rows,
        parameters.transient_notes(),
        formats,
    )


def _figures(
    parameters: ClosedCurveParameters, track: Reference, paper: list[Drive], early: list[Drive]
) -> tuple[Figure, ...]:
    names = _names(parameters)
    lap = [found.along[found.along <= track.length] for found in paper]
    begin = [found.along[found.along <= _START_UP_M] for found in early]
    as_printed = ("the first lap", list(zip(names, lap, paper, strict=True)))
    lead = f"its start, with r(t + T) {1e3 * parameters.reference_lead_s:g} ms too far ahead"
    both = [as_printed, (lead, list(zip(names, begin, early, strict=True)))]
    x_label, what = "distance along the track, m", "Closed curve"
    curve = Figure("curve", "Closed curve", (road(track, list(zip(names, paper, strict=True))),))
    return (curve, *topics(both, x_label, what)[:2], *topics([as_printed], x_label, what)[2:])

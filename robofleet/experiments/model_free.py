"""Tables 1 and 2 without a model: the bicycle is learned from sixty seconds of other driving. And the platoon.

What is taken as known are definitions: the position's rate is the body's velocity, the heading's rate the yaw rate. The
rates of both velocities and of the yaw rate are learned, from states and inputs alone: no mass, no tyre.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.config.files.names import SHIPPED
from robofleet.config.files.parameters import Parameters, load_parameters
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import Plant
from robofleet.control.learned import Fit, Network, Polynomial, Samples, learned_plant
from robofleet.control.prediction import compile_plant
from robofleet.core.arrays import Array
from robofleet.core.settings import Positive
from robofleet.experiments import closed_curve, lane_change
from robofleet.experiments.driving import Peaks, peaks
from robofleet.experiments.learned_platoon import learned_table
from robofleet.experiments.results import Cell, Curve, Figure, Panel, Result, Table
from robofleet.experiments.simulate import Drive
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import FALCONE_2007, ZHOU_2017, BicycleParameters

_STATES = _RATES = (2, 3, 5)  # v_l, v_n, yaw rate
_SINES = 6
_DRAWN_M = 160.0  # of a drive
_LONGEST_PERIOD_S, _SHORTEST_PERIOD_S = 20.0, 0.8
_STEERING_RAD = 0.12  # at most
_SPEED_RATE = 1.0  # at which the driver corrects the speed [1/s]

Range = Annotated[tuple[Positive, Positive], Field(strict=False)]


class ModelFreeParameters(Parameters):
    """``configs/paper/model-free.yaml``."""

    duration_s: Positive
    sample_s: Positive
    speeds_m_s: dict[str, Range]
    lateral_m_s2: Positive
    degree: int = Field(ge=1, le=5)
    hidden: int = Field(ge=1, le=40)
    seed: int = Field(ge=0)
    recorded: str


def _known_slope(x: Array, u: Array) -> Array:
    dx, c, s = np.zeros(6), math.cos(x[4]), math.sin(x[4])
    dx[0], dx[1], dx[4] = x[2] * c - x[3] * s, x[2] * s + x[3] * c, x[5]
    return dx


def _known_by_state(x: Array, u: Array) -> Array:
    j, c, s = np.zeros((6, 6)), math.cos(x[4]), math.sin(x[4])
    j[0, 2], j[0, 3], j[0, 4] = c, -s, -x[2] * s - x[3] * c
    j[1, 2], j[1, 3], j[1, 4] = s, c, x[2] * c - x[3] * s
    j[4, 5] = 1.0
    return j


def _known_by_input(x: Array, u: Array) -> Array:
    return np.zeros((6, 2))


DEFINITIONS = Plant(_known_slope, bicycle.position, 6, 2, _known_by_state, _known_by_input, bicycle.position_jacobian)


def other_driving(p: ModelFreeParameters, vehicle: BicycleParameters, speeds: tuple[float, float]) -> Samples:
    """Return what a driver recorded who goes through the speeds [m/s] and steers by sines."""
    plant, rng, dt = bicycle_plant(vehicle), np.random.default_rng(p.seed), p.sample_s
    rollout, none, axles = compile_plant(plant).rollout, np.zeros(6), vehicle.front_axle + vehicle.rear_axle
    rates = 2.0 * np.pi / rng.uniform(_SHORTEST_PERIOD_S, _LONGEST_PERIOD_S, (2, _SINES))
    phases = rng.uniform(0.0, 2.0 * np.pi, (2, _SINES))
    states, inputs = [np.array([0.0, 0.0, speeds[0], 0.0, 0.0, 0.0])], []
    for k in range(round(p.duration_s / dt)):
        t, v = k * dt, states[-1][2]
        pedal, wheel = np.sin(rates * t + phases).sum(axis=1) / math.sqrt(_SINES)
        wanted = speeds[0] + (speeds[1] - speeds[0]) * math.sin(2.0 * math.pi * t / p.duration_s) ** 2
        most = min(_STEERING_RAD, p.lateral_m_s2 * (axles / v**2 + 0.004))  # as the car understeers
        inputs.append(np.array([_SPEED_RATE * (wanted - v) + 0.2 * pedal, most * np.clip(wheel, -1.5, 1.5)]))
        after = np.empty(6)
        rollout(states[-1], inputs[-1], none, dt, after)
        states.append(after)
    return Samples(np.array(states[:-1]), np.array(inputs), np.array(states[1:]), dt)


def learned(p: ModelFreeParameters, samples: Samples) -> dict[str, Fit]:
    """Return the learned bicycles by how they were fitted."""
    kinds: dict[str, Polynomial | Network] = {
        "polynomial": Polynomial(p.degree),
        "network": Network(p.hidden, p.seed),
    }
    return {name: learned_plant(DEFINITIONS, samples, _STATES, _RATES, kind) for name, kind in kinds.items()}


def run(parameters: ModelFreeParameters) -> Result:
    """Drive both tables with the exact model and with learned ones, then the platoon with learned robots."""
    rows: list[tuple[Cell, ...]] = []
    fits: list[tuple[Cell, ...]] = []
    panels, worst = [], 0.0
    experiments = (
        ("Table 1", "closed-curve", ZHOU_2017, _closed_curve()),
        ("Table 2", "lane-change", FALCONE_2007, _changes()),
    )
    for name, experiment, vehicle, cases in experiments:
        found = learned(parameters, other_driving(parameters, vehicle, parameters.speeds_m_s[experiment]))
        fits += [(name, kind, *map(float, fit.unexplained)) for kind, fit in found.items()]
        plants = {"exact": bicycle_plant(vehicle), **{kind: fit.plant for kind, fit in found.items()}}
        for case, drive in cases.items():
            drives = {kind: drive(model=plant) for kind, plant in plants.items()}
            of_each = {kind: peaks(each) for kind, each in drives.items()}
            rows += _rows(name, case, of_each)
            worst = max(worst, *(_apart(of_each[kind], of_each["exact"]) for kind in found))
        panels.append(_panel(f"{name}: {experiment}, {case}", drives))
    platoon, control_errors = learned_table(parameters.recorded, parameters.seed)
    tables = (_errors_table(parameters, rows), _fits_table(fits), platoon)
    data = {"worst_apart": worst, "platoon_control_error_mm": control_errors}
    return Result(tables, (Figure("lateral-error", "Exact and learned bicycles", tuple(panels)),), data)


def _closed_curve() -> dict[str, Callable[..., Drive]]:
    """Return the drives of Table 1, of the model that the flow has."""
    p = load_parameters(closed_curve.ClosedCurveParameters, SHIPPED / "paper" / "closed-curve.yaml")
    track = p.track.reference()
    return {f"{v:g} km/h": partial(closed_curve.driven, p, track, v) for v in p.speeds_km_h}


def _changes() -> dict[str, Callable[..., Drive]]:
    """Return the drives of Table 2."""
    p = load_parameters(lane_change.LaneChangeParameters, SHIPPED / "paper" / "lane-change.yaml")
    return {
        f"{reading.name}, {v:g} m/s": partial(lane_change.driven, p, p.reference(reading), v, reading.flow)
        for reading in p.readings
        for v in p.speeds_m_s
    }


def _errors_table(p: ModelFreeParameters, rows: list[tuple[Cell, ...]]) -> Table:
    notes = (
        f"learned from {p.duration_s:g} s of other driving, sampled every {p.sample_s:g} s; known: the position's rate "
        "is the body's velocity, the heading's is the yaw rate",
        f"polynomial: degree {p.degree}, ridge regression; network: {p.hidden} hidden tanh",
    )
    columns, formats = ("table", "drive", "peak", "exact", "polynomial", "network"), ("", "", "", ".2f", ".2f", ".2f")
    return Table("Tables 1 and 2 with a bicycle that is learned", columns, tuple(rows), notes, formats)


def _fits_table(rows: list[tuple[Cell, ...]]) -> Table:
    columns = ("table", "fit", "v_l' [m/s²]", "v_n' [m/s²]", "yaw rate' [rad/s²]")
    title = "What the learned rates leave unexplained, root mean square"
    return Table(title, columns, tuple(rows), (), ("", "", ".2g", ".2g", ".2g"))


def _rows(table: str, case: str, found: dict[str, Peaks]) -> list[tuple[Cell, ...]]:
    return [
        (table, case, "lateral, cm", *(each.lateral_cm for each in found.values())),
        (table, case, "heading, deg", *(each.heading_deg for each in found.values())),
    ]


def _apart(found: Peaks, exact: Peaks) -> float:
    """Return how far the errors are from those with the exact model, relative."""
    return max(abs(found.lateral_cm / exact.lateral_cm - 1.0), abs(found.heading_deg / exact.heading_deg - 1.0))


def _panel(title: str, drives: dict[str, Drive]) -> Panel:
    exact = drives["exact"]
    curves = [Curve(kind, each.along, 1e2 * each.lateral) for kind, each in drives.items() if each is not exact]
    curves.append(Curve("exact", exact.along, 1e2 * exact.lateral, "dashed"))
    shown = tuple(replace(c, x=c.x[c.x <= _DRAWN_M], y=c.y[c.x <= _DRAWN_M]) for c in curves)
    return Panel("distance along the curve, m", "lateral error, cm", shown, title)

"""How much delay that nobody knows of a loop bears, over its horizon: as predicted, and in nonlinear simulation."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.core.arrays import Array
from robofleet.core.settings import Model, Positive
from robofleet.experiments.growth import delay_border, flow_growth, robot_growth
from robofleet.experiments.results import Cell, Curve, Figure, Map, Panel, Table
from robofleet.runs.margins import robot_loop

Range = Annotated[tuple[Positive, Positive], Field(strict=False)]

_ROBOT_S = 30.0  # of a robot's simulation
_POINTS = 40  # of a curve


class DelayParameters(Model):
    """The map over (T, unknown delay)."""

    horizon_s: Range
    simulated: int = Field(ge=2, le=100)
    alpha_1_s: Positive
    step_s: Positive
    config: str
    speed_m_s: Positive


class _Loop(NamedTuple):
    name: str
    margin: Callable[[float], float]  # of the horizon [s]
    growth: Callable[[float, float], float]  # of the horizon and the delay [s]


def delay_borders(p: DelayParameters, systems: Sequence[tuple[str, Plant, Array]]) -> tuple[Table, Figure]:
    """Return the table and the map of flows on plants that move straight from x with u = 0, and of a robot."""
    loops = [*(_of_flow(p, *system) for system in systems), _of_robot(p)]
    few, many = np.geomspace(*p.horizon_s, p.simulated), np.geomspace(*p.horizon_s, _POINTS)
    rows: list[tuple[Cell, ...]] = []
    panels = []
    for loop in loops:
        predicted = np.array([loop.margin(T) for T in few])
        simulated = np.array([delay_border(partial(loop.growth, T), m) for T, m in zip(few, predicted, strict=True)])
        apart = 100.0 * (predicted / simulated - 1.0)
        rows += [
            (loop.name, *map(float, row)) for row in zip(few, 1e3 * predicted, 1e3 * simulated, apart, strict=True)
        ]
        panels.append(_panel(loop, many, (few, simulated)))
    notes = (
        f"bicycle, pendulum: alpha {p.alpha_1_s:g} 1/s, step {p.step_s:g} s, exact integrator; "
        f"robot: configs/{p.config}.yaml at {p.speed_m_s:g} m/s, its filter and its motor lag included",
        "predicted: the spectral radius of the linearised loop reaches one; simulated: a small error grows",
    )
    columns = ("loop", "T [s]", "predicted [ms]", "simulated [ms]", "apart [%]")
    title, formats = "The least unknown delay that makes the loop unstable", ("", ".3f", ".1f", ".1f", ".2f")
    table = Table(title, columns, tuple(rows), notes, formats)
    return table, Figure("delay", "Stable horizons and unknown delays (blue)", tuple(panels))


def _panel(loop: _Loop, horizons: Array, simulated: tuple[Array, Array]) -> Panel:
    border = 1e3 * np.array([loop.margin(T) for T in horizons])
    limits = (1e2 * horizons[0], 1e3 * horizons[-1])
    delays = np.geomspace(*limits, 10 * _POINTS)
    stable = Map(horizons, delays, np.where(delays[:, None] < border, 0.4, 0.0))
    shown = np.where(border > 0.0, border, np.nan)
    curves = (
        Curve("predicted", horizons, shown),
        Curve("simulated", simulated[0], 1e3 * simulated[1], "dots"),
    )
    return Panel("horizon T [s]", "unknown delay [ms]", curves, loop.name, stable, ("log", "log"), y_limits=limits)


def _of_flow(p: DelayParameters, name: str, plant: Plant, x: Array) -> _Loop:
    def flow(T: float) -> NewtonRaphsonFlow:
        return NewtonRaphsonFlow(plant, FlowSettings(p.alpha_1_s, T, p.step_s), np.zeros(plant.m))

    def growth(T: float, delay: float) -> float:
        return flow_growth(flow(T), plant, x, 300.0 / p.alpha_1_s + 100.0 * delay, delay)

    return _Loop(f"{name}, alpha {p.alpha_1_s:g}", lambda T: flow(T).margins(x, np.zeros(plant.m)).delay, growth)


def _of_robot(p: DelayParameters) -> _Loop:
    base = load_config(SHIPPED / f"{p.config}.yaml")
    robot = base.members[0]

    title = f"robot, {p.speed_m_s:g} m/s, alpha {base.controller.alpha:g}"

    def config(T: float) -> Config:
        return base.model_copy(update={"controller": base.controller.model_copy(update={"horizon_s": T})})

    def growth(T: float, delay: float) -> float:
        return robot_growth(config(T), robot, p.speed_m_s, _ROBOT_S * (1.0 + delay), delay)

    return _Loop(title, lambda T: robot_loop(config(T), robot, p.speed_m_s).margins().delay, growth)

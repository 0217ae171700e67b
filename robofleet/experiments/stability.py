"""Where the closed loop is stable: maps over (alpha, T) and (alpha, step), and the boundary T_alpha (eq. 15).

The double integrator x1' = x2, x2' = u, y = x1 has g = x1 + T x2 + T^2 / 2 u; its loop in continuous time has the
polynomial s^3 + alpha s^2 + (2 alpha / T) s + 2 alpha / T^2, which by Routh is stable for T > T_alpha = 1 / alpha.

A control step of the real controller and its plant is a map of (x, u) onto itself; its Jacobian about straight motion
(position counted from the reference) by central differences has the spectral radius that the maps show.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
from pydantic import Field

from robofleet.config.faults import Complaint
from robofleet.config.files.parameters import Parameters
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowError, FlowSettings, Integrator, NewtonRaphsonFlow, Plant
from robofleet.control.prediction import compile_plant
from robofleet.core.arrays import Array
from robofleet.core.settings import Positive
from robofleet.experiments.delay_borders import DelayParameters, Range, delay_borders
from robofleet.experiments.results import Cell, Curve, Figure, Map, Panel, Result, Table
from robofleet.vehicles.bicycle import FALCONE_2007

_GRAVITY, _LENGTH, _DAMPING = 9.81, 0.5, 0.2  # of the pendulum [m/s^2, m, 1/s]
_INTEGRATORS: tuple[Integrator, ...] = ("exact", "euler")


class StabilityParameters(Parameters):
    """What configs/paper/stability.yaml holds."""

    points: int = Field(ge=2, le=400)
    alpha_1_s: Range
    horizon_s: Range
    step_s: Range
    step_map_horizon_s: Positive
    boundary_alphas_1_s: tuple[Positive, ...] = Field(min_length=1, strict=False)
    boundary_alpha_step: float = Field(gt=0, lt=1)
    simulated_alpha_t: Positive
    bicycle_speeds_m_s: tuple[Positive, ...] = Field(min_length=1, strict=False)
    unknown_delay: DelayParameters

    def complaints(self) -> Iterator[Complaint]:
        for name in ("alpha_1_s", "horizon_s", "step_s"):
            low, high = getattr(self, name)
            if low >= high:
                yield name, f"the first number must be below the second, got {low:g} and {high:g}"


def _double_slope(x: Array, u: Array) -> Array:
    return np.array([x[1], u[0]])


def _double_output(x: Array) -> Array:
    return x[:1].copy()


DOUBLE_INTEGRATOR = Plant(_double_slope, _double_output, 2, 1)


def _pendulum_slope(x: Array, u: Array) -> Array:
    return np.array([x[1], _GRAVITY / _LENGTH * math.sin(x[0]) - _DAMPING * x[1] + u[0]])


INVERTED_PENDULUM = Plant(_pendulum_slope, _double_output, 2, 1)  # angle from upright [rad], its rate; u [rad/s^2]


def spectral_radius(plant: Plant, settings: FlowSettings, x: Array) -> float:
    """Return the spectral radius of a control step about straight motion from x (n,); infinite where it is refused.

    x must move straight with u = 0, its velocity being f(x, 0).
    """
    try:
        return NewtonRaphsonFlow(plant, settings, np.zeros(plant.m)).loop(x, np.zeros(plant.m)).spectral_radius()
    except FlowError:
        return np.inf


def boundary(radius: Callable[[float], float], low: float, high: float) -> float:
    """Return where ``radius`` falls below 1 (or rises above it) between low and high, by bisection of the logarithm."""
    unstable_low = radius(low) > 1.0
    if unstable_low == (radius(high) > 1.0):
        return np.nan
    while high / low > 1.0001:
        middle = np.sqrt(low * high)
        if (radius(middle) > 1.0) == unstable_low:
            low = middle
        else:
            high = middle
    return float(np.sqrt(low * high))


def simulated_growth(plant: Plant, settings: FlowSettings, duration: float) -> float:
    """Return how much larger |x| is in the last tenth of a simulation than in the third, after a push of x[0]."""
    flow, rollout = NewtonRaphsonFlow(plant, settings, np.zeros(plant.m)), compile_plant(plant).rollout
    x, target, none = np.zeros(plant.n), np.zeros(plant.m), np.zeros(plant.n)
    x[0] = 1e-3
    sizes = np.empty(round(duration / settings.step))
    for k in range(len(sizes)):
        rollout(x, flow.update(x, target), none, settings.step, x)
        sizes[k] = abs(x[0])
    tenth = len(sizes) // 10
    return float(sizes[-tenth:].max() / sizes[2 * tenth : 3 * tenth].max())


def run(parameters: StabilityParameters) -> Result:
    """Draw the maps; find T_alpha for every alpha and plant."""
    p = parameters
    systems: list[tuple[str, Plant, Array]] = [("double integrator", DOUBLE_INTEGRATOR, np.zeros(2))]
    for v in p.bicycle_speeds_m_s:
        systems.append((f"bicycle, {v:g} m/s", bicycle_plant(FALCONE_2007), np.array([0.0, 0.0, v, 0.0, 0.0, 0.0])))
    horizons = _boundaries(p, systems)
    steps, found_steps = _step_limits(p, systems)
    deviation = max(abs(float(row[3] or np.nan) - 1.0) for row in horizons.rows if row[0] == systems[0][0])
    delays, delay_map = delay_borders(
        p.unknown_delay, [("inverted pendulum", INVERTED_PENDULUM, np.zeros(2)), systems[-1]]
    )
    figures = (_horizon_maps(p, systems), _step_maps(p, systems, found_steps), delay_map)
    return Result((horizons, _simulated(p), steps, delays), figures, {"double_integrator_deviation": deviation})


def _boundaries(p: StabilityParameters, systems: list[tuple[str, Plant, Array]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name, plant, x in systems:
        for alpha in p.boundary_alphas_1_s:
            step = p.boundary_alpha_step / alpha

            def radius(T: float, plant: Plant = plant, x: Array = x, alpha: float = alpha, step: float = step) -> float:
                return spectral_radius(plant, FlowSettings(alpha, T, step), x)

            found = boundary(radius, 0.2 / alpha, 10.0 / alpha)
            rows.append((name, alpha, _cell(found), _cell(found * alpha)))
    notes = (
        "Double integrator: T_alpha = 1 / alpha exactly, so that alpha T_alpha = 1. "
        f"Sought with alpha step = {p.boundary_alpha_step:g}, exact integrator.",
    )
    columns = ("plant", "alpha [1/s]", "T_alpha [s]", "alpha T_alpha")
    return Table("Smallest stable horizon (eq. 15)", columns, tuple(rows), notes, ("", "g", ".5f", ".4f"))


def _simulated(p: StabilityParameters) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for alpha in p.boundary_alphas_1_s:
        for share in (0.98, 1.02):
            settings = FlowSettings(alpha, share / alpha, 0.02 / alpha)
            growth = simulated_growth(DOUBLE_INTEGRATOR, settings, p.simulated_alpha_t / alpha)
            rows.append((alpha, share, growth, "unstable" if growth > 1.0 else "stable"))
    columns = ("alpha [1/s]", "alpha T", "growth", "simulated")
    notes = ("Growth of |x1| from the third to the last tenth of the simulation.",)
    return Table("Double integrator, simulated beside its boundary", columns, tuple(rows), notes, ("g", "g", ".3f", ""))


def _step_limits(
    p: StabilityParameters, systems: list[tuple[str, Plant, Array]]
) -> tuple[Table, dict[tuple[str, Integrator], Array]]:
    """Return the longest stable control steps: a table, and over the map's alphas (N,) where there is one, else NaN."""
    alphas, found = _grid(p.alpha_1_s, p.points), {}
    rows: list[tuple[Cell, ...]] = []
    for name, plant, x in systems:
        for integrator in _INTEGRATORS:
            found[name, integrator] = np.array([_longest_step(p, plant, x, alpha, integrator) for alpha in alphas])
            for alpha in p.boundary_alphas_1_s:
                step = _longest_step(p, plant, x, alpha, integrator)
                rows.append((name, integrator, alpha, _cell(step), _cell(alpha * step)))
    columns = ("plant", "integrator", "alpha [1/s]", "longest step [s]", "alpha step")
    notes = (
        f"T = {p.step_map_horizon_s:g} s; '-': no boundary between {p.step_s[0]:g} and {p.step_s[1]:g} s. "
        "Forward Euler is refused from alpha step = 2 on.",
    )
    formats = ("", "", "g", ".4f", ".3f")
    return Table("Longest stable control step", columns, tuple(rows), notes, formats), found


def _longest_step(p: StabilityParameters, plant: Plant, x: Array, alpha: float, integrator: Integrator) -> float:
    def radius(step: float) -> float:
        return spectral_radius(plant, FlowSettings(alpha, p.step_map_horizon_s, step, integrator), x)

    return boundary(radius, *p.step_s)


def _horizon_maps(p: StabilityParameters, systems: list[tuple[str, Plant, Array]]) -> Figure:
    alphas, panels = _grid(p.alpha_1_s, p.points), []
    for name, plant, x in systems:
        curves = (Curve("T = 1 / alpha", alphas, 1.0 / alphas), Curve("T = 3 / alpha", alphas, 3.0 / alphas, "dashed"))
        field = _map(p, p.horizon_s, plant, x, lambda alpha, T: FlowSettings(alpha, T, p.boundary_alpha_step / alpha))
        panels.append(Panel("alpha [1/s]", "T [s]", curves, name, field, ("log", "log"), y_limits=p.horizon_s))
    return Figure("horizon", "Stable speed-ups and horizons", tuple(panels))


def _step_maps(
    p: StabilityParameters, systems: list[tuple[str, Plant, Array]], found: dict[tuple[str, Integrator], Array]
) -> Figure:
    alphas, panels = _grid(p.alpha_1_s, p.points), []
    for name, plant, x in (systems[0], systems[-1]):
        for integrator in _INTEGRATORS:

            def settings(alpha: float, step: float, integrator: Integrator = integrator) -> FlowSettings:
                return FlowSettings(alpha, p.step_map_horizon_s, step, integrator)

            curves = (
                Curve("boundary", alphas, found[name, integrator]),
                Curve("step = 2 / alpha", alphas, 2.0 / alphas, "dashed"),
            )
            field, title = _map(p, p.step_s, plant, x, settings), f"{name}, {integrator}"
            panels.append(Panel("alpha [1/s]", "step [s]", curves, title, field, ("log", "log"), y_limits=p.step_s))
    return Figure("step", f"Stable control steps at T = {p.step_map_horizon_s:g} s", tuple(panels))


def _map(
    p: StabilityParameters, limits: tuple[float, float], plant: Plant, x: Array,
    settings: Callable[[float, float], FlowSettings],
) -> Map:  # fmt: skip
    """Return where a control step is stable, over alpha and what the limits are of."""
    alphas, values = _grid(p.alpha_1_s, p.points), _grid(limits, p.points)
    stable = [[spectral_radius(plant, settings(alpha, value), x) <= 1.0 for alpha in alphas] for value in values]
    return Map(alphas, values, np.array(stable, dtype=np.float64))


def _grid(limits: tuple[float, float], points: int) -> Array:
    return np.geomspace(*limits, points)


def _cell(value: float) -> float | None:
    return value if np.isfinite(value) else None

"""Tables and figures of the comparison; its notes say, from the numbers, where which controller is better."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from robofleet.experiments.baselines.choice import Key
from robofleet.experiments.baselines.problem import Drive
from robofleet.experiments.comparison_results import CORNER, NOISE, Compared, ComparisonParameters
from robofleet.experiments.results import Cell, Curve, Figure, Panel, Table

Found = Mapping[Key, Compared]
_LOST = "lost"
_LEVEL_SHARE = 0.02  # closer than this is level
_PEAKS = "lateral cm", "heading deg", "steering rate deg/s"
_SHOWN = ("flow-paper", "flow", "lqr", "osqp", "stanley")


def tables(parameters: ComparisonParameters, found: Found, missing: Mapping[Key, str]) -> tuple[Table, ...]:
    """Return errors, cost, trouble and corner."""
    return (_errors(parameters, found, missing), _cost(found), _trouble(parameters, found), _corner(parameters, found))


def figures(parameters: ComparisonParameters, found: Found) -> tuple[Figure, ...]:
    """Return the lateral error along the fastest lane change, and error over cost."""
    fastest, speed = parameters.fastest, max(parameters.speeds_m_s)
    drives = [(result.name, result.drives[fastest]) for key, result in found.items() if key in _SHOWN]
    lateral = tuple(Curve(name, speed * d.t, 100.0 * d.lateral) for name, d in drives)
    close = tuple(curve for curve in lateral if np.abs(curve.y).max() < 3.0)
    panels = tuple(
        Panel("distance along the curve, m", "lateral error, cm", curves, title)
        for curves, title in ((lateral, "all"), (close, "those within 3 cm"))
        if curves
    )
    points = tuple(
        Curve(result.name, np.array([_median_us(result)]), np.array([peak]), "dots")
        for result in found.values()
        if not math.isnan(peak := result.drives[fastest].peak_lateral_cm)
    )
    cost = Panel("time per update, median, µs", "peak lateral error, cm", points, scales=("log", "log"))
    return (
        Figure("lateral-error", f"Lane change at {fastest}: lateral error", panels),
        Figure("cost", f"Lane change at {fastest}: error over computing time", (cost,)),
    )


def _errors(parameters: ComparisonParameters, found: Found, missing: Mapping[Key, str]) -> Table:
    speeds, fastest, mpc = list(parameters.lane_changes), parameters.fastest, parameters.laws.mpc
    rows = []
    for result in found.values():
        drives = [result.drives[speed] for speed in speeds]
        peaks = zip(*map(_peaks, drives), strict=True)
        rows.append((result.name, *(cell for cells in peaks for cell in cells)))
    columns = ("controller", *(f"{peak}, {speed}" for peak in _PEAKS for speed in speeds))
    notes = (
        _statement(parameters),
        f"NR flow: {parameters.laws.flow_paper} is the paper's, driven as printed; {parameters.laws.flow} is ours",
        f"LTV-MPC: linear-time-varying; MPC: nonlinear; horizon {mpc.horizon_s:g} s, {mpc.nodes} nodes, cost "
        f"|z - r|² + {mpc.acceleration_weight:g} Δa² + {mpc.steering_weight:g} Δδ² a node, "
        f"sharp: {mpc.sharp:g} of both weights; they trade error for nervousness, as T of the flow does",
        f"the flow is level with predictive control of these weights and nodes {1e3 * mpc.horizon_s / mpc.nodes:g} ms "
        "apart alone: sharp ones are more accurate than it",
        "LQR, pure pursuit, Stanley: gains set by hand for these speeds and this vehicle",
        *_ranked(found, _lateral(fastest), f"peak error at {fastest}", "cm"),
        *(f"{key} is left out: {reason}" for key, reason in missing.items()),
        *_lost(found, speeds),
    )
    formats = ("", *(".2f" for _ in speeds), *(".2f" for _ in speeds), *(".1f" for _ in speeds))
    return Table("Lane change as printed, peak errors", columns, tuple(rows), notes, formats)


def _cost(found: Found) -> Table:
    ours = _median_us(found["flow"])
    rows = []
    for result in found.values():
        assert result.updates is not None
        p50, p99 = result.updates.p50, float(np.quantile(result.updates.warm, 0.99))
        first = float(np.median(result.updates.first))
        rows.append((result.name, p50, p99, p50 / ours, first, result.cold_ms, float(result.failures)))
    notes = (
        "through each Python API, the reference's look-up included, no roll-forward; the states of the NR flow's "
        "fastest lane change, in turns, so that a busy machine is shared by all",
        "first in a turn: the median just after the other controllers', which have emptied the processor's caches",
        "cold: importing its library, building it, its first update; compiling counts where it is not on disk yet, "
        "casadi's import for the first that uses it; -: shares its code with one above",
        "gave up: updates of the undisturbed lane changes whose solver did not converge; its last iterate was used",
        *_ranked(found, _median_us, "time per update", "µs"),
        *_ranked(found, lambda result: math.nan if result.cold_ms is None else result.cold_ms, "cold start", "ms"),
    )
    columns = ("controller", "p50 µs", "p99 µs", "p50 over flow's", "first in a turn, µs", "cold ms", "gave up")
    return Table("Time per update", columns, tuple(rows), notes, ("", ".1f", ".1f", ".3g", ".1f", ".0f", ".0f"))


def _trouble(parameters: ComparisonParameters, found: Found) -> Table:
    trouble, cases = parameters.trouble, parameters.troubles
    left_out = ", ".join(result.name for result in found.values() if NOISE not in result.drives)
    found = {key: result for key, result in found.items() if NOISE in result.drives}
    rows = []
    for result in found.values():
        lateral = (_cell(result.drives[case].peak_lateral_cm) for case in cases)
        rows.append((result.name, *lateral, _cell(result.drives[NOISE].peak_steering_rate_deg_s)))
    columns = ("controller", *cases, "noise, deg/s")
    notes = (
        f"peak lateral error [cm] at {trouble.speed_m_s:g} m/s; one thing at a time; rolled: state and time rolled "
        "forward over the delay by the believed model: the flow does it itself, the others by the same means",
        f"noise: {100 * trouble.position_noise_m:g} cm (1 sigma) on each measured coordinate, unfiltered; "
        "deg/s: peak steering rate in it",
        f"soft tyres: {100 * (trouble.stiffness - 1):+.0f} % of stiffness in the plant, not in what is believed",
        *([f"{left_out}: left out for its time: the problem is that of the other nonlinear MPC"] if left_out else []),
        *(note for case in cases for note in _ranked(found, _lateral(case), case, "cm")),
        *_ranked(
            found, lambda result: result.drives[NOISE].peak_steering_rate_deg_s, "steering rate in noise", "deg/s"
        ),
        *_lost(found, cases),
    )
    formats = ("", *(".2f" for _ in cases), ".0f")
    return Table("What goes wrong, peak lateral error", columns, tuple(rows), notes, formats)


def _corner(parameters: ComparisonParameters, found: Found) -> Table:
    rows = tuple((result.name, *_peaks(result.drives[CORNER])) for result in found.values())
    where = parameters.closed_curve
    notes = (
        f"the first {where.drive_m:g} m of the closed curve, which is ours: one corner of "
        f"{where.track.corner_radius_m:g} m, its others are the same; delay as above",
        *_ranked(found, _lateral(CORNER), "peak error", "cm"),
        *_lost(found, [CORNER]),
    )
    columns = ("controller", *_PEAKS)
    title = f"Closed curve at {where.speed_km_h:g} km/h, peak errors"
    return Table(title, columns, rows, notes, ("", ".2f", ".2f", ".1f"))


def _statement(parameters: ComparisonParameters) -> str:
    return (
        f"control step {parameters.control_step_s:g} s with zero-order hold, computing delay "
        f"{parameters.computing_delay_s:g} s, rolled forward by all but the paper's law; plant: RK4, "
        f"{1e3 * parameters.plant_step_s:g} ms; stopped at {parameters.drive_m:g} m: the manoeuvre ends after 110 m"
    )


def _ranked(found: Found, value: Callable[[Compared], float], what: str, unit: str) -> Iterator[str]:
    """Yield in words which baselines are better than the flow, that is lower, and by what numbers."""
    ours = value(found["flow"])
    others = [(result.name, value(result)) for key, result in found.items() if key not in {"flow", "flow-paper"}]
    limit = math.inf if math.isnan(ours) else ours * (1.0 - _LEVEL_SHARE)
    better = sorted((v, name) for name, v in others if v < limit)
    if not others:
        return
    flow = f"our flow is {_LOST}" if math.isnan(ours) else f"our flow ({ours:.3g} {unit})"
    if better:
        names = ", ".join(f"{name} ({v:.3g})" for v, name in better)
        yield f"{what}: better than {flow}: {names}" if not math.isnan(ours) else f"{what}: {flow}, not so: {names}"
    else:
        yield f"{what}: no baseline is better than {flow}"


def _lost(found: Found, cases: Sequence[str]) -> Iterator[str]:
    """Yield how each lost vehicle was lost."""
    for result in found.values():
        ends = [f"{case} {result.drives[case].failure}" for case in cases if result.drives[case].failure]
        if ends:
            yield f"{result.name}: {_LOST}: {'; '.join(ends)}"


def _lateral(case: str) -> Callable[[Compared], float]:
    return lambda result: result.drives[case].peak_lateral_cm


def _peaks(found: Drive) -> tuple[Cell, Cell, Cell]:
    """Return a drive's cells below ``_PEAKS``."""
    return _cell(found.peak_lateral_cm), _cell(found.peak_heading_deg), _cell(found.peak_steering_rate_deg_s)


def _median_us(result: Compared) -> float:
    assert result.updates is not None
    return result.updates.p50


def _cell(value: float) -> Cell:
    return _LOST if math.isnan(value) else value

"""Every speed that the guides state, beside what a user would pick instead, in the same run.

    .venv/bin/python tools/bench.py [--json]

The machine is shared: each row takes turns between the candidates and gives medians, so trust the ratios.
"""

import argparse
import json
import statistics
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

from packages import needing

with needing("bench", "lab"):
    import bench_barrier
    import bench_scale
    import bench_tracker
    import cv2
    import numba
    import numpy as np
    from numpy.typing import NDArray

    from robofleet.behaviours.platoon import Platoon
    from robofleet.config.load import load_config
    from robofleet.config.slices import drive as drive_of
    from robofleet.config.tree import Config
    from robofleet.control.bicycle import bicycle_plant
    from robofleet.control.flow import NewtonRaphsonFlow, Plant
    from robofleet.control.path import nearest
    from robofleet.core.clock import S, stopwatch_ns
    from robofleet.experiments import closed_curve as track
    from robofleet.experiments import comparison, comparison_results, simulate
    from robofleet.experiments.baselines.choice import Key, MissingLibraryError, build
    from robofleet.experiments.baselines.problem import Conditions, Controller, Drive, Problem, drive
    from robofleet.experiments.paper import parameters_of
    from robofleet.runs.lockstep import Lockstep
    from robofleet.safety import gate
    from robofleet.vehicles.bicycle import ZHOU_2017, BicycleParameters

ROOT = Path(__file__).resolve().parents[1]
Row = dict[str, Any]
Candidates = dict[str, Callable[[], object]]


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object, and nothing else")
    as_json = parser.parse_args().json
    cv2.setNumThreads(1)
    config = load_config(ROOT / "configs" / "platoon.yaml")
    rows = [
        *bench_tracker.rows(),
        *nearest_points(config),
        *bicycle_updates(),
        *bench_barrier.rows(),
        *closed_curve(),
        *gate_steps(),
        *lockstep(),
        *bench_scale.rows(),
    ]
    if as_json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print(f"{row['what']:<58} {row['who']:<42} {row['value']:>9.4g} {row['unit']:<3} {row['ratio']:>8.3g} x")


def nearest_points(config: Config) -> list[Row]:
    """The nearest points of the path to four robots, exactly: this project's kernel, and numpy's roots."""
    path = Platoon.Settings.model_validate(config.groups[0].settings).path.path()
    points = np.random.default_rng(1).uniform((-1.5, -0.9), (1.5, 0.9), (4, 2))

    def kernel(near: float) -> list[float]:
        return [nearest(path.coefficients, x, y, near) for x, y in points.tolist()]

    def roots() -> list[float]:
        return [_nearest_by_roots(path.coefficients, point) for point in points]

    candidates: Candidates = {
        "robofleet, half a side around": lambda: kernel(0.3),
        "robofleet, whole path": lambda: kernel(np.nan),
        "numpy.roots, whole path": roots,
    }
    return _rows("exact nearest points of the path, 4 robots", candidates, 1e6, "us", 200)


def bicycle_updates() -> list[Row]:
    """One update on the lane change at 19 m/s: NR flow, our setting, and what a user would pick, call by call.

    Every candidate sees the same states, those of the flow's own drive; beside its name, its own drive's peak error.
    """
    parameters: comparison_results.ComparisonParameters = parameters_of("comparison")
    problem = parameters.lane_change(max(parameters.speeds_m_s))
    keys: tuple[Key, ...] = ("flow", "lqr", "osqp", "fatrop", "ipopt", "do-mpc")
    peaks: list[float] = []
    candidates: list[Controller] = []
    for key in keys:
        try:
            own = drive(problem, build(key, parameters.laws, problem, 0), Conditions(problem.model), parameters.drive_m)
            candidates.append(build(key, parameters.laws, problem, 0))
        except MissingLibraryError as missing:
            print(f"{missing}: its row is left out")
            continue
        peaks.append(own.peak_lateral_cm)
        if key == "flow":
            driven = own
    alone = _Alone(parameters, problem, driven, bicycle_plant(problem.model))
    general = _Alone(parameters, problem, driven, users_bicycle(problem.model))
    found = comparison.in_turns([alone, general, *candidates], driven.t, driven.states, parameters.turn)
    values = {alone.name: found[0].p50, "robofleet, the compiled step alone": alone.compiled_us(driven.states)}
    values["the same bicycle as a user's own f and h"] = found[1].p50
    values["robofleet, r(t + T) looked up"] = found[2].p50
    values["robofleet, the same, just after the others"] = statistics.median(found[2].first.tolist())
    for candidate, peak, updates in zip(candidates[1:], peaks[1:], found[3:], strict=True):
        values[f"{candidate.name}, {peak:.2f} cm"] = updates.p50
    what = f"update of the bicycle, NR flow {peaks[0]:.2f} cm, {problem.speed:g} m/s"
    return [_row(what, who, value, "us", value / found[0].p50) for who, value in values.items()]


def users_bicycle(model: BicycleParameters) -> Plant:
    """The same bicycle (eqs 16-23) as somebody writes it down: f and h in numpy, no Jacobian, nothing by hand."""
    m, inertia, l_f, l_r, stiff_f, stiff_r = model.numbers()

    def f(x: NDArray[np.float64], u: NDArray[np.float64]) -> NDArray[np.float64]:
        _, _, v_l, v_n, psi, rate = x
        front = stiff_f * (u[1] - np.arctan((v_n + l_f * rate) / v_l)) * np.cos(u[1])
        rear = -stiff_r * np.arctan((v_n - l_r * rate) / v_l)
        return np.array(
            [
                v_l * np.cos(psi) - v_n * np.sin(psi),
                v_l * np.sin(psi) + v_n * np.cos(psi),
                rate * v_n + u[0],
                -rate * v_l + 2 * (front + rear) / m,
                rate,
                2 * (l_f * front - l_r * rear) / inertia,
            ]
        )

    return Plant(f, lambda x: x[:2].copy(), 6, 2)


class _Alone:
    """``NewtonRaphsonFlow.update``, its references r(t + T) looked up before."""

    name = "robofleet, update(x, r)"

    def __init__(
        self, parameters: comparison_results.ComparisonParameters, problem: Problem, driven: Drive, plant: Plant
    ) -> None:
        law = parameters.laws.flow
        self._flow = NewtonRaphsonFlow(plant, law.settings(problem.step), (0.0, 0.0))
        self._references = problem.target(driven.t + law.horizon_s)
        self._step = problem.step

    def update(self, t: float, x: NDArray[np.float64]) -> Any:
        return self._flow.update(x, self._references[round(t / self._step)])

    def compiled_us(self, states: NDArray[np.float64]) -> float:
        """Return the median of one step inside compiled code [us]."""
        step, times = self._flow.compiled_step, []

        def steps(states: NDArray[np.float64], r: NDArray[np.float64], memory: NDArray[np.float64]) -> None:
            for k in range(len(states)):
                step(states[k], r[k], memory)

        compiled: Callable[..., None] = numba.njit(steps)  # type: ignore[assignment]
        compiled(states, self._references, self._flow.memory)
        for _ in range(100):
            started = stopwatch_ns()
            compiled(states, self._references, self._flow.memory)
            times.append((stopwatch_ns() - started) / len(states) / 1e3)
        return statistics.median(times)


def closed_curve() -> list[Row]:
    """100 s of the closed curve at 35 km/h, plant and NR flow, as printed and ours; the ratio is to real time."""
    parameters: track.ClosedCurveParameters = parameters_of("closed-curve")
    reference, loop, plant = parameters.track.reference(), parameters.loop(), bicycle_plant(ZHOU_2017)
    rows = []
    for who, law in (("paper's setting", parameters.flow), ("our setting", parameters.recommended)):
        settings, times = law.settings(parameters.control_step_s), []
        for _ in range(6):  # the first compiles
            started = stopwatch_ns()
            simulate.drive(plant, settings, loop, reference, max(parameters.speeds_km_h) / 3.6)
            times.append((stopwatch_ns() - started) / S)
        seconds = statistics.median(times[1:])
        what = f"{loop.duration:g} s of the closed curve, plant at {1e3 * loop.plant_step:g} ms"
        rows.append(_row(what, f"robofleet, {who}", seconds, "s", loop.duration / seconds))
    return rows


def gate_steps() -> list[Row]:
    """What every command costs on its way to the wheels; the ratio is to 20 us, what it may."""
    robot = load_config(ROOT / "configs" / "platoon.yaml").robots[0]
    drive, now = drive_of(robot), S
    state = gate.GateState(boot_id=1)
    gate.step(state, drive, gate.Inputs(lease=True, lease_session=1), now)
    costs: dict[str, list[int]] = {"command and enable": [], "command": [], "nothing": []}
    for k in range(1, 3001):
        both = gate.Inputs(
            command=True, command_epoch=1, command_session=1, command_seq=k, command_boot_id=1, command_nonce=now,
            command_left=3.0 + k % 2, command_right=4.0, permission=True, permission_epoch=1, permission_seq=k,
            permission_boot_id=1, permission_nonce=now, permission_limit=12.5,
        )  # fmt: skip
        for what, inputs in zip(costs, (both, replace(both, permission=False), gate.Inputs()), strict=True):
            after = copy(state)
            began = stopwatch_ns()
            gate.step(after, drive, inputs, now)
            costs[what].append(stopwatch_ns() - began)
            if inputs is both:
                following = after
        state, now = following, now + 5_000_000
    medians = {what: statistics.median(taken) / 1e3 for what, taken in costs.items()}
    return [_row("gate, one step", f"robofleet, {what}", cost, "us", cost / 20.0) for what, cost in medians.items()]


def lockstep() -> list[Row]:
    """A lap of the platoon in lockstep, as times real time."""
    rows = []
    for source in ("camera", "truth"):
        config = load_config(ROOT / "configs" / "platoon.yaml", [f"tracker.source={source}"])
        factors = []
        for _ in range(3):
            run = Lockstep(config)
            run.run()
            factors.append(config.run.duration_s / run.recording.elapsed_s)
        factor = statistics.median(factors)
        rows.append(_row(f"a lap in lockstep, tracker.source={source}", "robofleet", factor, "x", factor))
    return rows


def _nearest_by_roots(coefficients: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    best, best_distance = 0.0, np.inf
    for side, c in enumerate(coefficients):
        x, y = (np.polynomial.Polynomial(c[:, axis] - point[axis] * np.eye(4)[0]) for axis in (0, 1))
        squared = x * x + y * y
        roots = np.roots(squared.deriv().coef[::-1])
        inside = roots[np.abs(roots.imag) < 1e-9].real
        for s in (0.0, 1.0, *inside[(inside >= 0) & (inside <= 1)]):
            if squared(s) < best_distance:
                best, best_distance = side + float(s), squared(s)
    return best


def _rows(what: str, candidates: Candidates, scale: float, unit: str, rounds: int) -> list[Row]:
    """Time the candidates in turns; the ratio is to the first."""
    for run in candidates.values():
        run()
    times: dict[str, list[int]] = {who: [] for who in candidates}
    for _ in range(rounds):
        for who, run in candidates.items():
            started_ns = stopwatch_ns()
            run()
            times[who].append(stopwatch_ns() - started_ns)
    medians = {who: statistics.median(samples) / S * scale for who, samples in times.items()}
    first = next(iter(medians.values()))
    return [_row(what, who, value, unit, value / first) for who, value in medians.items()]


def _row(what: str, who: str, value: float, unit: str, ratio: float) -> Row:
    return {"what": what, "who": who, "value": value, "unit": unit, "ratio": ratio}


if __name__ == "__main__":
    main()

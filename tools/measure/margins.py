"""The margin of an unknown delay: as ``control/margins.py`` predicts it, and as nonlinear simulations have it.

Three plants, each with settings that are drawn: the shipped robot with its filter and the flow of its point ahead; the
paper's bicycle; an inverted pendulum about upright. Settings whose loop is unstable by itself are drawn again.

    python -m tools.measure.margins --settings 40 [--plants robot,bicycle,pendulum]
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.core.arrays import Array
from robofleet.experiments.growth import delay_border, flow_growth, robot_growth
from robofleet.experiments.stability import INVERTED_PENDULUM
from robofleet.runs.margins import robot_loop
from robofleet.vehicles.bicycle import FALCONE_2007
from tools.measure.program import program

_NEAR = 0.05  # relative

Case = tuple[str, float, float]  # what was drawn; the predicted and the simulated margin [s]


def main() -> None:
    options = program(
        __doc__, settings=(40, "settings of each plant"), plants="robot,bicycle,pendulum", seed=1
    ).parse_args()
    kinds: dict[str, Callable[[np.random.Generator], Iterator[Case]]] = {
        "robot": robots,
        "bicycle": lambda rng: flows(
            rng, bicycle_plant(FALCONE_2007), lambda: np.array([0.0, 0.0, rng.uniform(5, 30), 0, 0, 0])
        ),
        "pendulum": lambda rng: flows(rng, INVERTED_PENDULUM, lambda: np.zeros(2)),
    }
    apart: list[float] = []
    for name in options.plants.split(","):
        cases, found = kinds[name](np.random.default_rng(options.seed)), []
        for _ in range(options.settings):
            drawn, predicted, simulated = next(cases)
            found.append(abs(predicted / simulated - 1.0) if math.isfinite(simulated) else math.inf)
            print(
                f"{name:9} {drawn:75} {1e3 * predicted:7.1f} ms {1e3 * simulated:7.1f} ms {found[-1]:7.2%}", flush=True
            )
        apart += found
        print(f"{name}: {_summary(found)}", flush=True)
    print(f"all: {_summary(apart)}")


def robots(rng: np.random.Generator) -> Iterator[Case]:
    while True:
        alpha, T = _log(rng, 5, 80), _log(rng, 0.15, 1.0)
        tick, delay, l = _log(rng, 0.02, 0.05), rng.uniform(0, 0.06), _log(rng, 0.04, 0.12)
        speed, lag, disturbance = rng.uniform(0.03, 0.2), rng.uniform(0.02, 0.15), _any(rng, "none", "estimated")
        changes = [
            f"controller.{key}={value}"
            for key, value in {
                "alpha": alpha, "horizon_s": T, "tick_s": tick, "command_delay_s": delay, "point_ahead_m": l,
                "disturbance": disturbance, "integrator": _integrator(rng, alpha * tick),
            }.items()
        ]  # fmt: skip
        config = load_config(SHIPPED / "platoon.yaml", changes)
        vehicle = config.members[0].vehicle.model_copy(update={"motor_lag_s": lag})
        robot = config.members[0].model_copy(update={"vehicle": vehicle})
        margins = robot_loop(config, robot, speed).margins()
        if 0.0 < margins.delay < 1.0:
            duration = 30.0 + 60.0 * margins.delay
            border = delay_border(partial(robot_growth, config, robot, speed, duration), margins.delay)
            text = (
                f"alpha {alpha:4.1f} T {T:.3f} tick {tick:.3f} delay {delay:.3f} lag {lag:.3f} l {l:.3f} v {speed:.2f}"
            )
            yield f"{text} {disturbance}", margins.delay, border


def flows(rng: np.random.Generator, plant: Plant, start: Any) -> Iterator[Case]:
    while True:
        alpha, step, x = _log(rng, 5, 80), _log(rng, 0.003, 0.05), start()
        T = _log(rng, 1.5, 12) / alpha
        settings = FlowSettings(
            alpha, T, step, _integrator(rng, alpha * step), delay=rng.uniform(0, 0.1) * _any(rng, 0.0, 1.0),
            offset_free=_any(rng, False, True),
        )  # fmt: skip
        margins = NewtonRaphsonFlow(plant, settings, np.zeros(plant.m)).margins(x, np.zeros(plant.m))
        if 0.0 < margins.delay < math.inf:
            duration = 300.0 / alpha + 100.0 * (margins.delay + settings.delay)
            border = delay_border(partial(_flow_growth, plant, settings, x, duration), margins.delay)
            speed = f" v {x[2]:.1f}" if len(x) > 2 else ""
            text = f"alpha {alpha:4.1f} T {T:.3f} step {step:.3f} delay {settings.delay:.3f}{speed}"
            yield f"{text}{' offset-free' if settings.offset_free else ''}", margins.delay, border


def _flow_growth(plant: Plant, settings: FlowSettings, x: Array, duration: float, delay: float) -> float:
    return flow_growth(NewtonRaphsonFlow(plant, settings, np.zeros(plant.m)), plant, x, duration, delay)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _any(rng: np.random.Generator, *values: Any) -> Any:
    return values[int(rng.integers(len(values)))]


def _integrator(rng: np.random.Generator, alpha_step: float) -> Any:
    return "exact" if alpha_step > 1.5 else _any(rng, "exact", "euler")


def _summary(apart: list[float]) -> str:
    near = sum(a <= _NEAR for a in apart)
    within = f"{near} of {len(apart)} within {_NEAR:.0%} ({near / len(apart):.0%})"
    return f"{within}; median {np.median(apart):.2%}, largest {max(apart):.2%}"


if __name__ == "__main__":
    main()

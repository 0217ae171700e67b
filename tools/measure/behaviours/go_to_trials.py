"""Robots that go from random poses to random poses: 4, 10 and 20 of them on 3.2 x 2 m.

    python -m tools.measure.behaviours.go_to_trials [--robots 4 10 20] [--seeds 300] [--first 1] [--jobs 2]

Starts are at least 1.3 body diameters from each other, and so are goals; a disc of that diameter is inside the arena.
Nothing else is demanded of them. Everything but the behaviour is what a run has: the shipped robots with their faults,
poses with noise that are 99 ms old, the fleet filter, and the barrier with the parameters of ``configs/go-to.yaml``.
"""

import math
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from robofleet.behaviours.go_to import GoTo
from robofleet.behaviours.interface import Situation
from robofleet.config import groups, slices
from robofleet.config.tree import Config
from robofleet.control import wheels as commanding
from robofleet.core.arrays import Array
from robofleet.core.clock import S
from robofleet.nodes import fleet
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant
from tools.measure.behaviours import crossing
from tools.measure.program import program

CONFIGURATION = Path(__file__).parents[3] / "configs" / "go-to.yaml"
APART = 1.3  # body diameters
DELAY_TICKS = 3  # 99 ms
LONGEST_S = 240.0
POSITION, HEADING = 0.005, math.radians(3.0)
GAP = 0.01  # between two bodies, at least [m]
START_NS = 10 * S
ARMED_TICKS = 10  # before they may drive
ALONE = 2  # so many of the robots that have furthest to go are tried alone


@dataclass(frozen=True)
class Trial:
    seed: int
    arrived: bool
    seconds: float  # until all had arrived
    position: float  # largest error in the end [m]
    heading: float  # [rad]
    gap: float  # smallest distance between two bodies [m]
    alone: float = math.nan  # the slowest robot's time if nobody else is there [s]


def configuration(robots: int, *changes: str) -> Config:
    return crossing.configuration(robots, CONFIGURATION, changes)


def places(config: Config, count: int, rng: np.random.Generator) -> Array:
    radius = config.members[0].vehicle.body_radius_m
    half = np.array(config.arena.size_m) / 2 - APART * radius
    found: list[Array] = []
    while len(found) < count:
        at = rng.uniform(-half, half)
        if all(np.hypot(*(at - other[:2])) >= 2 * APART * radius for other in found):
            found.append(np.array([*at, rng.uniform(-math.pi, math.pi)]))
    return np.array(found)


def go(config: Config, starts: Array, goals: Array, seed: int, longest_s: float = LONGEST_S) -> Trial:
    """Drive from starts to goals (N, 3)."""
    rng, c, truth, n = np.random.default_rng([seed, 1]), config.controller, config.tracker.truth, len(starts)
    plants = [
        Plant(slices.drive(robot), slices.imperfections(robot), tuple(pose), rng)
        for robot, pose in zip(config.members, starts.tolist(), strict=True)
    ]
    named = {
        robot.id: {"x_m": x, "y_m": y, "heading_deg": math.degrees(psi)}
        for robot, (x, y, psi) in zip(config.members, goals.tolist(), strict=True)
    }
    team = replace(groups.team(config, config.groups[0]), rng=np.random.default_rng([seed, 2]))
    behaviour = GoTo(GoTo.Settings.model_validate({"goals": named}), team)
    estimate, barrier = fleet.fleet_filter(config), fleet.barrier(config)
    noise = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
    pairs, radius = np.triu_indices(n, 1), config.members[0].vehicle.body_radius_m
    images: list[Array] = []
    limits, of_body = commanding.limits(fleet.drives(config)), np.ones(n, dtype=np.bool_)
    wheels, gap, k = np.zeros((n, 2)), math.inf, 0
    poses = starts
    while k * c.tick_s < longest_s and not behaviour.arrived:
        tick_ns, newest = START_NS + k * round(c.tick_s * S), max(0, k - DELAY_TICKS)
        images.append(poses + noise * rng.normal(size=(n, 3)))
        estimate.observe(np.full(n, START_NS + newest * round(c.tick_s * S)), images[newest])
        _, predicted, turning = estimate.predict(tick_ns)
        before = wheels
        driving = np.full(n, k >= ARMED_TICKS)
        decision = behaviour.decide(
            Situation(
                t=k * c.tick_s, poses=predicted, driving=driving, disturbance=np.zeros((n, 2)), others=np.zeros((0, 3))
            )
        )
        request = commanding.limited(decision.velocities, of_body, predicted, c.point_ahead_m, limits, driving)
        unseen_s = (tick_ns - estimate.measured_ns) / S
        wheels, u, _, _ = barrier.filter(predicted, turning, unseen_s, driving, request.wheels, request.u)
        behaviour.changed(u)
        estimate.command(tick_ns, wheels)
        for i, plant in enumerate(plants):
            plant.step(WheelSpeeds(*before[i].tolist()), c.command_delay_s)
            plant.step(WheelSpeeds(*wheels[i].tolist()), c.tick_s - c.command_delay_s)
        poses = np.array([plant.truth()[:3] for plant in plants])
        if n > 1:
            apart = np.linalg.norm(poses[pairs[0], :2] - poses[pairs[1], :2], axis=1)
            gap = min(gap, float(apart.min()) - 2 * radius)
        k += 1
    position = float(np.hypot(*(poses - goals)[:, :2].T).max())
    heading = float(np.abs((poses - goals)[:, 2] - math.tau * np.round((poses - goals)[:, 2] / math.tau)).max())
    there_now = behaviour.arrived and position <= POSITION and heading <= HEADING
    return Trial(seed, there_now, k * c.tick_s, position, heading, gap)


def trial(robots: int, seed: int) -> Trial:
    """Drive one random trial, and the robots that have furthest to go alone."""
    config, rng = configuration(robots), np.random.default_rng(seed)
    starts, goals = places(config, robots, rng), places(config, robots, rng)
    together = go(config, starts, goals, seed)
    furthest = np.argsort(-np.hypot(*(goals - starts)[:, :2].T))[:ALONE]
    first_seed = configuration(1)
    alone = max(go(first_seed, starts[i : i + 1], goals[i : i + 1], seed).seconds for i in furthest)
    return Trial(**{**vars(together), "alone": alone})


def table(robots: int, trials: Sequence[Trial]) -> str:
    seconds, alone = (np.array([getattr(result, key) for result in trials]) for key in ("seconds", "alone"))
    gaps = [result.gap for result in trials]
    missing = [result.seed for result in trials if not result.arrived]
    close = [result.seed for result in trials if result.gap < GAP]
    return "\n".join(
        [
            f"{robots} robots, {len(trials)} seeds",
            f"  arrived within 5 mm and 3 degrees  {len(trials) - len(missing)} {f'not {missing}' if missing else ''}",
            f"  largest errors                     {max(result.position for result in trials) * 1e3:.1f} mm, "
            f"{math.degrees(max(result.heading for result in trials)):.2f} degrees",
            f"  smallest gap                       {min(gaps) * 1e3:.1f} mm (median {np.median(gaps) * 1e3:.1f} mm) "
            f"{f'below 10 mm: {close}' if close else ''}",
            f"  time                               median {np.median(seconds):.1f} s, longest {seconds.max():.1f} s",
            f"  slowest robot alone                median {np.median(alone):.1f} s",
            f"  ratio                              of medians {np.median(seconds) / np.median(alone):.2f}, "
            f"median {np.median(seconds / alone):.2f}, largest {np.max(seconds / alone):.2f}",
        ]
    )


def main() -> None:
    parser = program(__doc__, seeds=300, first=1, jobs=2)
    parser.add_argument("--robots", type=int, nargs="+", default=[4, 10, 20])
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for robots in arguments.robots:
            found = []
            for result in pool.map(partial(trial, robots), seeds):
                found.append(result)
                if not result.arrived or result.gap < GAP:
                    print(f"{robots} robots: {result}", file=sys.stderr, flush=True)
            print(table(robots, found), flush=True)


if __name__ == "__main__":
    main()

"""Eight robots that change places through the middle of the arena, seen 99 ms late; one of them stalls on the way.

    python -m tests.safety.crossing [--seeds 100] [--first 1]

Everything but the law is what a run has: the shipped robots with their faults, the truth source's noise, the fleet
filter, the barrier as the shipped platoon's configuration derives it. Nobody is told of the stall.
"""

import argparse
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import MS, S
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.processes.fleet import barrier, fleet_filter
from robofleet.vehicles.differential_drive import body_from_point, feasible_ratio, wheels_from_body
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant

Array = NDArray[np.float64]

PLATOON = Path(__file__).parents[2] / "configs" / "platoon.yaml"
ROBOTS, SECONDS = 8, 60.0
DELAY_TICKS = 3  # of 33 ms
CIRCLE = 0.8  # radius on which they start [m]
ARRIVED = 0.02  # from the goal [m]
START_NS = 10 * S


@dataclass(frozen=True)
class Crossing:
    """What came of one."""

    gap: float  # smallest distance between two bodies [m]
    inside: float  # smallest distance of a body from the arena's edge [m]
    arrived: int  # robots at their goals at the end
    moving: int  # robots that did not stall
    no_answer: int  # ticks
    compute_us: float


def configuration() -> Config:
    """Return the shipped platoon's configuration, with eight of its robots on a circle."""
    robots = [
        f"{{id: r{k}, tag: {k}, vehicle: gternal, start: {{x_m: 0, y_m: 0, heading_deg: 0}}}}" for k in range(1, 9)
    ]
    names = [f"r{k}" for k in range(1, 9)]
    return load_config(
        PLATOON,
        [f"robots=[{', '.join(robots)}]", f"groups.0.robots=[{', '.join(names)}]", *os.environ.get("OV", "").split()],
    )


def cross(config: Config, seed: int, *, stalled: bool = True) -> Crossing:
    """Drive one crossing."""
    rng = np.random.default_rng(seed)
    angle = np.arange(ROBOTS) * math.tau / ROBOTS + rng.uniform(-0.1, 0.1, ROBOTS)
    starts = CIRCLE * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    heading = angle + math.pi + rng.uniform(-0.3, 0.3, ROBOTS)
    plants = [
        Plant(slices.drive(r), slices.imperfections(r.vehicle), (*starts[i].tolist(), float(heading[i])), rng)
        for i, r in enumerate(config.platoon)
    ]
    frozen, stall_s = int(rng.integers(ROBOTS)), rng.uniform(1.0, 12.0) if stalled else math.inf
    fleet, shield = fleet_filter(config), barrier(config)
    tick_ns = round(config.controller.tick_s * S)
    truth, noise = config.tracker.truth, np.empty(3)
    noise = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
    delay_s = config.controller.command_delay_s
    images: list[Array] = []
    wheels = np.zeros((ROBOTS, 2))
    radius = config.platoon[0].vehicle.body_radius_m
    pairs = np.triu_indices(ROBOTS, 1)
    gap = inside = math.inf
    no_answer, times = 0, []
    half = np.array(config.arena.size_m) / 2
    for k in range(round(SECONDS / config.controller.tick_s)):
        now_ns = START_NS + k * tick_ns
        poses = np.array([plant.truth()[:3] for plant in plants])
        images.append(poses + noise * rng.normal(size=poses.shape))
        late = max(0, k - DELAY_TICKS)
        seen_ns = np.full(ROBOTS, START_NS + late * tick_ns)
        fleet.observe(seen_ns, images[late])
        _, there, turning = fleet.predict(now_ns)
        before = wheels
        u, wheels = go(config, there, -starts)
        unseen = (now_ns - fleet.measured_ns) / S
        from robofleet.clock import stopwatch_ns

        t0 = stopwatch_ns()
        how, _ = shield.filter(there, turning, unseen, np.ones(ROBOTS, dtype=np.bool_), wheels, u)
        times.append(stopwatch_ns() - t0)
        no_answer += int((how == 2).sum())
        fleet.command(now_ns, wheels)
        for duration, asked in [(delay_s, before)] + [((config.controller.tick_s - delay_s) / 3, wheels)] * 3:
            for i, plant in enumerate(plants):
                stuck = i == frozen and k * config.controller.tick_s >= stall_s
                plant.step(WheelSpeeds(*asked[i].tolist()), duration, blocked=stuck)
            at = np.array([plant.truth()[:2] for plant in plants])
            gap = min(gap, np.linalg.norm(at[pairs[0]] - at[pairs[1]], axis=1).min() - 2 * radius)
            inside = min(inside, (half - np.abs(at)).min() - radius)
    l = config.controller.point_ahead_m
    p = at + l * np.array([(math.cos(q.truth().psi), math.sin(q.truth().psi)) for q in plants])
    there_now = np.linalg.norm(p + starts, axis=1) < ARRIVED
    if stalled:
        there_now[frozen] = False
    return Crossing(
        gap, inside, int(there_now.sum()), ROBOTS - stalled, no_answer, float(np.percentile(times, 99)) / 1e3
    )


def go(config: Config, poses: Array, goals: Array) -> tuple[Array, Array]:
    """Return u (N, 2) and the wheels (N, 2) that take every point p straight to its goal."""
    l = config.controller.point_ahead_m
    u, wheels = np.empty((len(poses), 2)), np.empty((len(poses), 2))
    for i, (x, y, psi) in enumerate(poses.tolist()):
        drive = slices.drive(config.platoon[i])
        u[i] = goals[i] - (x + l * math.cos(psi), y + l * math.sin(psi))
        u[i] *= drive.max_speed / max(np.linalg.norm(u[i]), 0.1)
        v, omega = body_from_point(*u[i].tolist(), psi, l)
        asked = np.array(wheels_from_body(v, omega, drive.wheel_radius, drive.wheel_base))
        ratio = feasible_ratio(*asked.tolist(), drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
        u[i], wheels[i] = ratio * u[i], ratio * asked
    return u, wheels


def main() -> None:
    """Print the worst of many."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    arguments = parser.parse_args()
    config = configuration()
    found = [cross(config, seed) for seed in range(arguments.first, arguments.first + arguments.seeds)]
    gaps = np.array([one.gap for one in found]) * 1e3
    worst = int(gaps.argmin())
    print(f"smallest gap {gaps.min():.1f} mm (seed {arguments.first + worst}), median {np.median(gaps):.1f} mm")
    print(f"edge {min(one.inside for one in found) * 1e3:.1f} mm")
    print(f"arrived {sum(one.arrived for one in found)} of {sum(one.moving for one in found)}")
    print(
        f"no answer {sum(one.no_answer for one in found)}; compute p99 {np.median([o.compute_us for o in found]):.1f} us"
    )
    print(MS and "")


if __name__ == "__main__":
    main()

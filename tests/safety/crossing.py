"""Eight robots that change places through the middle of the arena, seen 99 ms late; one of them stalls on the way.

    python -m tests.safety.crossing [--seeds 100] [--first 1]

Everything but the law is what a run has: the shipped robots with their faults, the truth source's noise, the fleet
filter, and the barrier with the very parameters of the shipped platoon. Nobody is told of the stall.
"""

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import S
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.processes import fleet
from robofleet.safety.barrier import NO_ANSWER
from robofleet.vehicles.differential_drive import body_from_point, feasible_ratio, point_from_pose, wheels_from_body
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant

Array = NDArray[np.float64]

PLATOON = Path(__file__).parents[2] / "configs" / "platoon.yaml"
ROBOTS, SECONDS = 8, 60.0
DELAY_TICKS = 3  # 99 ms
CIRCLE = 0.8  # radius on which they start [m]
ARRIVED = 0.02  # from the goal [m]
START_NS = 10 * S
PAIRS = np.triu_indices(ROBOTS, 1)


@dataclass(frozen=True)
class Crossing:
    """What came of one."""

    gap: float  # smallest distance between two bodies [m]
    edge: float  # smallest distance of a body from the arena's edge [m]
    arrived: int  # robots at their goals at the end
    blocked: int  # robots that are not, and said to be blocked
    moving: int  # robots that did not stall
    no_answer: int  # ticks of a robot for which there was none


def configuration() -> Config:
    """Return the shipped platoon's configuration with eight robots."""
    names = [f"r{k}" for k in range(1, ROBOTS + 1)]
    start = "start: {x_m: 0, y_m: 0, heading_deg: 0}"
    robots = [f"{{id: {name}, tag: {k}, vehicle: gternal, {start}}}" for k, name in enumerate(names)]
    return load_config(PLATOON, [f"robots=[{', '.join(robots)}]", f"groups.0.robots=[{', '.join(names)}]"])


class Arena:
    """The robots on the floor, and the smallest distances that there were."""

    def __init__(self, config: Config, rng: np.random.Generator, stalled: bool) -> None:
        angle = np.arange(ROBOTS) * math.tau / ROBOTS + rng.uniform(-0.1, 0.1, ROBOTS)
        starts = CIRCLE * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self.goals = -starts
        heading = angle + math.pi + rng.uniform(-0.3, 0.3, ROBOTS)
        self.plants = [
            Plant(slices.drive(robot), slices.imperfections(robot.vehicle), (x, y, psi), rng)
            for robot, (x, y), psi in zip(config.platoon, starts.tolist(), heading.tolist(), strict=True)
        ]
        self.stuck = int(rng.integers(ROBOTS)) if stalled else -1
        self._left_s = float(rng.uniform(1.0, 12.0))  # until then
        self._radius, self._half = config.platoon[0].vehicle.body_radius_m, np.array(config.arena.size_m) / 2
        self.gap = self.edge = math.inf

    def poses(self) -> Array:
        return np.array([plant.truth()[:3] for plant in self.plants])

    def move(self, wheels: Array, seconds: float) -> None:
        self._left_s -= seconds
        for i, plant in enumerate(self.plants):
            plant.step(WheelSpeeds(*wheels[i].tolist()), seconds, blocked=i == self.stuck and self._left_s < 0)
        at = self.poses()[:, :2]
        self.gap = min(self.gap, float(np.linalg.norm(at[PAIRS[0]] - at[PAIRS[1]], axis=1).min()) - 2 * self._radius)
        self.edge = min(self.edge, float((self._half - np.abs(at)).min()) - self._radius)


def cross(config: Config, seed: int, *, stalled: bool = True) -> Crossing:
    """Drive one crossing."""
    rng, c, truth = np.random.default_rng(seed), config.controller, config.tracker.truth
    arena, estimate, barrier = Arena(config, rng, stalled), fleet.fleet_filter(config), fleet.barrier(config)
    noise = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
    images: list[Array] = []
    wheels, no_answer, all_drive = np.zeros((ROBOTS, 2)), 0, np.ones(ROBOTS, dtype=np.bool_)
    for k in range(round(SECONDS / c.tick_s)):
        tick_ns, newest = START_NS + k * round(c.tick_s * S), max(0, k - DELAY_TICKS)
        images.append(arena.poses() + noise * rng.normal(size=(ROBOTS, 3)))
        estimate.observe(np.full(ROBOTS, START_NS + newest * round(c.tick_s * S)), images[newest])
        _, there, turning = estimate.predict(tick_ns)
        before, (u, wheels) = wheels, asked(config, there, arena.goals)
        unseen = (tick_ns - estimate.measured_ns) / S
        how, blocked = barrier.filter(there, turning, unseen, all_drive, wheels, u)
        no_answer += int((how == NO_ANSWER).sum())
        estimate.command(tick_ns, wheels)
        arena.move(before, c.command_delay_s)
        for _ in range(3):
            arena.move(wheels, (c.tick_s - c.command_delay_s) / 3)
    points = np.array([point_from_pose(*pose, c.point_ahead_m) for pose in arena.poses().tolist()])
    there_now = np.linalg.norm(points - arena.goals, axis=1) < ARRIVED
    moving = np.arange(ROBOTS) != arena.stuck
    return Crossing(
        arena.gap, arena.edge, int((there_now & moving).sum()), int((~there_now & blocked & moving).sum()),
        int(moving.sum()), no_answer,
    )  # fmt: skip


def asked(config: Config, poses: Array, goals: Array) -> tuple[Array, Array]:
    """Return u (N, 2) and the wheels (N, 2) that take every point p straight to its goal, as fast as it can."""
    found = [_asked(config, robot, *row) for robot, *row in zip(config.platoon, poses, goals, strict=True)]
    return np.array([u for u, _ in found]), np.array([wheels for _, wheels in found])


def _asked(config: Config, robot: Robot, pose: Array, goal: Array) -> tuple[Array, Array]:
    drive, l, (x, y, psi) = slices.drive(robot), config.controller.point_ahead_m, pose.tolist()
    left = goal - point_from_pose(x, y, psi, l)
    u = left * drive.max_speed / max(float(np.linalg.norm(left)), 0.1)
    wheels = wheels_from_body(*body_from_point(*u.tolist(), psi, l), drive.wheel_radius, drive.wheel_base)
    ratio = feasible_ratio(*wheels, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
    return ratio * u, ratio * np.array(wheels)


def main() -> None:
    """Print the worst of many."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=1)
    arguments = parser.parse_args()
    config = configuration()
    for stalled in (True, False):
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        found = [cross(config, seed, stalled=stalled) for seed in seeds]
        gaps = np.array([one.gap for one in found]) * 1e3
        print("one stalls" if stalled else "nobody stalls")
        print(f"  gap          {gaps.min():.1f} mm (seed {seeds[int(gaps.argmin())]}), median {np.median(gaps):.1f} mm")
        print(f"  edge         {min(one.edge for one in found) * 1e3:.1f} mm")
        print(f"  arrived      {sum(one.arrived for one in found)} of {sum(one.moving for one in found)}")
        print(f"  blocked      {sum(one.blocked for one in found)} of the others")
        print(f"  no answer    {sum(one.no_answer for one in found)}")


if __name__ == "__main__":
    main()

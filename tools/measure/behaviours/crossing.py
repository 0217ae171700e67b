"""Robots that cross each other's ways, seen 99 ms late, with the control barrier function (CBF) as their only help.

    python -m tools.measure.behaviours.crossing [--seeds 20] [--first 1] [--jobs 2] [SCENARIO ...]

Everything but the law is what a run has: the shipped robots with their imperfections, the truth source's noise, the
fleet filter, and the barrier with the parameters of the shipped platoon. A robot that stalls tells nobody.
"""

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.clock import S, WallClock
from robofleet.nodes import fleet
from robofleet.safety.barrier import NO_ANSWER
from robofleet.vehicles.differential_drive import body_from_point, feasible_ratio, point_from_pose, wheels_from_body
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant
from tools.measure.program import program

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
DELAY_TICKS = 3  # 99 ms
ARRIVED = 0.02  # from the goal [m]
TOGETHER = 0.3  # from the middle of all points p, in consensus [m]
REST_S = 1.0  # all have been at their goals for so long: the trial ends
START_NS = 10 * S


class Scenario(NamedTuple):
    """Robots on an ellipse, evenly in its parameter, and what they are asked for."""

    robots: int
    half_axes: tuple[float, float]  # of the ellipse on which they start [m]
    gain: float  # of the single-integrator law on the point ahead [1/s]
    speed: float  # that it asks for at most [m/s]
    meet: bool = False  # in their middle (consensus, all know all); else each goes to the opposite point
    stalled: bool = False  # one of them stops moving on its way
    seconds: float = 90.0  # at most


CIRCLE, ELLIPSE = (0.8, 0.8), (1.05, 0.7)
SCENARIOS = {
    "circle, 8, one stalls": Scenario(8, CIRCLE, 2.0, 0.2, stalled=True, seconds=60.0),
    "circle, 8": Scenario(8, CIRCLE, 2.0, 0.2),
    **{f"ellipse, {n}": Scenario(n, ELLIPSE, 0.8, 0.15) for n in (4, 8, 10, 16)},
    "consensus, 8": Scenario(8, CIRCLE, 0.8, 0.15, meet=True, seconds=60.0),
    "consensus, 8, shipped": Scenario(8, CIRCLE, 4.0, 0.08, meet=True, seconds=60.0),  # configs/consensus.yaml's law
}


@dataclass(frozen=True)
class Crossing:
    gap: float  # smallest distance between two bodies [m]
    edge: float  # smallest distance of a body from the arena's edge [m]
    arrived: int  # robots at their goals at the end
    blocked: int  # robots that are not, and said to be blocked at the end
    ever_blocked: int  # robots that were said to be blocked at any time at which they were not at their goals
    moving: int  # robots that did not stall
    no_answer: int  # ticks of a robot for which there was none
    seconds: float  # until all were there to stay; infinite where they were not


@cache
def configuration(robots: int = 8, file: Path = PLATOON, changes: tuple[str, ...] = ()) -> Config:
    """Return a configuration with so many GTernals in its group, and changes of it."""
    names = [f"r{k}" for k in range(1, robots + 1)]
    start = "start: {x_m: 0, y_m: 0, heading_deg: 0}"
    rows = [f"{{id: {name}, tag: {k}, vehicle: gternal, {start}}}" for k, name in enumerate(names)]
    return load_config(file, [f"robots=[{', '.join(rows)}]", f"groups.0.robots=[{', '.join(names)}]", *changes])


class Arena:
    """The robots on the floor, and the smallest distances that there were."""

    def __init__(self, config: Config, scenario: Scenario, rng: np.random.Generator) -> None:
        n, even = scenario.robots, np.arange(scenario.robots) * math.tau / scenario.robots
        angle = even + rng.uniform(-0.1, 0.1, n) * min(1.0, 8 / n)
        starts = np.stack([np.cos(angle), np.sin(angle)], axis=1) * scenario.half_axes
        self._goals, self._meet = -starts, scenario.meet
        heading = np.arctan2(-starts[:, 1], -starts[:, 0]) + rng.uniform(-0.3, 0.3, n)
        self._ahead = config.controller.point_ahead_m
        self._plants = [
            Plant(slices.drive(robot), slices.imperfections(robot), (x, y, psi), rng)
            for robot, (x, y), psi in zip(config.members, starts.tolist(), heading.tolist(), strict=True)
        ]
        self.stuck = int(rng.integers(n)) if scenario.stalled else -1
        self._left_s = float(rng.uniform(1.0, 12.0))  # until then
        self._radius, self._half = config.members[0].vehicle.body_radius_m, np.array(config.arena.size_m) / 2
        self._pairs = np.triu_indices(n, 1)
        self.gap = self.edge = math.inf

    def poses(self) -> Array:
        return np.array([plant.truth()[:3] for plant in self._plants])

    def move(self, wheels: Array, seconds: float) -> None:
        self._left_s -= seconds
        for i, plant in enumerate(self._plants):
            plant.step(WheelSpeeds(*wheels[i].tolist()), seconds, blocked=i == self.stuck and self._left_s < 0)
        at = self.poses()[:, :2]
        first, other = self._pairs
        self.gap = min(self.gap, float(np.linalg.norm(at[first] - at[other], axis=1).min()) - 2 * self._radius)
        self.edge = min(self.edge, float((self._half - np.abs(at)).min()) - self._radius)

    def goals(self, points: Array) -> Array:
        """Return where each point p is to go (N, 2)."""
        return np.broadcast_to(points.mean(axis=0), points.shape) if self._meet else self._goals

    def there(self) -> NDArray[np.bool_]:
        """Return who is where it is to be (N,)."""
        p = points(self.poses(), self._ahead)
        return np.asarray(np.linalg.norm(p - self.goals(p), axis=1) < (TOGETHER if self._meet else ARRIVED))


def cross(config: Config, seed: int, scenario: Scenario) -> Crossing:
    rng, c, truth, n = np.random.default_rng(seed), config.controller, config.tracker.truth, scenario.robots
    arena, estimate, barrier = Arena(config, scenario, rng), fleet.fleet_filter(config), fleet.barrier(config)
    noise = np.array([truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad])
    images: list[Array] = []
    wheels, no_answer, all_drive = np.zeros((n, 2)), 0, np.ones(n, dtype=np.bool_)
    moving, ever, since_s = np.arange(n) != arena.stuck, np.zeros(n, dtype=np.bool_), math.inf
    for k in range(round(scenario.seconds / c.tick_s)):
        tick_ns, newest = START_NS + k * round(c.tick_s * S), max(0, k - DELAY_TICKS)
        images.append(arena.poses() + noise * rng.normal(size=(n, 3)))
        estimate.observe(np.full(n, START_NS + newest * round(c.tick_s * S)), images[newest])
        _, predicted, turning = estimate.predict(tick_ns)
        goals = arena.goals(points(predicted, c.point_ahead_m))
        before, (u, wheels) = wheels, asked(config, scenario, predicted, goals)
        unseen = (tick_ns - estimate.measured_ns) / S
        wheels, _, change, blocked = barrier.filter(predicted, turning, unseen, all_drive, wheels, u)
        no_answer, ever = no_answer + int((change == NO_ANSWER).sum()), ever | (blocked & ~arena.there())
        estimate.command(tick_ns, wheels)
        arena.move(before, c.command_delay_s)
        for _ in range(3):
            arena.move(wheels, (c.tick_s - c.command_delay_s) / 3)
        since_s = min(since_s, k * c.tick_s) if arena.there()[moving].all() else math.inf
        if not scenario.meet and k * c.tick_s > since_s + REST_S:
            break
    there_now = arena.there()
    return Crossing(
        arena.gap, arena.edge, int((there_now & moving).sum()), int((~there_now & blocked & moving).sum()),
        int((ever & moving).sum()), int(moving.sum()), no_answer, since_s,
    )  # fmt: skip


def points(poses: Array, ahead: float) -> Array:
    return np.array([point_from_pose(x, y, psi, ahead) for x, y, psi in poses.tolist()])


def asked(config: Config, scenario: Scenario, poses: Array, goals: Array) -> tuple[Array, Array]:
    """Return u (N, 2) and the wheels (N, 2) that take every point p straight to its goal."""
    found = [_asked(config, scenario, *row) for row in zip(config.members, poses, goals, strict=True)]
    return np.array([u for u, _ in found]), np.array([wheels for _, wheels in found])


def _asked(config: Config, scenario: Scenario, robot: Robot, pose: Array, goal: Array) -> tuple[Array, Array]:
    drive, l, (x, y, psi) = slices.drive(robot), config.controller.point_ahead_m, pose.tolist()
    u = scenario.gain * (goal - point_from_pose(x, y, psi, l))
    u *= min(1.0, scenario.speed / max(float(np.linalg.norm(u)), 1e-9))
    u_x, u_y = u.tolist()
    wheels = wheels_from_body(*body_from_point(u_x, u_y, psi, l), drive.wheel_radius, drive.wheel_base)
    ratio = feasible_ratio(*wheels, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
    return ratio * u, ratio * np.array(wheels)


def crossed(name: str, seed: int) -> Crossing:
    scenario = SCENARIOS[name]
    return cross(configuration(scenario.robots), seed, scenario)


def main() -> None:
    parser = program(__doc__, seeds=20, first=1, jobs=(2, "processes that drive crossings at the same time"))
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=f"of: {'; '.join(SCENARIOS)}")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.scenarios if name not in SCENARIOS]
    if unknown:
        parser.error(f"there is no scenario {unknown[0]!r}: known: {'; '.join(SCENARIOS)}")
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    print(f"{'scenario':24}{'seeds':>6}{'all arrived':>13}{'robots':>11}{'gap':>9}{'edge':>9}{'blocked':>9}{'':4}time")
    clock = WallClock()
    with ProcessPoolExecutor(arguments.jobs) as processes:
        for name in arguments.scenarios or SCENARIOS:
            began_ns = clock.now_ns()
            found = list(processes.map(crossed, [name] * len(seeds), seeds))
            print(f"{row(name, found)}; computed in {(clock.now_ns() - began_ns) / S:.0f} s", flush=True)


def row(name: str, found: list[Crossing]) -> str:
    all_there = sum(meeting.arrived == meeting.moving for meeting in found)
    robots = f"{sum(meeting.arrived for meeting in found)}/{sum(meeting.moving for meeting in found)}"
    gap, edge = (1e3 * min(values) for values in zip(*((meeting.gap, meeting.edge) for meeting in found), strict=True))
    blocked, times = sum(meeting.ever_blocked for meeting in found), [meeting.seconds for meeting in found]
    no_answer = sum(meeting.no_answer for meeting in found)
    return (
        f"{name:24}{len(found):6}{all_there:13}{robots:>11}{gap:6.1f} mm{edge:6.0f} mm{blocked:9}"
        f"    {np.median(times):.1f} s, at most {max(times):.1f} s; no answer {no_answer}"
    )


if __name__ == "__main__":
    main()

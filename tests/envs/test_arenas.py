"""Arenas: the plant, the barrier and the noise of a run, in arrays."""

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robofleet.calibration.store import provenance
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.control import wheels as wheel_limits
from robofleet.core.arrays import Array
from robofleet.envs.arenas import Arenas
from robofleet.envs.robots import builds
from robofleet.safety import gate
from robofleet.safety.gate import GateState
from robofleet.vehicles.plant import Plant
from tests.shipped import PLATOON

TICK_NS = 33_000_000
TOP = np.array([0.2, 3.8])  # v [m/s], omega [rad/s]
OF_BODY = np.ones(4, dtype=np.bool_)
STARTS = np.array([[-0.6, -0.4, 0.3], [0.6, -0.4, 2.0], [-0.6, 0.4, -1.0], [0.6, 0.4, 3.0]])


def with_plants(config: Config, **errors: Any) -> Config:
    """Return a configuration whose simulated robots have these errors, and are all alike."""
    robots = []
    for robot in config.robots:
        assert robot.vehicle.simulated is not None
        alike = {"wheel_gain_spread": 0.0, "wheel_base_spread": 0.0, **errors}
        vehicle = robot.vehicle.model_copy(update={"simulated": robot.vehicle.simulated.model_copy(update=alike)})
        robots.append(robot.model_copy(update={"vehicle": vehicle}))
    return config.model_copy(update={"robots": tuple(robots)})


@pytest.fixture(scope="module")
def platoon() -> Config:
    return load_config(PLATOON)


@contextmanager
def arenas(config: Config, count: int, **options: Any) -> Iterator[Arenas]:
    made = Arenas(config, count, 7, builds=builds(config, 1.0), **options)
    with closing(made):
        made.reset(np.arange(count), np.repeat(STARTS[None], count, axis=0))
        yield made


def commands(ticks: int) -> Array:
    """Return v and omega of four robots at each tick: new ones every half second, with stops between."""
    drawn = np.random.default_rng(1).uniform(-1.0, 1.0, (ticks // 15 + 1, 4, 2)) * TOP
    drawn[::3] = 0.0
    return np.repeat(drawn, 15, axis=0)[:ticks]


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("delay_s", "errors"),
    [
        (0.02, {}),
        (0.0, {"loop_period_s": 0.002, "motor_lag_s": 0.05, "stop_lag_s": 0.0, "speed_quantum_rad_s": 0.0}),
    ],
)
def test_the_plant_is_the_one_of_a_run(platoon: Config, delay_s: float, errors: dict[str, float]) -> None:
    """The oracle: the plain plant of the driver ``simulated`` behind a plain gate's ramp, for 20 s."""
    config = with_plants(platoon, slip_noise=0.0, actuation_delay_s=delay_s, **errors)
    unknown_s = delay_s + config.lockstep.bus_delay_s - config.controller.command_delay_s
    robots = [slices.simulation(config, robot, None) for robot in config.members]
    plants = [
        Plant(r.drive, replace(r.imperfections, actuation_delay=unknown_s), (x, y, psi), r.rng)
        for r, (x, y, psi) in zip(robots, STARTS.tolist(), strict=True)
    ]
    gates = [GateState(boot_id=1) for _ in plants]
    limits = wheel_limits.limits(tuple(r.drive for r in robots))
    with arenas(config, 1, barrier=False) as world:
        for tick, request in enumerate(commands(606)):
            wheels = wheel_limits.limited(request, OF_BODY, world.poses[0], 0.08, limits, OF_BODY).wheels
            world.step(request[None], OF_BODY)
            for row, (plant, g) in enumerate(zip(plants, gates, strict=True)):
                obey(plant, g, *wheels[row].tolist(), robots[row].drive.max_wheel_acceleration, tick * TICK_NS)
    truths = np.array([plant.truth()[:3] for plant in plants])
    assert np.hypot(*(truths - STARTS)[:, :2].T).min() > 0.05
    assert world.truths[0] == pytest.approx(truths, abs=1e-9)


def obey(plant: Plant, g: GateState, left: float, right: float, acceleration: float, now_ns: int) -> None:
    """Let a robot obey wheels [rad/s] for a tick, its gate stepped as drivers do: while its output is on its way."""
    end_ns = now_ns + TICK_NS
    while now_ns < end_ns:
        gate.follow(g, left, right, acceleration, now_ns)
        plant.write(g.output)
        now_ns = end_ns if g.output == (left, right) else min(now_ns + gate.RAMP_NS, end_ns)
        plant.advance(now_ns)


def test_with_the_barrier_nobody_touches_anybody(platoon: Config) -> None:
    closest = {}
    for barrier in (True, False):
        with arenas(platoon, 8, barrier=barrier) as world:
            closest[barrier] = step_randomly(world, np.random.default_rng(3))
    assert closest[True] > 0.0
    assert closest[False] < 0.0


def step_randomly(world: Arenas, rng: np.random.Generator) -> float:
    """Step arenas for 20 s by random commands; returns the smallest distance of two bodies [m]."""
    closest = math.inf
    for tick in range(600):
        if tick % 30 == 0:
            request = rng.uniform((0.5, -0.5), 1.0, (len(world), 4, 2)) * TOP
        world.step(request, OF_BODY)
        apart = np.linalg.norm(world.truths[:, :, None, :2] - world.truths[:, None, :, :2], axis=3)
        closest = min(closest, float(apart[:, *np.triu_indices(4, 1)].min()) - 0.11)
    return closest


def test_the_same_seed_gives_the_same_numbers_by_any_number_of_threads(platoon: Config) -> None:
    ends = []
    for threads in (1, 3):
        with arenas(platoon, 300, threads=threads) as world:
            for request in commands(40):
                world.step(np.repeat(request[None], 300, axis=0), OF_BODY)
            ends.append(world.poses.copy())
    assert np.array_equal(ends[0], ends[1])
    assert len(np.unique(ends[0][:, 0, 0])) == 300  # and none is like another


def test_a_reset_leaves_the_other_arenas_alone(platoon: Config) -> None:
    with (
        arenas(with_plants(platoon, slip_noise=0.0), 3) as world,
        arenas(with_plants(platoon, slip_noise=0.0), 3) as other,
    ):
        for tick, request in enumerate(commands(60)):
            for each in (world, other):
                each.step(np.repeat(request[None], 3, axis=0), OF_BODY)
            if tick == 30:
                world.reset(np.array([1]), STARTS[None])
        assert np.array_equal(world.truths[[0, 2]], other.truths[[0, 2]])
        assert world.ticks.tolist() == [60, 29, 60]
        assert not np.array_equal(world.truths[1], other.truths[1])


def test_a_delay_that_the_controller_does_not_know_of_is_the_plants(platoon: Config) -> None:
    ways = []
    for delay_s in (0.0, 0.06):
        with arenas(with_plants(platoon, actuation_delay_s=delay_s), 1) as world:
            for _ in range(30):
                world.step(np.full((1, 4, 2), (0.1, 0.0)), OF_BODY)
            ways.append(np.hypot(*(world.truths[0, :, :2] - STARTS[:, :2]).T))
    assert ways[0] - ways[1] == pytest.approx(0.1 * (0.06 - 0.001), rel=0.1)


def test_robots_that_were_identified_are_drawn_from_their_covariance(platoon: Config) -> None:
    covariance = np.array([[4e-10, 3e-10, 0.0], [3e-10, 4e-10, 0.0], [0.0, 0.0, 1e-6]])
    names = ("left_radius_m", "right_radius_m", "motor_lag_s")
    identified = provenance("identify", {}, {}, names, covariance.tolist())
    calibration = RobotCalibration(robot="r1", identified=identified)
    config = with_plants(platoon)
    first = config.robots[0].model_copy(update={"calibration": calibration})
    config = config.model_copy(update={"robots": (first, *config.robots[1:])})
    rng = np.random.default_rng(5)
    draw = builds(config, 2.0)
    drawn = np.array(
        [(b.left_gain * 0.016, b.right_gain * 0.016, b.motor_lag) for b, *_ in (draw(rng) for _ in range(4000))]
    )
    assert np.cov(drawn.T) == pytest.approx(4.0 * covariance, rel=0.1, abs=2e-8)
    alike = builds(config, 0.0)
    assert alike(rng)[0] == alike(rng)[0]

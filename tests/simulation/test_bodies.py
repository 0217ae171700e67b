"""The plant compiled on arrays does what it does plain with one robot, to the last bit."""

from dataclasses import replace
from random import Random
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.core.clock import MS, S
from robofleet.drivers.simulated import SimulatedRobot
from robofleet.simulation.bodies import Bodies, measured
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import BodyTrouble, DriverContext, Imperfections, Simulation, WheelSpeeds, Wiring
from tests.robots import CREATE2, CREATE2_IDEAL, GTERNAL, IDEAL, WORN

EXACT = settings(deadline=None, derandomize=True)
SEEDS = st.integers(0, 2**64 - 1)
SPEEDS = (0.0, -0.0, 0.3, 0.6, 0.8, -0.8, 3.0, -7.5, 12.5, 40.0)


def imperfections(rng: Random) -> Imperfections:
    """Return any robot's: ideal, worn, and whatever lies between."""
    lag, quantum = rng.choice((0.0, 0.02, 0.08)), rng.choice((0.0, 0.2244, 0.8233))
    return replace(
        rng.choice((IDEAL, WORN, CREATE2_IDEAL)), wiring=rng.choice(get_args(Wiring)), motor_lag=lag,
        speed_quantum=quantum, battery_life=rng.choice((1e9, 2400.0, 1.5)), top_speed_sag=rng.choice((0.0, 0.3)),
        wheel_gain_error=rng.choice((0.0, 0.02)), slip=rng.choice((0.0, 0.02, 0.2)), slip_noise=rng.choice((0.2, 2.0)),
        actuation_delay=rng.choice((0.0, 0.0, 0.003, 0.03, 0.35)),
    )  # fmt: skip


def trouble(rng: Random) -> BodyTrouble:
    """Return what is wrong with a robot now: mostly nothing."""
    none = (BodyTrouble(),) * 4
    runs = BodyTrouble(left=rng.choice((None, 4.0)), right=rng.choice((None, 0.0, -3.0)))
    push = BodyTrouble(pushed=(rng.choice((0.0, 0.1)), rng.choice((0.0, -0.2))))
    return rng.choice((*none, BodyTrouble(stuck=True), BodyTrouble(slip=0.4), runs, push))


class Both:
    """Robots twice: in arrays, and each by itself; both have the same clock, the same draws and the same troubles."""

    def __init__(self, robots: list[tuple[DifferentialDrive, Imperfections]], seed: int = 1) -> None:
        self.now_ns = 5 * S
        self.troubles = [BodyTrouble()] * len(robots)
        arrayed, alone = ([self._context(row, *robot, seed) for row, robot in enumerate(robots)] for _ in range(2))
        self.bodies, self.robots = Bodies(arrayed), [SimulatedRobot(context) for context in alone]

    def _context(self, row: int, drive: DifferentialDrive, worn: Imperfections, seed: int) -> DriverContext:
        rng = np.random.default_rng((seed, row))
        simulation = Simulation(
            drive=drive, imperfections=worn, start=(0.1 * row, -0.3, 1.0), trouble=lambda: self.troubles[row], rng=rng
        )
        return DriverContext(robot=f"r{row}", drive=drive, simulation=simulation, now_ns=lambda: self.now_ns)

    def write(self, row: int, left: float, right: float) -> None:
        self.bodies.write(row, left, right)
        self.robots[row].write(WheelSpeeds(left, right))

    def compare(self) -> None:
        truths = self.bodies.truths()
        for row, robot in enumerate(self.robots):
            body, build, *_ = self.bodies.row(row)
            assert [x.hex() for x in truths[row].tolist()] == [x.hex() for x in robot.truth()], row
            assert [x.hex() for x in measured(body, build)] == [x.hex() for x in robot.read()[:5]], row


@settings(EXACT, max_examples=15)
@given(SEEDS)
def test_whatever_is_asked_of_robots_at_whatever_instant(seed: int) -> None:
    """Robots of a unit are told and looked at together, or one by one; sometimes nobody asks for long."""
    rng = Random(seed)
    both = Both([(rng.choice((GTERNAL, CREATE2)), imperfections(rng)) for _ in range(3)], seed)
    for _ in range(80):
        both.now_ns += rng.choice((0, 1, 3 * MS, 5 * MS, 10 * MS, 10 * MS, 33 * MS + 7, rng.choice((0, 150 * MS, S))))
        both.troubles[rng.randrange(3)] = trouble(rng)
        for row in rng.choice(((), (0,), (2,), (0, 1, 2), (0, 1, 2))):
            both.write(row, rng.choice(SPEEDS), rng.choice((*SPEEDS, rng.uniform(-13.0, 13.0))))
        if rng.random() < 0.7:
            both.compare()
    both.compare()


@pytest.mark.slow
@pytest.mark.parametrize("loop_period", [0.01, 0.001, 0.015])
def test_a_long_drive_with_slip_uses_the_same_draws_as_one_robot(loop_period: float) -> None:
    """Many more than are drawn at once, told every 5 ms, and looked at seldom."""
    worn = replace(WORN, slip_noise=0.5, loop_period=loop_period, actuation_delay=0.007)
    both = Both([(GTERNAL, worn), (GTERNAL, replace(worn, slip=0.0)), (CREATE2, worn)])
    rng = Random(3)
    for k in range(1500):
        both.now_ns += 5 * MS + rng.randrange(MS)
        for row in range(3):
            both.write(row, 6.0 + rng.uniform(-1.0, 1.0), 4.0)
        if k % 100 == 0:
            both.compare()
    both.compare()


def test_after_200_ms_without_a_word_the_motors_go_off() -> None:
    both = Both([(GTERNAL, IDEAL), (GTERNAL, WORN)])
    for silent_ns in (150 * MS, 199_999_999, 200 * MS, 200_000_001, 3 * S):
        for row in range(2):
            both.write(row, 5.0, 5.0)
        both.now_ns += silent_ns
        both.compare()
        assert bool(both.bodies.bodies["v"][0]) == (silent_ns < 200 * MS) or silent_ns == 200 * MS
    assert not both.bodies.truths()[:, 3].any()

"""The simulated robot's driver, beside the contract: asking changes nothing, troubles act, a command acts late."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.drivers.simulated import SimulatedRobot
from robofleet.vehicles.interface import BodyTrouble, DriverContext, Imperfections, Simulation, WheelSpeeds
from tests.robots import GTERNAL, IDEAL, WORN

START = (0.4, -0.3, 1.0)


class Bench:
    """A robot and the clock that it is given."""

    def __init__(self, imperfections: Imperfections = IDEAL) -> None:
        self.now_ns = 5 * S
        self.trouble = BodyTrouble()
        simulation = Simulation(
            drive=GTERNAL, imperfections=imperfections, start=START, trouble=lambda: self.trouble,
            rng=np.random.default_rng(4),
        )  # fmt: skip
        self.robot = SimulatedRobot(
            DriverContext(robot="r1", drive=GTERNAL, simulation=simulation, now_ns=lambda: self.now_ns)
        )

    def drive(self, speed: float, ns: int, reads: int = 1) -> float:
        """Command both wheels once; returns how far the left one turns until some time has passed [rad]."""
        before = self.robot.read().left_angle
        self.robot.write(WheelSpeeds(speed, speed))
        for _ in range(reads):
            self.now_ns += ns // reads
            self.robot.read()
        return self.robot.read().left_angle - before


def test_asking_twice_changes_nothing() -> None:
    bench = Bench(WORN)
    bench.drive(6.0, 150 * MS)
    reading, truth = bench.robot.read(), bench.robot.truth()
    bench.robot.write(WheelSpeeds(6.0, 6.0))
    assert (bench.robot.read(), bench.robot.truth()) == (reading, truth)


def test_motors_that_are_stuck_stand_still_whatever_they_are_told() -> None:
    bench = Bench()
    assert bench.drive(5.0, 100 * MS) == pytest.approx(0.5)
    bench.trouble = BodyTrouble(stuck=True)
    assert bench.drive(5.0, 150 * MS) == 0.0
    assert bench.robot.truth()[3:] == (0.0, 0.0)
    bench.trouble = BodyTrouble()
    assert bench.drive(5.0, 100 * MS) == pytest.approx(0.5)


def test_wheels_that_slip_turn_as_told_and_travel_less() -> None:
    bench = Bench()
    bench.trouble = BodyTrouble(slip=0.5)
    assert bench.drive(5.0, 100 * MS) == pytest.approx(0.5)
    assert math.dist(bench.robot.truth()[:2], START[:2]) == pytest.approx(0.5 * GTERNAL.wheel_radius / 2)


def test_a_command_acts_when_its_delay_has_passed() -> None:
    late, prompt = Bench(replace(IDEAL, actuation_delay=0.045)), Bench()
    for bench in (late, prompt):
        bench.drive(5.0, 20 * MS)
        bench.drive(2.0, 20 * MS)
    late.drive(2.0, 45 * MS, reads=45)
    assert late.robot.truth() == pytest.approx(prompt.robot.truth(), abs=1e-12)

"""The simulated robot's driver: at rest until told, the same however often it is asked, stalls when it must."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from robofleet.drivers.simulated import SimulatedRobot
from robofleet.vehicles.interface import (
    BodyTrouble,
    DriverContext,
    Imperfections,
    SimulatedDriver,
    Simulation,
    WheelSpeeds,
)
from tests.robots import GTERNAL, IDEAL, WORN

MS, S = 1_000_000, 1_000_000_000
START = (0.4, -0.3, 1.0)


class Bench:
    """A robot and the clock that it is given."""

    def __init__(self, imperfections: Imperfections = WORN) -> None:
        self.now_ns = 5 * S
        self.trouble = BodyTrouble()
        simulation = Simulation(
            drive=GTERNAL,
            imperfections=imperfections,
            start=START,
            trouble=lambda: self.trouble,
            rng=np.random.default_rng(4),
        )
        self.robot = SimulatedRobot(
            DriverContext(robot="r1", drive=GTERNAL, simulation=simulation, now_ns=lambda: self.now_ns)
        )

    def wait(self, ns: int, asked_every: int | None = None) -> None:
        for _ in range(ns // (asked_every or ns)):
            self.now_ns += asked_every or ns
            self.robot.read()

    def drive(self, wheels: WheelSpeeds, ns: int, asked_every: int | None = None) -> None:
        """Tell it the same again and again, as the gate's process does."""
        end_ns = self.now_ns + ns
        while self.now_ns < end_ns:
            self.robot.write(wheels)
            self.wait(min(180 * MS, end_ns - self.now_ns), asked_every)


@pytest.fixture
def bench() -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.robot.close()


def test_it_rests_until_it_is_told(bench: Bench) -> None:
    bench.wait(S)
    assert bench.robot.truth() == (*START, 0.0, 0.0)
    assert bench.robot.read()[:4] == (0.0, 0.0, 0.0, 0.0)
    assert bench.robot.read().faults == 0
    assert 0.99 < bench.robot.read().battery < 1.0


def test_it_drives_by_the_clock_it_was_given(bench: Bench) -> None:
    bench.robot.write(WheelSpeeds(6.0, 6.0))
    assert bench.robot.truth()[:3] == START  # no time has passed
    bench.drive(WheelSpeeds(6.0, 6.0), 2 * S)
    x, y, _, v, _ = bench.robot.truth()
    driven = (x - START[0]) * np.cos(START[2]) + (y - START[1]) * np.sin(START[2])
    assert driven == pytest.approx(6.0 * 0.016 * (2.0 - 0.08), rel=0.04)
    assert v == pytest.approx(0.096, rel=0.05)


def test_asking_twice_changes_nothing(bench: Bench) -> None:
    bench.drive(WheelSpeeds(3.0, 7.0), S)
    reading, truth = bench.robot.read(), bench.robot.truth()
    bench.robot.write(WheelSpeeds(3.0, 7.0))
    assert (bench.robot.read(), bench.robot.truth()) == (reading, truth)


def test_how_often_it_is_asked_does_not_matter() -> None:
    ends = []
    for asked_every in (None, 20 * MS, 33 * MS // 3):
        bench = Bench(replace(WORN, slip_noise=0.0))
        bench.drive(WheelSpeeds(4.0, 6.0), 1_980 * MS, asked_every)
        ends.append(np.array(bench.robot.truth()[:3]))
    assert np.abs(np.array(ends) - ends[0]).max(axis=0) == pytest.approx([0.0] * 3, abs=5e-4)


def test_closing_stops_it_and_closing_again_is_fine(bench: Bench) -> None:
    bench.drive(WheelSpeeds(6.0, 6.0), S)
    bench.robot.close()
    bench.robot.close()
    bench.wait(2 * S)
    rest = bench.robot.truth()
    assert rest[3:] == (0.0, 0.0)
    bench.robot.close()
    bench.wait(S)
    assert bench.robot.truth() == rest


def travelled(bench: Bench, ns: int) -> float:
    before = bench.robot.read().left_angle
    bench.wait(ns)
    return bench.robot.read().left_angle - before


def test_motors_that_are_stuck_stand_still_whatever_they_are_told() -> None:
    bench = Bench(IDEAL)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 100 * MS) == pytest.approx(0.5)
    bench.trouble = BodyTrouble(stuck=True)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 150 * MS) == 0.0
    assert bench.robot.truth()[3:] == (0.0, 0.0)
    bench.trouble = BodyTrouble()
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 100 * MS) == pytest.approx(0.5)


def test_wheels_that_slip_turn_as_told_and_travel_less() -> None:
    bench = Bench(IDEAL)
    bench.trouble = BodyTrouble(slip=0.5)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 100 * MS) == pytest.approx(0.5)
    assert math.dist(bench.robot.truth()[:2], START[:2]) == pytest.approx(0.5 * GTERNAL.wheel_radius / 2)


def test_the_firmware_stops_a_robot_to_which_nobody_speaks() -> None:
    silent, driven = Bench(IDEAL), Bench(IDEAL)
    for bench in (silent, driven):
        bench.robot.write(WheelSpeeds(5.0, 5.0))
    driven.wait(150 * MS)
    driven.robot.write(WheelSpeeds(5.0, 5.0))
    driven.wait(150 * MS)
    silent.wait(300 * MS)
    assert driven.robot.read().left_angle == pytest.approx(1.5)
    assert silent.robot.read().left_angle == pytest.approx(1.0, abs=0.11)  # 200 ms and a loop of the firmware
    assert silent.robot.truth()[3:] == (0.0, 0.0)


def test_it_knows_the_truth() -> None:
    assert isinstance(Bench().robot, SimulatedDriver)


def test_a_command_acts_when_its_delay_has_passed() -> None:
    late, prompt = Bench(replace(IDEAL, actuation_delay=0.045)), Bench(IDEAL)
    for bench in (late, prompt):
        bench.robot.write(WheelSpeeds(5.0, 5.0))
        bench.wait(20 * MS)
        bench.robot.write(WheelSpeeds(2.0, 2.0))
    late.wait(45 * MS, asked_every=MS)
    assert late.robot.truth() == pytest.approx(prompt.robot.truth(), abs=1e-12)
    late.wait(100 * MS, asked_every=MS)
    prompt.wait(100 * MS)
    assert late.robot.truth() == pytest.approx(prompt.robot.truth(), abs=1e-12)
    assert late.robot.read().left_angle == pytest.approx(5.0 * 0.02 + 2.0 * 0.1)

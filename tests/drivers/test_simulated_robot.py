"""The simulated robot's driver: at rest until told, the same however often it is asked, stalls when it must."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from drivers.simulated import SimulatedRobot
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import (
    BodyTrouble,
    DriverContext,
    Imperfections,
    SimulatedDriver,
    Simulation,
    WheelSpeeds,
)

MS, S = 1_000_000, 1_000_000_000
START = (0.4, -0.3, 1.0)
DRIVE = DifferentialDrive(
    wheel_radius=0.016,
    wheel_base=0.105,
    max_wheel_speed=12.5,
    max_speed=0.2,
    motor_lag=0.08,
    max_wheel_acceleration=150.0,
)
WORN = Imperfections(
    motor_lag=0.08,
    speed_quantum=0.2244,
    loop_period=0.01,
    deadband=0.5,
    breakaway=0.7,
    wheel_gain_spread=0.03,
    wheel_base_spread=0.01,
    slip=0.02,
    slip_noise=0.2,
    top_speed_sag=0.1,
    battery_life=2400.0,
)
IDEAL = replace(WORN, motor_lag=0.0, speed_quantum=0.0, deadband=0.0, breakaway=0.0, wheel_gain_spread=0.0, slip=0.0)


class Bench:
    """A robot and the clock that it is given."""

    def __init__(self, imperfections: Imperfections = WORN, trouble: Callable[[], BodyTrouble] | None = None) -> None:
        self.now_ns = 5 * S
        simulation = Simulation(DRIVE, imperfections, START, trouble, np.random.default_rng(4))
        self.robot = SimulatedRobot(DriverContext("r1", DRIVE, simulation, lambda: self.now_ns))

    def wait(self, ns: int, asked_every: int | None = None) -> None:
        for _ in range(ns // (asked_every or ns)):
            self.now_ns += asked_every or ns
            self.robot.read()

    def drive(self, wheels: WheelSpeeds, ns: int, asked_every: int) -> None:
        """Tell it again every 99 ms: its firmware stops a robot that hears nothing."""
        for _ in range(ns // (99 * MS)):
            self.robot.write(wheels)
            self.wait(99 * MS, asked_every)


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
    bench.drive(WheelSpeeds(6.0, 6.0), 1_980 * MS, 99 * MS)
    x, y, _, v, _ = bench.robot.truth()
    driven = (x - START[0]) * np.cos(START[2]) + (y - START[1]) * np.sin(START[2])
    assert driven == pytest.approx(6.0 * 0.016 * (1.98 - 0.08), rel=0.04)
    assert v == pytest.approx(0.096, rel=0.05)


def test_asking_twice_changes_nothing(bench: Bench) -> None:
    bench.robot.write(WheelSpeeds(3.0, 7.0))
    bench.wait(S)
    reading, truth = bench.robot.read(), bench.robot.truth()
    bench.robot.write(WheelSpeeds(3.0, 7.0))
    assert (bench.robot.read(), bench.robot.truth()) == (reading, truth)


def test_how_often_it_is_asked_does_not_matter() -> None:
    ends = []
    for asked_every in (99 * MS, 33 * MS, 9 * MS):
        bench = Bench(replace(WORN, slip_noise=0.0))
        bench.drive(WheelSpeeds(4.0, 6.0), 1_980 * MS, asked_every)
        ends.append(np.array(bench.robot.truth()[:3]))
    assert np.abs(np.array(ends) - ends[0]).max(axis=0) == pytest.approx([0.0] * 3, abs=5e-4)


def test_closing_stops_it_and_closing_again_is_fine(bench: Bench) -> None:
    bench.robot.write(WheelSpeeds(6.0, 6.0))
    bench.wait(S)
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


def test_stuck_motors_stand_still_whatever_they_are_told() -> None:
    trouble = BodyTrouble()
    bench = Bench(IDEAL, lambda: trouble)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 100 * MS) == pytest.approx(0.5)
    trouble = BodyTrouble(stuck=True)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 150 * MS) == 0.0
    assert bench.robot.truth()[3:] == (0.0, 0.0)
    trouble = BodyTrouble()
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, 100 * MS) == pytest.approx(0.5)


def test_a_robot_that_hears_nothing_for_200_ms_stops() -> None:
    bench = Bench(IDEAL)
    bench.robot.write(WheelSpeeds(5.0, 5.0))
    assert travelled(bench, S) == pytest.approx(5.0 * 0.2)
    for _ in range(10):
        bench.robot.write(WheelSpeeds(5.0, 5.0))
        assert travelled(bench, 100 * MS) == pytest.approx(0.5)


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

"""The simulated robot: ideal it follows arcs, and each imperfection does what it says."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robofleet.vehicles.differential_drive import arc, body_from_wheels
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL, WORN


def ideal_but(seed: int = 1, pose: tuple[float, float, float] = (0.0, 0.0, 0.0), **imperfections: Any) -> Plant:
    """Return a plant with only the imperfections named."""
    return Plant(GTERNAL, replace(IDEAL, **imperfections), pose, np.random.default_rng(seed))


def drive_for(plant: Plant, wheels: tuple[float, float], seconds: float, step: float = 0.01) -> None:
    for _ in range(round(seconds / step)):
        plant.step(WheelSpeeds(*wheels), step)


def test_an_ideal_robot_follows_exact_arcs() -> None:
    plant = ideal_but(pose=(0.3, -0.2, 3.0))
    pose = (0.3, -0.2, 3.0)
    for wheels in ((5.0, 8.0), (-3.0, 2.0), (12.5, 12.5), (0.0, 0.0), (7.0, -7.0)):
        drive_for(plant, wheels, 0.7)
        body = body_from_wheels(*wheels, GTERNAL.wheel_radius, GTERNAL.wheel_base)
        pose = arc(*pose, *body, 0.7)
        assert plant.truth() == pytest.approx((*pose, *body), abs=1e-12)
    assert plant.reading().left_angle == pytest.approx(0.7 * (5 - 3 + 12.5 + 7), abs=1e-9)


def gains(plant: Plant) -> tuple[float, float]:
    """Return (forward, turning) gain of a plant against the drive that the controller believes in."""
    drive_for(plant, (5.0, 5.0), 0.01)
    v = plant.truth().v / body_from_wheels(5.0, 5.0, GTERNAL.wheel_radius, GTERNAL.wheel_base)[0]
    drive_for(plant, (-5.0, 5.0), 0.01)
    omega = plant.truth().omega / body_from_wheels(-5.0, 5.0, GTERNAL.wheel_radius, GTERNAL.wheel_base)[1]
    return v, omega


def test_gains_stay_within_their_spread_and_fill_it() -> None:
    both = np.array([gains(ideal_but(seed, wheel_gain_spread=0.03)) for seed in range(300)])
    assert np.abs(both - 1.0).max() <= 0.03 + 1e-12
    assert both.min() < 0.98  # uniform over the spread, not a number near 1
    assert both.max() > 1.02
    base = np.array([gains(ideal_but(seed, wheel_base_spread=0.01)) for seed in range(300)])
    assert base[:, 0] == pytest.approx(1.0, abs=1e-12)  # a wrong base turns, it does not drive
    assert np.abs(1.0 / base[:, 1] - 1.0).max() <= 0.01 + 1e-12
    assert np.abs(base[:, 1] - 1.0).max() > 0.007


def test_the_same_generator_gives_the_same_robot() -> None:
    def end(seed: int) -> tuple[float, ...]:
        plant = Plant(GTERNAL, WORN, (0.0, 0.0, 0.0), np.random.default_rng(seed))
        drive_for(plant, (6.0, 9.0), 3.0)
        return tuple(plant.truth())

    assert end(5) == end(5)
    assert end(5) != end(6)


def test_top_speed_sags_with_the_battery() -> None:
    plant = ideal_but(top_speed_sag=0.2, battery_life=10.0)
    speeds = []
    for _ in range(12):
        drive_for(plant, (50.0, -50.0), 1.0)
        speeds.append(plant.reading().left_speed)
    limit = GTERNAL.max_wheel_speed
    expected = [limit * (1 - 0.2 * min(1.0, (k + 1) / 10)) for k in range(12)]
    assert speeds == pytest.approx(expected, rel=1e-9)
    assert plant.charge == 0.0
    assert ideal_but().reading().battery == 1.0


def test_slip_costs_yaw() -> None:
    _, omega = body_from_wheels(-6.0, 6.0, GTERNAL.wheel_radius, GTERNAL.wheel_base)
    plant = ideal_but(slip=0.02)
    drive_for(plant, (-6.0, 6.0), 0.1)
    assert plant.truth().omega == pytest.approx(omega * (1 - 0.02 * omega), rel=1e-9)
    straight = ideal_but(slip=0.02, slip_noise=0.5)
    drive_for(straight, (6.0, 6.0), 0.1)
    assert straight.truth().v == pytest.approx(6.0 * GTERNAL.wheel_radius, rel=1e-12)  # no turn, no slip
    noisy = ideal_but(slip=0.02, slip_noise=0.2)
    lost = []
    for _ in range(400):
        noisy.step(WheelSpeeds(-6.0, 6.0), 0.01)
        lost.append(1 - noisy.truth().omega / omega)
    mean = 0.02 * omega
    assert np.mean(lost) == pytest.approx(mean, rel=0.05)
    assert np.std(lost) == pytest.approx(0.2 * mean / math.sqrt(2), rel=0.2)  # two wheels, each its own


def test_blocked_motors_do_not_move() -> None:
    plant = Plant(GTERNAL, WORN, (0.1, 0.2, 0.3), np.random.default_rng(1))
    drive_for(plant, (8.0, 8.0), 1.0)
    before, angle = plant.truth(), plant.reading().left_angle
    for _ in range(50):
        plant.step(WheelSpeeds(12.0, 12.0), 0.01, blocked=True)
    assert plant.truth() == (*before[:3], 0.0, 0.0)
    assert plant.reading().left_angle == angle
    assert plant.reading().left_speed == 0.0
    drive_for(plant, (8.0, 8.0), 0.08)  # and starts from rest afterwards
    assert 0.0 < plant.reading().left_speed < 7.0


@pytest.mark.parametrize("step", [0.001, 0.0025, 0.005])
def test_how_time_is_cut_does_not_matter(step: float) -> None:
    def end(step: float) -> np.ndarray:
        p = replace(WORN, slip_noise=0.0)  # noise is drawn once a step
        plant = Plant(GTERNAL, p, (0.0, 0.0, 0.0), np.random.default_rng(3))
        for wheels in ((6.0, 9.0), (3.0, -3.0), (0.6, 8.0), (0.0, 0.0), (10.0, 10.0)):
            drive_for(plant, wheels, 0.6, step)
        return np.array(plant.truth()[:3])

    difference = np.abs(end(step) - end(0.01))
    assert difference[:2].max() < 0.0005  # of about 0.2 m driven
    assert difference[2] < 0.005


@pytest.mark.parametrize(
    ("wiring", "acts_as"),
    [
        ("straight", (4.0, 7.0)),
        ("swapped", (7.0, 4.0)),
        ("left_reversed", (-4.0, 7.0)),
        ("right_reversed", (4.0, -7.0)),
        ("both_reversed", (-4.0, -7.0)),
    ],
)
def test_a_wiring_carries_commands_to_other_wheels_and_their_counts_back(
    wiring: str, acts_as: tuple[float, float]
) -> None:
    wired, straight = ideal_but(wiring=wiring), ideal_but()
    drive_for(wired, (4.0, 7.0), 0.5)
    drive_for(straight, acts_as, 0.5)
    assert wired.truth() == straight.truth()
    reading = wired.reading()  # the robot itself cannot tell
    assert (reading.left_angle, reading.right_angle) == pytest.approx((2.0, 3.5))
    assert (reading.left_speed, reading.right_speed) == pytest.approx((4.0, 7.0))


# The firmware's speed loop: lag, encoder, deadband and stiction

STEP = 0.01


def speed_after(plant: Plant, command: float, seconds: float) -> float:
    """Return the left wheel's speed after a command [rad/s]."""
    drive_for(plant, (command, command), seconds, STEP)
    return plant.reading().left_speed


def test_lag_reaches_63_percent_after_its_time_constant() -> None:
    for tau in (0.05, 0.08, 0.2):
        assert speed_after(ideal_but(motor_lag=tau), 6.0, tau) == pytest.approx(6.0 * (1 - math.exp(-1)), rel=1e-9)


def test_lag_costs_the_distance_of_one_time_constant() -> None:
    plant = ideal_but(motor_lag=0.08)
    speed_after(plant, 6.0, 2.0)
    assert plant.reading().left_angle == pytest.approx(6.0 * (2.0 - 0.08), rel=1e-9)


@pytest.mark.parametrize("command", [1.0, 3.37, 7.77, -5.05])
def test_the_encoder_counts_and_does_not_bias(command: float) -> None:
    quantum = 0.2244
    plant = ideal_but(motor_lag=0.08, speed_quantum=quantum, loop_period=STEP)
    speed_after(plant, command, 2.0)
    begin, count = plant.reading().left_angle, quantum * STEP
    speeds = []
    for _ in range(1000):
        speeds.append(speed_after(plant, command, STEP))
    counts = np.array(speeds) / quantum
    assert np.abs(counts - np.round(counts)).max() < 1e-9
    travelled = plant.reading().left_angle - begin
    assert abs(travelled - 10.0 * command) <= 2 * count  # of which the two readings round half a count each
    assert abs(np.mean(speeds) - command) < quantum
    assert begin / count == pytest.approx(round(begin / count), abs=1e-6)


def test_the_quantum_disturbs_the_speed() -> None:
    plant = ideal_but(motor_lag=0.08, speed_quantum=0.2244, loop_period=STEP)
    speed_after(plant, 3.37, 2.0)
    speeds = [plant.truth().v for _ in range(200) if speed_after(plant, 3.37, STEP)]
    assert 0.016 * 0.002 < np.std(speeds) < 0.016 * 0.2244 / 4


def test_deadband_and_stiction_make_a_hysteresis() -> None:
    plant = ideal_but(deadband=0.5, breakaway=0.7, motor_lag=0.08)
    assert speed_after(plant, 0.69, 2.0) == 0.0  # at rest it stays
    assert plant.truth()[:3] == (0.0, 0.0, 0.0)
    assert speed_after(plant, 0.71, 2.0) == pytest.approx(0.71, rel=1e-6)
    assert speed_after(plant, 0.51, 2.0) == pytest.approx(0.51, rel=1e-6)  # turning it goes on
    assert speed_after(plant, 0.49, 2.0) == 0.0
    assert speed_after(plant, 0.69, 2.0) == 0.0
    assert speed_after(plant, -0.71, 2.0) == pytest.approx(-0.71, rel=1e-6)


def test_a_stop_ends_at_rest() -> None:
    plant = Plant(GTERNAL, WORN, (0.0, 0.0, 0.0), np.random.default_rng(1))
    speed_after(plant, 12.0, 1.0)
    assert speed_after(plant, 0.0, 1.5) == 0.0
    rest = plant.truth()
    assert rest.v == 0.0
    speed_after(plant, 0.0, 1.0)
    assert plant.truth() == rest


def test_it_starts_again_after_a_stop_as_it_started_first() -> None:
    plant = ideal_but(motor_lag=0.08, speed_quantum=0.2244, loop_period=STEP)
    first = speed_after(plant, 5.0, 0.03)
    speed_after(plant, 5.0, 1.0)
    speed_after(plant, 0.0, 1.5)
    again = speed_after(plant, 5.0, 0.03)
    assert again == pytest.approx(first, abs=0.2244 * 1.5)  # the counts fall differently, no more

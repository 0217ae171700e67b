"""The firmware's speed loop: lag, encoder, deadband and stiction."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import Imperfections, WheelSpeeds
from robofleet.vehicles.plant import Plant

Make = Callable[..., Plant]
STEP = 0.01


def speed_after(plant: Plant, command: float, seconds: float) -> float:
    """Return the left wheel's speed after a command [rad/s]."""
    for _ in range(round(seconds / STEP)):
        plant.step(WheelSpeeds(command, command), STEP)
    return plant.reading().left_speed


def test_lag_reaches_63_percent_after_its_time_constant(ideal_but: Make) -> None:
    for tau in (0.05, 0.08, 0.2):
        assert speed_after(ideal_but(motor_lag=tau), 6.0, tau) == pytest.approx(6.0 * (1 - math.exp(-1)), rel=1e-9)


def test_lag_costs_the_distance_of_one_time_constant(ideal_but: Make) -> None:
    plant = ideal_but(motor_lag=0.08)
    speed_after(plant, 6.0, 2.0)
    assert plant.reading().left_angle == pytest.approx(6.0 * (2.0 - 0.08), rel=1e-9)


@pytest.mark.parametrize("command", [1.0, 3.37, 7.77, -5.05])
def test_the_encoder_counts_and_does_not_bias(ideal_but: Make, command: float) -> None:
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


def test_the_quantum_disturbs_the_speed(ideal_but: Make) -> None:
    plant = ideal_but(motor_lag=0.08, speed_quantum=0.2244, loop_period=STEP)
    speed_after(plant, 3.37, 2.0)
    speeds = [plant.truth().v for _ in range(200) if speed_after(plant, 3.37, STEP)]
    assert 0.016 * 0.002 < np.std(speeds) < 0.016 * 0.2244 / 4


def test_deadband_and_stiction_make_a_hysteresis(ideal_but: Make) -> None:
    plant = ideal_but(deadband=0.5, breakaway=0.7, motor_lag=0.08)
    assert speed_after(plant, 0.69, 2.0) == 0.0  # at rest it stays
    assert plant.truth()[:3] == (0.0, 0.0, 0.0)
    assert speed_after(plant, 0.71, 2.0) == pytest.approx(0.71, rel=1e-6)
    assert speed_after(plant, 0.51, 2.0) == pytest.approx(0.51, rel=1e-6)  # turning it goes on
    assert speed_after(plant, 0.49, 2.0) == 0.0
    assert speed_after(plant, 0.69, 2.0) == 0.0
    assert speed_after(plant, -0.71, 2.0) == pytest.approx(-0.71, rel=1e-6)


def test_a_stop_ends_at_rest(drive: DifferentialDrive, worn: Imperfections) -> None:
    plant = Plant(drive, worn, (0.0, 0.0, 0.0), np.random.default_rng(1))
    speed_after(plant, 12.0, 1.0)
    assert speed_after(plant, 0.0, 1.5) == 0.0
    rest = plant.truth()
    assert rest.v == 0.0
    speed_after(plant, 0.0, 1.0)
    assert plant.truth() == rest


def test_it_starts_again_after_a_stop_as_it_started_first(ideal_but: Make) -> None:
    plant = ideal_but(motor_lag=0.08, speed_quantum=0.2244, loop_period=STEP)
    first = speed_after(plant, 5.0, 0.03)
    speed_after(plant, 5.0, 1.0)
    speed_after(plant, 0.0, 1.5)
    again = speed_after(plant, 5.0, 0.03)
    assert again == pytest.approx(first, abs=0.2244 * 1.5)  # the counts fall differently, no more

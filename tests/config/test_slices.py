"""What was measured of a robot goes before what is known of its kind; the simulated robot stays what it is."""

import pytest

from robofleet.config import slices
from robofleet.config.load import load_config
from tests.shipped import PLATOON

MEASURED = "{robot: r1, wheel_radius_m: 0.0158, motor_lag_s: 0.061, delay_s: 0.045}"


def test_a_calibration_goes_before_the_vehicle() -> None:
    config = load_config(PLATOON, [f"robots.0.calibration={MEASURED}"])
    measured, other = slices.drive(config.robots[0]), slices.drive(config.robots[1])
    assert (measured.wheel_radius, measured.motor_lag) == (0.0158, 0.061)
    assert (measured.wheel_base, measured.max_wheel_speed) == (other.wheel_base, other.max_wheel_speed)
    assert other == slices.vehicle_drive(config.robots[0].vehicle)
    assert slices.delay_ns(config, config.robots[0]) == 45_000_000
    assert slices.delay_ns(config, config.robots[1]) == round(config.controller.command_delay_s * 1e9)


@pytest.mark.parametrize("value", ["0", "0.0"])
def test_a_measured_zero_is_a_measurement(value: str) -> None:
    config = load_config(PLATOON, [f"robots.0.calibration={{robot: r1, delay_s: {value}, motor_lag_s: {value}}}"])
    assert slices.delay_ns(config, config.robots[0]) == 0
    assert slices.drive(config.robots[0]).motor_lag == 0.0

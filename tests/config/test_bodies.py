"""Robots that cannot be are refused, at the key that is most probably wrong."""

from pathlib import Path

import pytest

from robofleet.config.load import ConfigError, load_config

CONFIGS = Path(__file__).parents[2] / "configs"
VEHICLE = "robots.1.vehicle"


def faults_of(*overrides: str) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load_config(CONFIGS / "platoon.yaml", [f"robots.1.{override}" for override in overrides])
    return caught.value.faults


@pytest.mark.parametrize(
    ("override", "key", "message"),
    [
        ("vehicle.wheel_radius_m=16", "vehicle.wheel_radius_m", "(is 16 in mm?)"),
        (
            "vehicle.wheel_radius_m=0.06",
            "vehicle.wheel_radius_m",
            "larger than a body of body_radius_m 0.055: mend one",
        ),
        ("vehicle.wheel_base_m=105", "vehicle.wheel_base_m", "(is 105 in mm?)"),
        ("vehicle.wheel_base_m=0.16", "vehicle.wheel_base_m", "outside a body of body_radius_m 0.055: mend one"),
        ("vehicle.body_radius_m=0.0055", "vehicle.body_radius_m", "less than a wheel's radius"),
        ("vehicle.body_radius_m=0.0535", "vehicle.body_radius_m", "no room for the wheels: 0.0549 at least"),
        ("vehicle.wheel_radius_m=0.0016", "vehicle.max_speed_m_s", "0.02 m/s: lower it, or mend"),
        ("vehicle.max_speed_m_s=200", "vehicle.max_speed_m_s", "200 m/s is far more than these wheels give, 0.2 m/s"),
        ("calibration={robot: r2, wheel_radius_m: 15.7}", "calibration.wheel_radius_m", "(is 15.7 in mm?)"),
        ("calibration={robot: r2, wheel_base_m: 0.05}", "calibration.wheel_base_m", "its vehicle has 0.105: mend one"),
    ],
)
def test_a_robot_that_cannot_be_is_refused_in_one_line(override: str, key: str, message: str) -> None:
    (fault,) = faults_of(override)
    assert f"{key.rsplit('.', maxsplit=1)[-1]}: " in fault
    assert message in fault


@pytest.mark.parametrize("name", ["gternal", "ideal", "arduino", "create2"])
def test_every_shipped_kind_of_robot_can_be(name: str) -> None:
    load_config(CONFIGS / "platoon.yaml", [f"{VEHICLE}={name}"])


def test_a_worn_robot_may_be_measured() -> None:
    load_config(
        CONFIGS / "platoon.yaml", ["robots.1.calibration={robot: r2, wheel_radius_m: 0.0125, wheel_base_m: 0.12}"]
    )

"""Every driver keeps the contract."""

import math
from typing import Any

import pytest
from pydantic import ValidationError

from robofleet.core.plugins import load
from robofleet.testing import DriverContract, DriverSubject


class TestSimulated(DriverContract):
    subject = DriverSubject("simulated", twin=None)


class TestGTernal(DriverContract):
    subject = DriverSubject("gternal", twin="gternal", vehicle="gternal", encoders=False)


@pytest.mark.slow  # but for its sensors it is as the one before; test_gternal_sensors has those
class TestGTernalWithSensors(DriverContract):
    subject = DriverSubject("gternal", twin="gternal", vehicle="gternal", sensors=True, encoders=False)


@pytest.mark.slow
class TestArduinoBridge(DriverContract):
    subject = DriverSubject(
        "arduino_bridge", twin="arduino_bridge", vehicle="arduino", settings={"counts_per_turn": 2248}
    )


@pytest.mark.slow
class TestCreate2(DriverContract):
    subject = DriverSubject("create2", twin="create2", vehicle="create2")


@pytest.mark.slow  # its twin's loop looks every 5 ms
class TestRfp(DriverContract):
    subject = DriverSubject(
        "rfp", twin="rfp", vehicle="rfp", settings={"counts_per_turn": 2248, "battery_v": [6.0, 8.4]}
    )


@pytest.mark.parametrize(
    ("driver", "wrong"),
    [
        ("gternal", {"wheel_radius_m": 0.0}), ("gternal", {"wheel_base_m": math.nan}), ("gternal", {"port": ""}),
        ("gternal", {"wheel_radius_m": "16 mm"}), ("gternal", {"baud": 9600}), ("create2", {"port": ""}),
        ("create2", {"mode": "passive"}), ("create2", {"wheel_diameter_m": 0.0}), ("create2", {"a": 1}),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(driver: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        load("robofleet.drivers", driver).Settings.model_validate({"port": "/dev/ttyUSB0"} | wrong)

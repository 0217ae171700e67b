"""The driver that drivers/YOUR_OWN.md shows keeps the contract, as it stands there."""

import pytest

from robofleet.testing import DriverContract, DriverSubject
from tests.drivers.sparrow import CODE


@pytest.mark.slow  # the contract itself is tested with the gternal
class TestExample(DriverContract):
    subject = DriverSubject("tests.drivers.sparrow:Sparrow", twin="tests.drivers.sparrow:SparrowFirmware")


def test_it_is_forty_lines() -> None:
    assert len([line for line in CODE.splitlines() if line]) <= 40

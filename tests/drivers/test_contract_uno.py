"""The drivers' contract, of the driver of rfp and the binary that is flashed on an Uno, in simavr."""

import pytest

from robofleet.testing import DriverContract, DriverSubject
from tests.simulation.uno import UNO_SETTINGS, require_avr

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True, scope="module")
def _avr() -> None:
    require_avr()


class TestUno(DriverContract):
    subject = DriverSubject(
        "rfp",
        twin="arduino_uno",
        vehicle="arduino_uno",
        settings={**UNO_SETTINGS, "gains": [400, 160, 488]},
    )

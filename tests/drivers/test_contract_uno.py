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
    # An hour of the binary takes long; the driver's memory is the same with the host's build (test_contract.py).
    test_its_memory_does_not_grow_in_an_hour = None  # type: ignore[assignment]

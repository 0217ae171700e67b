"""The drivers' contract, of the driver of rfp and the binary that is flashed on an Uno, in simavr."""

import pytest

from robofleet.simulation.avr.board import NoAvrError, image
from robofleet.testing import DriverContract, DriverSubject

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True, scope="module")
def _avr() -> None:
    try:
        image("uno")
    except NoAvrError as error:
        pytest.skip(str(error))


class TestUno(DriverContract):
    subject = DriverSubject(
        "rfp",
        twin="arduino_uno",
        vehicle="arduino_uno",
        settings={"counts_per_turn": 2248, "baud": 250000, "gains": [400, 160, 488]},
    )

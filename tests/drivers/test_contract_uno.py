"""The drivers' contract, of the driver of rfp and the binary that is flashed on an Uno, in simavr."""

import pytest

from robofleet.config.troubles import LineFault
from robofleet.testing import DriverContract, DriverSubject
from robofleet.testing.driver_bench import DriverBench
from tests.simulation.uno import UNO_SETTINGS, require_avr

pytestmark = pytest.mark.slow


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

    def test_on_a_bad_line_there_is_no_wrong_motion(self) -> None:
        with DriverBench(self.subject, LineFault(kind="line_garbage", at_s=0.0, duration_s=1.0, share=0.3)) as bench:
            self.driven(bench)
            bench.strike()
            bench.drive_on(self.setpoint, 1.0, hold=True)
            assert bench.twin is not None
            assert bench.twin.ledger is not None
            assert bench.twin.ledger.wrong == 0

    # An hour of the binary takes long; the driver's memory is the same with the host's build (test_contract.py).
    test_its_memory_does_not_grow_in_an_hour = None  # type: ignore[assignment]

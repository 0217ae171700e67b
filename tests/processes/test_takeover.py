"""Who takes robots from another controller does so once; otherwise two of them would take turns."""

from typing import Any

from robofleet.clock import SimulatedClock
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import LEASE
from robofleet.comms.messages import LEASE_REQUEST
from robofleet.processes.leases import Leases
from robofleet.safety.gate import LeaseAction
from tests.comms.alone import RobotStatus

OURS, THEIRS = 5, 9


def held_by(session: int) -> Any:
    return RobotStatus(1, 1, 1, session, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, -1, -1, *(0.0,) * 9)


def test_a_robot_that_was_taken_over_and_lost_again_is_only_asked_for() -> None:
    bus = MemoryBus("lab", SimulatedClock(), 0)
    served = bus.serve(LEASE, "r1")
    leases = Leases(bus, ["r1"], OURS, take_over=True)

    def actions(session: int) -> set[int]:
        """Return what is asked of the driver while its lease is held by somebody."""
        for _ in range(30):
            leases.update([held_by(session)])
        asked = set()
        while (request := served()) is not None:
            message = LEASE_REQUEST.decode(request.payload)
            assert message is not None
            assert message.session == OURS
            asked.add(message.action)
        return asked

    assert actions(THEIRS) == {LeaseAction.TAKE_OVER}
    assert actions(OURS) == set()
    assert actions(THEIRS) == {LeaseAction.ACQUIRE}


def test_without_being_told_to_nobody_takes_a_robot_over() -> None:
    bus = MemoryBus("lab", SimulatedClock(), 0)
    served = bus.serve(LEASE, "r1")
    leases = Leases(bus, ["r1"], OURS)
    leases.update([held_by(THEIRS)])
    request = served()
    assert request is not None
    asked = LEASE_REQUEST.decode(request.payload)
    assert asked is not None
    assert asked.action == LeaseAction.ACQUIRE

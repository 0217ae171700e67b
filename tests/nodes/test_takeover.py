"""Who takes robots from another controller does so once; otherwise two of them would take turns."""

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import LEASE, STATUS
from robofleet.bus.messages import LEASE_REQUEST
from robofleet.bus.statuses import Statuses
from robofleet.core.clock import SimulatedClock
from robofleet.nodes.controller import Leases
from robofleet.safety.gate import LeaseAction
from tests.bus.alone import ROBOT_STATUS, RobotStatus

OURS, THEIRS = 5, 9


class Held:
    """A robot's word of who holds its lease, as a controller hears it."""

    def __init__(self) -> None:
        self.bus = MemoryBus("lab", SimulatedClock(), 0)
        self.served = self.bus.serve(LEASE, "r1")
        self.statuses = Statuses(self.bus, {"r1": ("r1",)}, ("r1",))
        self._nonce = 0

    def by(self, session: int) -> None:
        self._nonce += 1
        status = RobotStatus(1, 1, 1, session, 1, self._nonce, 1, 0, 0, 0, 0, 0, 0, 0, 0, -1, -1, *(0.0,) * 9)
        self.bus.publisher(STATUS, "r1")(ROBOT_STATUS.encode(status))
        assert self.statuses.take() == [0]


def test_a_robot_that_was_taken_over_and_lost_again_is_only_asked_for() -> None:
    held = Held()
    leases = Leases(held.bus, held.statuses, OURS, take_over=True)

    def actions(session: int) -> set[int]:
        """Return what is asked of the driver while its lease is held by somebody."""
        for _ in range(30):
            held.by(session)
            leases.update()
        actions_seen = set()
        while (request := held.served()) is not None:
            message = LEASE_REQUEST.decode(request.payload)
            assert message is not None
            assert message.session == OURS
            actions_seen.add(message.action)
        return actions_seen

    assert actions(THEIRS) == {LeaseAction.TAKE_OVER}
    assert actions(OURS) == set()
    assert actions(THEIRS) == {LeaseAction.ACQUIRE}


def test_without_being_told_to_nobody_takes_a_robot_over() -> None:
    held = Held()
    leases = Leases(held.bus, held.statuses, OURS)
    held.by(THEIRS)
    leases.update()
    request = held.served()
    assert request is not None
    request_message = LEASE_REQUEST.decode(request.payload)
    assert request_message is not None
    assert request_message.action == LeaseAction.ACQUIRE

"""The leases of a controller: by them every robot obeys one controller alone."""

from robofleet.comms.bus import Answer, Bus
from robofleet.comms.keys import LEASE
from robofleet.comms.messages import LEASE_REQUEST, LeaseRequest, RobotStatus
from robofleet.safety.gate import LeaseAction

_ASK_AGAIN_TICKS = 10


class Leases:
    """The leases of this controller: asked for until every driver has granted it, or somebody else holds one.

    ``take_over``: each is taken once also from a controller that is alive; who loses it then does not take it back.
    """

    def __init__(self, bus: Bus, robots: list[str], session: int, *, take_over: bool = False) -> None:
        self._bus, self._robots, self.session = bus, robots, session
        self._actions = [LeaseAction.TAKE_OVER if take_over else LeaseAction.ACQUIRE] * len(robots)
        self._asked: list[Answer | None] = [None] * len(robots)
        self._again = [0] * len(robots)
        self.refused = False  # somebody else holds the lease of a robot

    def update(self, newest: list[RobotStatus | None]) -> None:
        """Ask every driver that is there and is not ours, every few ticks."""
        self.refused = any(status is not None and status.session not in (0, self.session) for status in newest)
        for row, status in enumerate(newest):
            if status is None:
                continue
            if status.session == self.session:
                self._actions[row] = LeaseAction.ACQUIRE
                continue
            self._again[row] -= 1
            if self._again[row] < 0:
                self._again[row] = _ASK_AGAIN_TICKS
                request = LEASE_REQUEST.encode(LeaseRequest(self.session, self._actions[row]))
                self._asked[row] = self._bus.ask(LEASE, self._robots[row], request)

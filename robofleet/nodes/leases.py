"""The leases of a controller: by them every robot obeys one controller alone."""

import numpy as np

from robofleet.bus.bus import Answer, Bus
from robofleet.bus.keys import LEASE
from robofleet.bus.messages import LEASE_REQUEST, LeaseRequest
from robofleet.bus.statuses import Statuses
from robofleet.safety.gate import LeaseAction

_ASK_AGAIN_TICKS = 10


class Leases:
    """The leases of this controller: asked for until every unit has granted them, or somebody else holds one.

    ``take_over``: each is taken once also from a controller that is alive; who loses it then does not take it back.
    """

    def __init__(self, bus: Bus, statuses: Statuses, session: int, *, take_over: bool = False) -> None:
        self._bus, self._statuses, self.session = bus, statuses, session
        units = statuses.units
        self._actions = [LeaseAction.TAKE_OVER if take_over else LeaseAction.ACQUIRE] * len(units)
        self._requests: list[Answer | None] = [None] * len(units)
        self._again = [0] * len(units)
        self._session = np.uint64(session)
        self._held = statuses.robots["session"]  # (N,) by whom; a view
        self.mine = np.zeros(len(statuses.robots), np.bool_)  # (N,) which robots answer to this controller
        self.refused = False  # somebody else holds the lease of a robot

    def update(self) -> None:
        """Ask every unit that is there and of which a robot is not ours, every few ticks."""
        np.equal(self._held, self._session, out=self.mine)
        if self.mine.all():
            self.refused = False
            self._actions = [LeaseAction.ACQUIRE] * len(self._actions)
            return
        self.refused = bool((~self.mine & (self._held != 0)).any())
        for number, unit in enumerate(self._statuses.units):
            if self._statuses.newest[number] is None:
                continue
            if self.mine[unit.rows].all():
                self._actions[number] = LeaseAction.ACQUIRE
                continue
            self._again[number] -= 1
            if self._again[number] < 0:
                self._again[number] = _ASK_AGAIN_TICKS
                request = LEASE_REQUEST.encode(LeaseRequest(self.session, self._actions[number]))
                self._requests[number] = self._bus.ask(LEASE, unit.name, request)

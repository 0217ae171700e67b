"""When a unit tells its status: by a cable as often as it likes, by a radio as seldom as its nonces allow.

A status carries the nonce that the next command and the next permission echo. A gate closes 120 ms after the newest
nonce that it has heard again (``safety.gate``), so a status is worth most shortly before somebody answers it.
"""

from typing import TYPE_CHECKING

from robofleet.bus.messages import LinkState
from robofleet.core.clock import MS, S
from robofleet.nodes.unit.link import BAD_LINK_NS, NO_LINK_NS

if TYPE_CHECKING:
    from robofleet.nodes.unit.gated_robot import Robots

_NEVER_NS = (1 << 63) - 1


class ByCable:
    """Every second loop, and in every loop for a while after the link was bad: packets cost nothing."""

    def __init__(self) -> None:
        self.hurry = LinkState.GOOD  # what the status says
        self.next_ns = _NEVER_NS  # when to ask at the latest
        self._loops = 0

    def heard(self, now_ns: int) -> None:
        """Note that a command came."""

    def due(self, _now_ns: int, robots: "Robots", *, loop: bool) -> bool:
        """Return whether to tell now; ``loop``: 10 ms are over."""
        self.hurry = LinkState.BAD if robots.hurries else LinkState.GOOD
        self._loops += loop
        return loop and (self.hurry is LinkState.BAD or self._loops % 2 == 1)

    def told(self, now_ns: int) -> None:
        """Note that a status went out."""


class ByRadio(ByCable):
    """Once for each command, so that the next one echoes it; in every loop while no answer comes.

    A packet of a radio costs 100 to 200 us of the air that all robots share, whatever its size.
    """

    _AFTER_NS = 15 * MS  # a command: the status arrives before the next tick where the link takes up to 9 ms each way
    _SILENT_NS = 40 * MS  # without a command
    _LATE_NS = 80 * MS  # in health a gate lives on nonces of up to 70 ms: an enable answers every second status
    _WATCHED_NS = 10 * S  # after it was bad: an enable answers every status, so that BAD_LINK_NS is late

    def __init__(self) -> None:
        super().__init__()
        self._told_ns = 0
        self._bad_until_ns = 0
        self._was_open = False  # a gate: before, late messages are those of processes that start

    def heard(self, now_ns: int) -> None:
        self.next_ns = min(self.next_ns, now_ns + self._AFTER_NS)

    def due(self, now_ns: int, robots: "Robots", *, loop: bool) -> bool:
        self._was_open = self._was_open or robots.any_open
        watched = now_ns < self._bad_until_ns <= now_ns + self._WATCHED_NS  # unless the clock was set back
        late_ns = BAD_LINK_NS if watched else self._LATE_NS
        late = self._was_open and late_ns < now_ns - robots.newest_nonce_ns < NO_LINK_NS
        if late:
            self._bad_until_ns = now_ns + self._WATCHED_NS
        self.hurry = LinkState.BAD if late else LinkState.WAS_BAD if watched else LinkState.GOOD
        if self.next_ns - now_ns > S:  # none is planned, or the clock was set back
            self.next_ns = _NEVER_NS
        silent = not 0 <= now_ns - self._told_ns < self._SILENT_NS
        return now_ns >= self.next_ns or (loop and (late or silent))

    def told(self, now_ns: int) -> None:
        self.next_ns, self._told_ns = _NEVER_NS, now_ns

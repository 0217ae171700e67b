"""When a unit tells its status: by a cable as often as it likes, by a radio as seldom as its nonces allow.

A status carries the nonce that the next command and the next permission echo. A gate closes 120 ms after the newest
nonce that it has heard again (``safety.gate``), so a status is worth most shortly before somebody answers it.
"""

from typing import Protocol

from robofleet.clock import MS, S
from robofleet.processes.gated_robot import BAD_LINK_NS, NO_LINK_NS


class Telling(Protocol):
    """One way to tell."""

    hurry: bool  # what the status says: the link is bad, so those who hear it should speak more often

    def heard(self, now_ns: int) -> None:
        """Note that a command came."""

    def due(self, now_ns: int, *, loop: bool, newest_nonce_ns: int, was_bad: bool) -> bool:
        """Whether to tell now. ``loop``: 10 ms are over; ``newest_nonce_ns``: by which the gates live."""

    def told(self, now_ns: int) -> None:
        """Note that a status went out."""

    @property
    def next_ns(self) -> int:
        """When to ask at the latest."""


_NEVER_NS = (1 << 63) - 1


class ByCable:
    """Every second loop, and in every loop for a while after the link was bad: packets cost nothing."""

    next_ns = _NEVER_NS

    def __init__(self) -> None:
        self.hurry = False
        self._loops = 0

    def heard(self, now_ns: int) -> None:
        """Nothing depends on it."""

    def due(self, now_ns: int, *, loop: bool, newest_nonce_ns: int, was_bad: bool) -> bool:
        """Return whether it is time."""
        self.hurry = was_bad
        self._loops += loop
        return loop and (was_bad or self._loops % 2 == 1)

    def told(self, now_ns: int) -> None:
        """Nothing depends on it."""


class ByRadio:
    """Once for each command, so that the next one echoes it; in every loop while no answer comes.

    A packet of a radio costs 100 to 200 us of the air that all robots share, whatever its size.
    """

    _AFTER_NS = 15 * MS  # a command: the status arrives before the next tick where the link takes up to 9 ms each way
    _SILENT_NS = 40 * MS  # without a command

    def __init__(self) -> None:
        self.hurry = False
        self.next_ns = _NEVER_NS
        self._told_ns = 0

    def heard(self, now_ns: int) -> None:
        """Plan the next status."""
        self.next_ns = min(self.next_ns, now_ns + self._AFTER_NS)

    def due(self, now_ns: int, *, loop: bool, newest_nonce_ns: int, was_bad: bool) -> bool:
        """Return whether it is time."""
        self.hurry = BAD_LINK_NS < now_ns - newest_nonce_ns < NO_LINK_NS
        if self.next_ns - now_ns > S:  # none is planned, or the clock was set back
            self.next_ns = _NEVER_NS
        silent = not 0 <= now_ns - self._told_ns < self._SILENT_NS
        return now_ns >= self.next_ns or (loop and (self.hurry or silent))

    def told(self, now_ns: int) -> None:
        """Note it."""
        self.next_ns, self._told_ns = _NEVER_NS, now_ns

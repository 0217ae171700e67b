"""What the launcher needs of the operator's side, which whoever starts a run passes in: it imports none of it."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from robofleet.bus.bus import Bus
from robofleet.core.clock import Clock
from robofleet.core.starting import Starting

EMERGENCY_KEYS = frozenset("e ")
ENDING = "ending"  # a phase: how the run ended is known, and its processes end
READY = "ready"  # a phase: every process is ready, and the run has not begun


class Interrupts(Protocol):
    """The signals that ask for the end of a run."""

    count: int
    hung_up: bool  # the terminal was closed


class StopResult(Protocol):
    """What came of an emergency stop."""

    @property
    def silent(self) -> tuple[str, ...]:
        """Robots that did not report a latched gate in time."""

    def describe(self) -> str:
        """Return the result in words."""


class Console(Protocol):
    """The operator at a run: keys, signals, what is shown, and the emergency stop."""

    lost: bool  # the terminal was closed
    note: str  # what the operator should read
    starting: Starting | None  # how far the start is; None: it is over
    emergency: Callable[[], object]  # called at once, from another thread, when an emergency key is pressed

    @property
    def present(self) -> bool:
        """Whether somebody can press a key."""

    def keys(self, clock: Clock, until_ns: int) -> str:
        """Return the keys pressed by an instant, as soon as there is one."""

    def interrupts(self) -> AbstractContextManager[Interrupts]:
        """Count signals instead of ending by them."""

    def emergency_stop(self, bus: Bus, clock: Clock, units: Mapping[str, Sequence[str]]) -> StopResult:
        """Stop every robot and latch its gate."""

    def page_found(self, addresses: str, *, browser: bool) -> None:
        """Show where the operator's page is, as its process says; ``browser``: open it."""

    def page_gone(self) -> None:
        """Show that the page's process has ended."""

    def viewers_found(self, viewer: str, line: str) -> None:
        """Show where viewers of a kind find the run."""

    def viewers_gone(self, viewer: str, log: Path) -> None:
        """Show that the process that serves these viewers has ended."""

"""What a storm records of a run: every decision of every gate, and when every message was sent.

It keeps references only: a run must not slow down because it is watched. ``gates.py`` and ``fleet.py`` judge later.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import NamedTuple

from robofleet.bus.bus import MemoryBus
from robofleet.core.clock import Clock
from robofleet.safety.gate import GateState, Inputs
from robofleet.safety.latches import GateStatus
from robofleet.vehicles.interface import STOP


class GateDecision(NamedTuple):
    """One step of a gate."""

    true_ns: int  # lockstep's own clock, that no fault touches
    now_ns: int  # the driver's
    inputs: Inputs
    state: GateState


class Ledger:
    """The decisions of each robot's gate and the instants of each key's messages, oldest first."""

    _now_ns: Callable[[], int]

    def __init__(self) -> None:
        self.decisions: dict[str, list[GateDecision]] = defaultdict(list)
        self.sent_ns: dict[str, list[int]] = defaultdict(list)

    def follow(self, clock: Clock, bus: MemoryBus) -> None:
        """Take the time from here on, and hear what is said."""
        self._now_ns = clock.now_ns
        bus.tap(self._take)

    def turning(self) -> set[str]:
        return {robot for robot, rows in self.decisions.items() if rows[-1].state.target != STOP}

    def obeying(self) -> set[str]:
        """Return the robots whose gates let through what their controller commands, be it to stand."""
        return {robot for robot, rows in self.decisions.items() if rows[-1].state.status == GateStatus.OPEN}

    def forget(self) -> None:
        self.decisions.clear()
        self.sent_ns.clear()

    def probe(self, robot: str, now_ns: int, inputs: Inputs, state: GateState) -> None:
        self.decisions[robot].append(GateDecision(self._now_ns(), now_ns, inputs, state))

    def _take(self, message: tuple[str, bytes]) -> None:
        """Keep when a message was said; what it says is in the recording, in the same order."""
        self.sent_ns[message[0]].append(self._now_ns())


class Span(NamedTuple):
    """From when until when something was so [lockstep's clock, ns]."""

    start_ns: float
    end_ns: float


class Violation(NamedTuple):
    """One invariant that did not hold."""

    invariant: str
    at_s: float  # simulated time since the lockstep began
    robot: str  # "" where it is not about one
    numbers: str

    def __str__(self) -> str:
        who = f"{self.robot}: " if self.robot else ""
        return f"{self.at_s:.4f} s: {who}{self.invariant}: {self.numbers}"

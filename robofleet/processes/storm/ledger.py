"""What a storm sees of a run: every decision of every gate, and when every message was said.

It keeps references only: a run must not slow down because it is watched. ``gates.py`` and ``fleet.py`` judge later.
"""

from collections import defaultdict
from typing import NamedTuple

from robofleet.clock import S, Clock
from robofleet.safety.gate import GateOutput, GateState, Inputs


class Decision(NamedTuple):
    """One step of a gate."""

    true_ns: int  # lockstep's own clock, that no fault touches
    now_ns: int  # the driver's
    inputs: Inputs
    state: GateState
    output: GateOutput


class Ledger:
    """The decisions of each robot's gate and the instants of each key's messages, oldest first."""

    def __init__(self, clock: Clock) -> None:
        self._now_ns = clock.now_ns
        self.decisions: dict[str, list[Decision]] = defaultdict(list)
        self.said_ns: dict[str, list[int]] = defaultdict(list)

    def witness(self, robot: str, now_ns: int, inputs: Inputs, state: GateState, output: GateOutput) -> None:
        """Keep what a gate decided."""
        self.decisions[robot].append(Decision(self._now_ns(), now_ns, inputs, state, output))

    def heard(self, message: tuple[str, bytes]) -> None:
        """Keep when a message was said; what it says is in the recording, in the same order."""
        self.said_ns[message[0]].append(self._now_ns())


class Outage(NamedTuple):
    """A process that did not run, or whose clock was changed, for a while [lockstep's clock, s]."""

    process: str
    start_s: float
    end_s: float

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """Whether it lies between two instants, or overlaps them."""
        return start_ns < self.end_s * S and end_ns >= self.start_s * S

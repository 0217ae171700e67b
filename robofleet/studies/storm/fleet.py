"""Invariants of the whole run: wheels turn only in phases that permit it, and every stop has a cause and an end."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.layouts import VERSION
from robofleet.bus.messages import RUN_STATE
from robofleet.config.troubles import InjectedFault
from robofleet.core.arrays import Array, Flags
from robofleet.core.clock import MS, S
from robofleet.safety.supervisor import CAUSES, Event, Phase
from robofleet.studies.storm.gates import intervals
from robofleet.studies.storm.ledger import Violation

# After how long such a fault has to have stopped a robot, or all of them.
_STOPS_WITHIN_S = {
    "wired_stop": 0.3, "low_battery": 0.5, "pose_dropout": 0.4, "duplicate_tag": 1.0, "camera_stalled": 1.0,
    "camera_frozen": 1.5, "killed": 1.2, "stopped": 1.2, "network_cut": 1.2, "disk_full": 1.0,
}  # fmt: skip
_WITHIN_NS = 130 * MS  # of a state that lets a robot's wheels turn no longer


class States(NamedTuple):
    """Every state that the supervisor said, oldest first."""

    sent_ns: Array
    heads: NDArray[Any]  # the layout's columns; ``items``: one a robot

    @classmethod
    def of(cls, sent_ns: list[int], payloads: list[bytes], robots: int) -> "States":
        dtype = RUN_STATE.dtype(robots)
        assert all(len(p) == dtype.itemsize and p[0] == VERSION for p in payloads), "a state that nobody can read"
        return cls(np.array(sent_ns, dtype=np.float64), np.frombuffer(b"".join(payloads), dtype=dtype))

    def running(self) -> Flags:
        return np.asarray(self.heads["phase"] == Phase.RUNNING)

    def free(self, row: int) -> Flags:
        """Return in which a robot's wheels may turn."""
        items = self.heads["items"]
        tried = (self.heads["phase"] == Phase.ARMED) & (items["stroke"][:, row] > 0)
        return np.asarray(tried | (self.running() & (items["permitted"][:, row] == 1)))

    def events(self) -> set[Event]:
        causes = {*self.heads["cause"].tolist(), *self.heads["items"]["cause"].ravel().tolist()}
        return {Event(cause) for cause in causes if cause in CAUSES}


def moved_unasked(states: States, row: int, robot: str, targets: Array) -> list[Violation]:
    """Find wheels that turn although no state let them. ``targets``: instant [ns], target not zero, (K, 2)."""
    free = states.free(row)
    at_ns = targets[targets[:, 1] > 0, 0]
    state = np.searchsorted(states.sent_ns, at_ns, side="right") - 1
    wrong = np.ones(len(at_ns), dtype=np.bool_)
    for first, last in intervals(free):
        end_ns = states.sent_ns[last + 1] if last + 1 < len(free) else np.inf
        wrong &= ~((at_ns >= states.sent_ns[first]) & (at_ns <= end_ns + _WITHIN_NS))
    invariant = "wheels turn while the run's state does not let them"
    return [
        Violation(invariant, at_ns[k] / S, robot, _phase(states, int(state[k])).name) for k in np.flatnonzero(wrong)[:3]
    ]


def without_cause(states: States, robots: tuple[str, ...]) -> list[Violation]:
    """Find ends of a run, and halts of single robots, that name no cause."""
    heads, running, found = states.heads, states.running(), []
    same = heads["epoch"][1:] == heads["epoch"][:-1]
    ended = np.flatnonzero(running[:-1] & ~running[1:] & same & (heads["cause"][1:] == Event.NOTHING))
    found += [
        Violation("the run ended without a cause", states.sent_ns[k + 1] / S, "", _phase(states, k + 1).name)
        for k in ended.tolist()
    ]
    items = heads["items"]
    halted = running[:, None] & (items["permitted"] == 0) & (items["cause"] == Event.NOTHING)
    for row, robot in enumerate(robots):
        found += [
            Violation("the robot was halted without a cause", states.sent_ns[k] / S, robot, "RUNNING")
            for k, _ in intervals(halted[:, row])
        ]
    return found


def unanswered(states: States, robots: int, faults: Iterable[InjectedFault], run_ns: int) -> list[Violation]:
    """Find faults that must stop one of so many robots or the run, and during which all were free to move."""
    free = np.logical_and.reduce([states.free(row) for row in range(robots)])
    free &= states.running()
    found = []
    for fault in faults:
        within_s = _STOPS_WITHIN_S.get(fault.kind, np.inf)
        if fault.at_s is None or fault.duration_s is None or fault.duration_s < within_s:
            continue
        start_ns, end_ns = run_ns + fault.at_s * S, run_ns + (fault.at_s + within_s) * S
        first, last = np.searchsorted(states.sent_ns, [start_ns, end_ns], side="right").tolist()
        spoken = last > first > 0 and states.sent_ns[last - 1] > end_ns - 100 * MS
        if spoken and free[first - 1 : last].all():
            numbers = f"{fault.kind} since {start_ns / S:.3f} s"
            found.append(Violation("nothing stopped, though something had to", end_ns / S, "", numbers))
    return found


def _phase(states: States, row: int) -> Phase:
    return Phase(int(states.heads["phase"][max(row, 0)]))

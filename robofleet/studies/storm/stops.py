"""Invariants of an operator's emergency stop, whatever the supervisor does meanwhile.

Every gate that can be reached latches within 100 ms and keeps its latch until somebody asks for a reset, and a
supervisor that is awake lets nobody go on.
"""

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from robofleet.core.clock import MS, S
from robofleet.core.patterns import driver_role
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Phase
from robofleet.simulation.faults import Schedule
from robofleet.studies.storm.fleet import States
from robofleet.studies.storm.ledger import GateDecision, Span, Violation

_WITHIN_NS = 100 * MS
_STANDS_WITHIN_NS = 300 * MS  # of a supervisor that is awake
_AFTER_NS = S // 2  # what a network held back may still come so long after
_ON_THE_WAY = ("lost", "late", "duplicated", "reordered", "not_a_number", "malformed")
_TOPICS = {"enable", "status"}


def stops(requested_ns: Sequence[int], resets_ns: Sequence[int]) -> list[Span]:
    """Return from when until when each emergency stop must hold: until the next request for a reset."""
    return [Span(ns, min((reset for reset in resets_ns if reset > ns), default=np.inf)) for ns in requested_ns]


def out_of_reach(faults: Schedule, robot: str) -> list[Span]:
    """Return when a robot's gate may not hear, or not be heard of."""
    unit, mates = next((unit, robots) for unit, robots in faults.units.items() if robot in robots)
    driver = driver_role(unit)  # one message is for all of the unit: what strikes a robot's strikes its mates'
    found = []
    for injection in faults.injections:
        fault = injection.fault
        own = fault.kind in ("killed", "stopped", "clock_step") and fault.process == driver
        cut = fault.kind == "network_cut" and bool({driver, "supervisor"} & set(fault.processes))
        lossy = fault.kind in _ON_THE_WAY and bool(_TOPICS & set(fault.topics)) and fault.robot in (None, *mates)
        if own or cut or lossy:
            found.append(Span(injection.start_ns, injection.end_ns + _AFTER_NS))
    return found


def unlatched(
    robot: str, decisions: Sequence[GateDecision], requests: Sequence[Span], outages: Sequence[Span]
) -> list[Violation]:
    """Find stops that did not latch a gate in time, and latches that went before a reset was asked for."""
    found = []
    at_ns = [decision.true_ns for decision in decisions]
    for stop in requests:
        due_ns = stop.start_ns + _WITHIN_NS
        if _meets(outages, stop.start_ns, due_ns):
            continue
        first, due = bisect_right(at_ns, stop.start_ns), bisect_right(at_ns, due_ns)
        shut = [row for row in range(max(0, first - 1), due) if decisions[row].state.latch > Latch.DRILL]
        if not shut:
            found.append(Violation("an emergency stop has not latched the gate", due_ns / S, robot, f"{stop}"))
            continue
        until_ns = min([stop.end_ns, *(outage.start_ns for outage in outages if outage.start_ns > due_ns)])
        for row in range(shut[0], bisect_right(at_ns, until_ns)):
            if decisions[row].state.latch <= Latch.DRILL:
                found.append(Violation("the latch went before a reset was asked for", at_ns[row] / S, robot, f"{stop}"))
                break
    return found


def going_on(
    states: States, requests: Sequence[Span], asleep: Sequence[Span], outages: Sequence[Span]
) -> list[Violation]:
    """Find states that let the fleet go on after a stop.

    ``asleep``: when the supervisor did not run; ``outages``: when some gate may not have heard of the stop, nor it of
    the gate.
    """
    found = []
    phases = states.heads["phase"]
    for stop in requests:
        due_ns = float(stop.start_ns + _STANDS_WITHIN_NS)
        for outage in sorted(asleep):
            if outage.start_ns <= due_ns:
                due_ns = max(due_ns, outage.end_ns + _STANDS_WITHIN_NS)
        if _meets(outages, stop.start_ns, due_ns):
            continue
        first, last = np.searchsorted(states.sent_ns, [due_ns, stop.end_ns]).tolist()
        wrong = np.flatnonzero(np.isin(phases[first:last], (Phase.RUNNING, Phase.HOLD)))
        if len(wrong):
            at_ns = states.sent_ns[first + int(wrong[0])]
            found.append(Violation("the run went on after an emergency stop", at_ns / S, "", f"{stop}"))
    return found


def _meets(outages: Sequence[Span], start_ns: float, end_ns: float) -> bool:
    return any(outage.start_ns <= end_ns and outage.end_ns >= start_ns for outage in outages)

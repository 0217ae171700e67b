"""Every stop of a robot while a run was on: when, why, and how long it took."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.recording.causes import driven_out, halt_cause, named, run_cause
from robofleet.recording.run import Run
from robofleet.recording.run_clock import time_words
from robofleet.safety.latches import GateStatus
from robofleet.safety.supervisor import Event, Phase

_WHY_WITHIN_NS = 1_000_000_000  # a gate that closes by itself does so before the supervisor knows why
_SOON_STATUSES = 3  # a gate may close before the news that the run ended is here
_REQUESTED = range(Event.START_REQUESTED, Event.DRIVER_SILENT)
_BY_OPERATOR = (Event.HOLD_REQUESTED, Event.ESTOP_REQUESTED, Event.STOPPED_AT_GATE)
_GOING_ON = (Phase.ARMED, Phase.RUNNING)
_TOGETHER_S = 0.5  # gates that close for one cause so soon after another one belong to one stop
_NAMED_ROBOTS = 8  # of a stop
_GATES = {  # why a gate closed, where nobody said more
    named(GateStatus, GateStatus.NO_ENABLE): "no permission of the supervisor arrived",
    named(GateStatus, GateStatus.NO_COMMAND): "no command of the controller arrived",
    named(GateStatus, GateStatus.NO_LEASE): "no controller had its lease",
    named(GateStatus, GateStatus.LATCHED): "its gate was latched",
}


class _Why(NamedTuple):
    """Why a robot stood."""

    cause: str  # in words; empty: not known
    by_operator: bool


def stops(run: Run) -> list[dict[str, Any]]:
    """Return the stops in order: gates that closed, and robots that the controller let stand with an open gate.

    ``clock_time_s``, or ``t_s``, goes on in a hold, ``run_time_s`` does not. ``target_ms`` and ``output_ms``: from the
    issue of the newest nonce echoed to a target and to an output of zero, on the driver's clock; None where that was
    not seen. ``by_operator``: the operator asked for it, so the robot did not stop by itself. A controlled stop that
    ends the run is none.
    """
    found: list[dict[str, Any]] = []
    if run.start_ns is None:
        return found
    start_ns = end_ns = run.start_ns
    if len(run.ticks):
        end_ns = int(run.ticks["stamp_ns"][-1])
    for row, status in enumerate(run.statuses):
        opened, own = status["gate"] == GateStatus.OPEN, run.own_statuses(row)
        for k in 1 + np.flatnonzero(opened[:-1] & ~opened[1:] & own[1:]):
            at_ns = int(status["stamp_ns"][k])
            why = _why(run, row, int(k)) if at_ns > start_ns else None
            if why is not None and (why.cause or at_ns <= end_ns or not run.own.last):
                gate = named(GateStatus, int(status["gate"][k]))
                cause = f"{gate}: {why.cause}" if why.cause else gate
                found.append(_stop(run, row, at_ns, _Why(cause, why.by_operator)) | _times(status[k:]))
        found += _lost(run, row)
    return sorted(found, key=lambda stop: stop["t_s"])


@dataclass(frozen=True, kw_only=True)
class FleetStop:
    """Robots that stopped together, for one cause."""

    run_s: float  # of the first one
    clock_s: float
    robots: tuple[str, ...]
    cause: str
    by_operator: bool
    count: int  # of the stops; a robot may have several
    target_ms: float | None  # the longest
    output_ms: float | None

    def __str__(self) -> str:
        more = len(self.robots) - _NAMED_ROBOTS
        robots = ", ".join(self.robots) if more <= 1 else f"{', '.join(self.robots[:_NAMED_ROBOTS])} and {more} more"
        took = "" if self.output_ms is None else f" (standing after {self.output_ms:.0f} ms)"
        return f"{robots} at {time_words(self.run_s, self.clock_s)}: {self.cause}{took}"


def fleet_stops(stops: Sequence[dict[str, Any]]) -> list[FleetStop]:
    """Return a summary's stops, those that came together as one."""
    found, rest = [], [*stops]
    while rest:
        first = rest[0]
        alike = first["cause"], first["by_operator"]
        same = [
            stop for stop in rest
            if (stop["cause"], stop["by_operator"]) == alike
            and stop["clock_time_s"] - first["clock_time_s"] < _TOGETHER_S
        ]  # fmt: skip
        rest = [stop for stop in rest if stop not in same]
        longest = {
            name: max((stop[name] for stop in same if stop[name] is not None), default=None)
            for name in ("target_ms", "output_ms")
        }
        found.append(
            FleetStop(
                run_s=first["run_time_s"],
                clock_s=first["clock_time_s"],
                robots=tuple(dict.fromkeys(stop["robot"] for stop in same)),
                cause=_in_words(first["cause"]),
                by_operator=first["by_operator"],
                count=len(same),
                **longest,
            )
        )
    return found


def how_many(stops: Sequence[FleetStop]) -> str:
    """Return a number of unrequested stops in words: what a fleet does together is one."""
    each = sum(stop.count for stop in stops)
    robots = "" if each == len(stops) else f" ({each} counting each robot)"
    return f"{len(stops)} unrequested stop{'s' * (len(stops) != 1)}{robots}"


def _in_words(cause: str) -> str:
    """Return a stop's cause without its gate, where something led to that."""
    gate, _, why = cause.partition(": ")
    return (why or _GATES[gate]) if gate in _GATES else cause


def _stop(run: Run, row: int, at_ns: int, why: _Why) -> dict[str, Any]:
    clock_s, run_s = (round(float(times), 4) for times in (run.clock.clock_time_s(at_ns), run.clock.run_time_s(at_ns)))
    times = {"t_s": clock_s, "run_time_s": run_s, "clock_time_s": clock_s}
    what = {"robot": run.config.members[row].id, "cause": why.cause, "by_operator": why.by_operator}
    return {**times, **what, "target_ms": None, "output_ms": None}


def _why(run: Run, row: int, k: int) -> _Why | None:
    """Return the cause of the run or of this robot for which a gate closed; None where the run had ended."""
    status, places = run.statuses[row], run.status_places[row]
    last = int(np.searchsorted(status["stamp_ns"], int(status["stamp_ns"][k]) + _WHY_WITHIN_NS)) - 1
    soon = places[min(k + _SOON_STATUSES, last)]
    before = bisect_right(run.states, places[k], key=lambda change: change[0]) - 1
    if any(driven_out(state, row) for _, state in run.states[max(0, before - 1) : before + 1]):
        return _Why("a person no longer drives it out of the held run", by_operator=True)
    for at, state in run.states[max(0, before) :]:
        if at > soon and (at > places[last] or state.cause in _REQUESTED):
            break  # what somebody asks for closes no gate beforehand
        if state.phase == Phase.IDLE:
            return None
        own = halt_cause(state, row)
        if own:
            return _Why(own, by_operator=False)
        if state.phase not in _GOING_ON:
            return _Why(run_cause(state, run.config.ids), by_operator=state.cause in _BY_OPERATOR)
    return _Why("", by_operator=False)


def _times(closed: NDArray[Any]) -> dict[str, float | None]:
    """Return how long target and output took, from the statuses since a gate closed."""
    again = np.flatnonzero(closed["gate"] == GateStatus.OPEN)
    until = closed[: again[0]] if len(again) else closed
    still = np.flatnonzero((until["left_output_rad_s"] == 0.0) & (until["right_output_rad_s"] == 0.0))
    output_ns = int(until["output_after_ns"][still[0]]) if len(still) else -1
    target_ns = int(closed["target_after_ns"][0])
    output_ns = output_ns if output_ns >= target_ns else -1  # of an earlier stop: the wheels stood already
    return {
        name: None if ns < 0 else round(ns / 1e6, 2)
        for name, ns in (("target_ms", target_ns), ("output_ms", output_ns))
    }


def _lost(run: Run, row: int) -> list[dict[str, Any]]:
    """Return when the controller let a robot stand because no image shows it, where its gate was open."""
    status, found = run.statuses[row], []
    before = run.before["items"]["lost"][:, row] if len(run.before) else [0.0]
    for k in np.flatnonzero(np.diff(run.items["lost"][:, row], prepend=before) > 0):
        at_ns = int(run.ticks["stamp_ns"][k])
        newest = int(np.searchsorted(status["stamp_ns"], at_ns, side="right")) - 1
        if newest < 0 or status["gate"][newest] == GateStatus.OPEN:
            found.append(_stop(run, row, at_ns, _Why("not seen by the tracker", by_operator=False)))
    return found

"""The emergency stop, from whoever asks for it, by two ways at once.

The supervisor is asked until it answers. Every gate is told itself, at each new status of its robots, until that says
that the gate is latched: a supervisor that is frozen, dead or flooded delays no wheel and loses no latch.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain, compress
from typing import NamedTuple

from robofleet.bus.bus import Answer, Bus
from robofleet.bus.keys import ENABLE, ESTOP, SAFE_REQUEST, STATE, STATUS
from robofleet.bus.messages import UNIT_ENABLE, Enable, UnitEnable, UnitStatus
from robofleet.bus.observer import Observer
from robofleet.core.clock import MS, Clock
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Phase

Units = Mapping[str, Sequence[str]]  # the robots of each unit
SUPERVISOR = "supervisor"

_WITHIN_NS = 200 * MS  # then who has not answered is named
_SUPERVISOR_WITHIN_NS = 1000 * MS  # the same, where the supervisor answers for the robots
_REPEAT_NS = 40 * MS
_POLL_NS = MS
_NICE = -15  # before the router, which has -10: a flood keeps that one busy
_LAST_SEQ = (1 << 64) - 1  # a gate takes it whatever the supervisor has said with the same nonce


class Stopped(NamedTuple):
    """What came of an emergency stop."""

    after_ms: dict[str, float]  # from the first request to a robot's acknowledgement
    silent: tuple[str, ...]  # robots that did not acknowledge in time; the supervisor, where nobody else knows them

    def describe(self) -> str:
        if not self.silent:
            return f"every robot has latched its gate, the last one after {self.last_ms:.0f} ms"
        return f"NOT acknowledged within {_WITHIN_NS // MS} ms by {', '.join(self.silent)}: stop them by hand"

    @property
    def last_ms(self) -> float:
        return max(self.after_ms.values(), default=0.0)


class EmergencyStop:
    """An emergency stop in progress: call ``step`` until it returns the result."""

    def __init__(self, bus: Bus, units: Units | None, now_ns: int) -> None:
        """Ask the supervisor; the gates follow with the units' next statuses.

        ``units`` is None where only the supervisor knows the robots: its state says which of them have acknowledged.
        """
        self._bus, self._started_ns = bus, now_ns
        self._answer: Answer | None = bus.ask(SAFE_REQUEST, SUPERVISOR, ESTOP)
        self._again_ns = now_ns + _REPEAT_NS
        self._end_ns = now_ns + (_SUPERVISOR_WITHIN_NS if units is None else _WITHIN_NS)
        self._awaited = (SUPERVISOR,) if units is None else tuple(chain.from_iterable(units.values()))
        self._gates = [((STATUS, unit), robots, bus.publisher(ENABLE, unit)) for unit, robots in (units or {}).items()]
        self._observer = Observer(bus, [source for source, *_ in self._gates] if self._gates else [STATE])
        self._after_ms: dict[str, float] = {}

    def step(self, now_ns: int) -> Stopped | None:
        """Repeat what is not answered; return the result, None while it is open."""
        if self._answer is not None and self._answer.take() is not None:
            self._answer = None  # it need not be asked again
        if self._answer is not None and now_ns >= self._again_ns:
            self._answer, self._again_ns = self._bus.ask(SAFE_REQUEST, SUPERVISOR, ESTOP), now_ns + _REPEAT_NS
        for robot in self._latched(now_ns):
            self._after_ms.setdefault(robot, (now_ns - self._started_ns) / MS)
        silent = tuple(robot for robot in self._awaited if robot not in self._after_ms)
        return None if silent and now_ns < self._end_ns else Stopped(self._after_ms, silent)

    def _latched(self, now_ns: int) -> Iterator[str]:
        """Yield the robots that acknowledge now; tell the gates of all others."""
        updated = self._observer.update(now_ns)
        if STATE in updated and (state := self._observer[STATE]).phase == Phase.ESTOP:
            self._awaited = tuple(f"robot {row}" for row in range(len(state.robots)))
            yield from compress(self._awaited, [robot.acknowledged for robot in state.robots])
        for source, robots, tell in self._gates:
            if source in updated and len((status := self._observer[source]).robots) == len(robots):
                latched = [robot.latch not in (Latch.NONE, Latch.DRILL) for robot in status.robots]
                yield from compress(robots, latched)
                if not all(latched):
                    tell(UNIT_ENABLE.encode(_latching(status)))


def emergency_stop(bus: Bus, clock: Clock, units: Units | None) -> Stopped:
    """Stop every robot and latch its gate; returns when each has acknowledged, or after a while."""
    stop = EmergencyStop(bus, units, clock.now_ns())
    while (stopped := stop.step(now_ns := clock.now_ns())) is None:
        clock.sleep_until(now_ns + _POLL_NS)
    return stopped


@contextmanager
def urgent() -> Iterator[None]:
    """Let this thread, and those of Zenoh that it starts, go before what floods the machine, if the system permits it.

    Enter it before the bus opens.
    """
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, before)


def _latching(status: UnitStatus) -> UnitEnable:
    """Return what closes the gates of a unit that has just said this; that takes no lease, only the newest nonce."""
    latch, none = Latch.EMERGENCY_STOP, 0
    robots = tuple(Enable(robot.epoch, latch, none, 0.0) for robot in status.robots)
    return UnitEnable(_LAST_SEQ, status.boot_id, status.nonce, Phase.ESTOP, robots)

"""The emergency stop, from whoever asks for it, by two ways at once.

The supervisor is asked until it answers. Every gate is told itself, at each new word of its robot, until that word says
that the gate is latched: a supervisor that is frozen, dead or flooded delays no wheel and loses no latch.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import compress
from typing import NamedTuple

from robofleet.bus.bus import Answer, Bus, Inbox
from robofleet.bus.keys import ENABLE, SAFE_REQUEST, STATUS
from robofleet.bus.messages import UNIT_ENABLE, UNIT_STATUS, Enable, UnitEnable, UnitStatus
from robofleet.core.clock import MS, Clock
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import Phase

_WITHIN_NS = 200 * MS  # then who has not answered is named
_AGAIN_NS = 40 * MS
_POLL_NS = MS
_NICE = -15  # before the router, which has -10: a flood keeps that one busy
_LAST_SEQ = (1 << 64) - 1  # a gate takes it whatever the supervisor has said with the same nonce


class Stopped(NamedTuple):
    """What came of an emergency stop."""

    after_ms: dict[str, float]  # from the first request to a robot's word that its gate is latched
    silent: tuple[str, ...]  # robots that did not say so in time

    def describe(self) -> str:
        """Return it in words."""
        if not self.silent:
            return f"every robot has latched its gate, the last one after {max(self.after_ms.values()):.0f} ms"
        return f"NOT acknowledged within {_WITHIN_NS // MS} ms by {', '.join(self.silent)}: stop them by hand"


class EmergencyStop:
    """One that is on its way: ``step`` it again and again."""

    def __init__(self, bus: Bus, units: Mapping[str, Sequence[str]], now_ns: int) -> None:
        """Ask the supervisor; the gates follow with the units' next words."""
        self._robots = tuple(robot for members in units.values() for robot in members)
        self._bus, self._started_ns = bus, now_ns
        self._answer: Answer | None = bus.ask(SAFE_REQUEST, "supervisor", b"estop")
        self._again_ns = now_ns + _AGAIN_NS
        self._inboxes = [Inbox(bus.newest(STATUS, unit), UNIT_STATUS.decode) for unit in units]
        self._units = list(units.values())
        self._tell = [bus.publisher(ENABLE, unit) for unit in units]
        self._after_ms: dict[str, float] = {}

    def step(self, now_ns: int) -> Stopped | None:
        """Say again what is not answered; returns what came of it, None while that is open."""
        if self._answer is not None and self._answer.take() is not None:
            self._answer = None  # it need not be asked again
        if self._answer is not None and now_ns >= self._again_ns:
            self._answer, self._again_ns = self._bus.ask(SAFE_REQUEST, "supervisor", b"estop"), now_ns + _AGAIN_NS
        for inbox, tell, robots in zip(self._inboxes, self._tell, self._units, strict=True):
            status = inbox.take()
            if status is None or len(status.robots) != len(robots):
                continue
            latched = [robot.latch not in (Latch.NONE, Latch.DRILL) for robot in status.robots]
            for robot in compress(robots, latched):
                self._after_ms.setdefault(robot, (now_ns - self._started_ns) / MS)
            if not all(latched):
                tell(UNIT_ENABLE.encode(_latching(status)))
        silent = tuple(robot for robot in self._robots if robot not in self._after_ms)
        return None if silent and now_ns < self._started_ns + _WITHIN_NS else Stopped(self._after_ms, silent)


def emergency_stop(bus: Bus, clock: Clock, units: Mapping[str, Sequence[str]]) -> Stopped:
    """Stop every robot and latch its gate; returns when each has said so, or after 200 ms."""
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

"""The emergency stop, from whoever asks for it: asked for until it is answered, and the robots' own word for it."""

from typing import NamedTuple

from robofleet.clock import MS, Clock
from robofleet.comms.bus import Answer, Bus, Inbox
from robofleet.comms.keys import REQUEST, STATUS
from robofleet.comms.messages import ROBOT_STATUS
from robofleet.safety.gate import Latch

_WITHIN_NS = 200 * MS  # then who has not answered is named
_AGAIN_NS = 40 * MS
_POLL_NS = MS


class Stopped(NamedTuple):
    """What came of an emergency stop."""

    after_ms: dict[str, float]  # from the first request to a robot's word that its gate is latched
    silent: tuple[str, ...]  # robots that did not say so in time

    def describe(self) -> str:
        """Return it in words."""
        if not self.silent:
            return f"every robot has latched its gate, the last one after {max(self.after_ms.values()):.0f} ms"
        return f"NOT acknowledged within {_WITHIN_NS // MS} ms by {', '.join(self.silent)}: stop them by hand"


def emergency_stop(bus: Bus, clock: Clock, robots: tuple[str, ...]) -> Stopped:
    """Ask the supervisor for the emergency stop, and wait until every gate is latched, or for 200 ms."""
    started_ns = clock.now_ns()
    answer: Answer | None = bus.ask(REQUEST, "supervisor", b"estop")
    again_ns = started_ns + _AGAIN_NS
    heard = {robot: Inbox(bus.newest(STATUS, robot), ROBOT_STATUS) for robot in robots}
    after_ms: dict[str, float] = {}
    while len(after_ms) < len(robots) and (now_ns := clock.now_ns()) < started_ns + _WITHIN_NS:
        if answer is not None and answer.take() is not None:
            answer = None  # it need not be asked again
        if answer is not None and now_ns >= again_ns:
            answer, again_ns = bus.ask(REQUEST, "supervisor", b"estop"), now_ns + _AGAIN_NS
        for robot, inbox in heard.items():
            status = inbox.take()
            if status is not None and status.latch not in (Latch.NONE, Latch.DRILL):
                after_ms.setdefault(robot, (clock.now_ns() - started_ns) / MS)
        clock.sleep_until(now_ns + _POLL_NS)
    return Stopped(after_ms, tuple(robot for robot in robots if robot not in after_ms))

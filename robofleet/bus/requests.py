"""What an operator asks of a process, and waits for."""

from collections.abc import Callable

from robofleet.bus.bus import Bus
from robofleet.bus.keys import REQUEST, SAFE_REQUEST, Topic
from robofleet.bus.permissions import OPERATOR, SCRIPT, VIEWER
from robofleet.core.clock import MS, Clock, S

SAFE_WORDS = "status, hold, estop, pictures"
SAFE = frozenset(SAFE_WORDS.encode().split(b", "))  # what makes nothing move
_WITHIN_NS = 2 * S
_AGAIN_NS = 200 * MS
_POLL_NS = 2 * MS


def on(payload: bytes, role: str = OPERATOR) -> Topic:
    """Return the topic on which a role makes a request: so nobody takes up the queue of the operators' requests."""
    return SAFE_REQUEST if payload in SAFE and role in (VIEWER, SCRIPT) else REQUEST


def asked(
    bus: Bus,
    clock: Clock,
    process: str,
    payload: bytes,
    meanwhile: Callable[[], object] = lambda: None,
    *,
    within_ns: int = _WITHIN_NS,
    role: str = OPERATOR,
) -> bytes:
    """Ask a process, again while no answer comes, and return its answer; TimeoutError after a while.

    ``role``: of who asks. ``meanwhile`` is called again and again, and may raise. At first the router may not have
    heard of that process yet: then a request ends at once and without an answer.
    """
    deadline_ns = clock.now_ns() + within_ns
    doubt = ""
    while clock.now_ns() < deadline_ns:
        answer = bus.ask(on(payload, role), process, payload)
        again_ns = clock.now_ns() + _AGAIN_NS
        while clock.now_ns() < again_ns:
            if (reply := answer.take()) is not None:
                return reply
            meanwhile()
            clock.sleep_until(clock.now_ns() + _POLL_NS)
        doubt = answer.doubt or doubt
    raise TimeoutError(f"the {process} does not answer{doubt and f' ({doubt})'}")

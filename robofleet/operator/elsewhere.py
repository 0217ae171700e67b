"""What an operator or a viewer does to an arena of another computer, which this one has joined by a certificate."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from robofleet.bus.arena_file import Search
from robofleet.bus.credentials import Credentials, KeysError, credentials
from robofleet.bus.credentials import joined as joined_arenas
from robofleet.bus.keys import SAFE_REQUEST, STATE
from robofleet.bus.messages import RUN_STATE
from robofleet.bus.permissions import OPERATOR, UNIT
from robofleet.bus.requests import SAFE, SAFE_WORDS, asked
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.core.clock import MS, WallClock
from robofleet.operator.estop import urgent
from robofleet.operator.requests import NoArenaError, UnreachableError, answering
from robofleet.safety.supervisor import Phase

_CONNECT_WITHIN_S = 3.0
_AGAIN_NS, _WITHIN_NS = 40 * MS, 1000 * MS
_POLL_NS = 2 * MS


class Elsewhere(NamedTuple):
    """An arena of another computer, which this one has joined."""

    arena: str
    router: tuple[str, ...]
    credentials: Credentials
    role: str  # operator, viewer


def joined_arena(name: str | None) -> Elsewhere | None:
    """Return the arena that this computer has joined and that was named, or the only one; None where there is none.

    Runs of this computer go first. NoArenaError where several are meant, or where the keys cannot be used.
    """
    if next(Search(name).permitted(), None) is not None:
        return None
    joins = {
        arena: joined for arena, joined in joined_arenas().items() if joined.kind != UNIT and name in (None, arena)
    }
    if len(joins) > 1:
        raise NoArenaError(f"this computer has joined several arenas: name one of {', '.join(joins)}")
    for arena, joined in joins.items():
        try:
            return Elsewhere(arena, joined.router, credentials(arena, joined.name), joined.kind)
        except KeysError as error:
            raise NoArenaError(str(error)) from error
    return None


def ask(access: Elsewhere, what: str) -> tuple[bool, str]:
    """Ask the supervisor of another computer's arena; returns whether it does so, and its answer."""
    clock = WallClock()
    if access.role != OPERATOR and what.encode() not in SAFE:
        name = access.credentials.name
        return (
            False,
            f"{name} is a {access.role} of {access.arena}, who may ask for {SAFE_WORDS}: {what} is an operator's",
        )
    try:
        with reached(access, clock) as bus:
            answer = asked(bus, clock, "supervisor", what.encode(), role=access.role).decode(errors="replace")
            return answer.startswith("ok"), answer
    except (UnreachableError, TimeoutError) as error:
        return False, f"{error}: see at the computer of {access.arena} whether a run is on"


def stop(access: Elsewhere) -> tuple[bool, str]:
    """Ask for the emergency stop until every robot has acknowledged it; returns whether all have, and what happened."""
    clock = WallClock()
    try:
        with urgent(), reached(access, clock) as bus:
            states, began_ns = bus.newest(STATE), clock.now_ns()
            answer, again_ns = bus.ask(SAFE_REQUEST, "supervisor", b"estop"), began_ns + _AGAIN_NS
            left: list[int] | None = None  # rows that have not acknowledged
            while (now_ns := clock.now_ns()) < began_ns + _WITHIN_NS:
                payload = states.take()
                state = None if payload is None else RUN_STATE.decode(payload)
                if state is not None and state.phase == Phase.ESTOP:
                    left = [row for row, robot in enumerate(state.robots) if not robot.acknowledged]
                    if not left:
                        after_ms = (now_ns - began_ns) / MS
                        return (
                            True,
                            f"emergency stop of {access.arena}: every robot acknowledged, after {after_ms:.0f} ms",
                        )
                if answer.take() is None and left is None and now_ns >= again_ns:
                    answer, again_ns = bus.ask(SAFE_REQUEST, "supervisor", b"estop"), now_ns + _AGAIN_NS
                clock.sleep_until(now_ns + _POLL_NS)
    except UnreachableError as error:
        return False, f"{error}: no robot has acknowledged: go and look"
    missing = "the supervisor does not answer" if left is None else f"{len(left)} robots have not acknowledged"
    return False, f"emergency stop of {access.arena}: {missing}: go and look"


@contextmanager
def reached(access: Elsewhere, clock: WallClock) -> Iterator[ZenohBus]:
    """Join the bus of another computer's arena; UnreachableError where its router does not answer."""
    at = access.arena, access.router, access.role, clock, _CONNECT_WITHIN_S
    silent = f"the router of {access.arena} at {', '.join(access.router)} does not answer, or refuses this certificate"
    with answering(silent, *at, credentials=access.credentials) as bus:
        yield bus

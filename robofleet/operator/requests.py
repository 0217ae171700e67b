"""What an operator does to a running arena: of this computer, or of another one that this one has joined.

Nothing heavy is imported here: `robofleet stop` starts fast.
"""

import os
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.bus import credentials as keys
from robofleet.bus.arena_file import ArenaFile, Search, found
from robofleet.bus.credentials import Credentials, KeysError
from robofleet.bus.joining import joined
from robofleet.bus.keys import STATE, STATUS
from robofleet.bus.messages import RunState
from robofleet.bus.observer import Observer, RobotObserved, robots_observed
from robofleet.bus.permissions import OPERATOR, UNIT
from robofleet.bus.requests import SAFE, SAFE_WORDS
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.core.clock import MS, WallClock
from robofleet.core.errors import BadInputError, RobofleetError
from robofleet.operator.asking import ask_supervisor
from robofleet.operator.estop import SUPERVISOR, Stopped, emergency_stop, urgent
from robofleet.recording.causes import halt_cause, named
from robofleet.safety.advice import WAY_OUT
from robofleet.safety.latches import GateStatus, Latch

_CONNECT_WITHIN_S = 1.0
_CONNECT_ELSEWHERE_WITHIN_S = 3.0
_LISTEN_NS = 300 * MS
_POLL_NS = 2 * MS
_CONCURRENT_STOPS = 128  # each of a bus that does not answer takes a second
_OWN_FIRST_S = 0.3  # then others' runs are looked for, whatever the own ones do
_SILENT = "the robots get no permission to move: end the run with Ctrl-C in its terminal, and see its supervisor's log"
_BETWEEN_SIGNALS_NS = 100 * MS  # two signals at once are one


class NoArenaError(BadInputError):
    """Raised where there is no run, or not the one that was named, or several. The message is a line."""


class NoRunError(NoArenaError):
    """Raised where no run is on, or none of the arena that was named."""


class UnreachableError(RobofleetError):
    """Raised where a run is on and its bus does not answer."""


class JoinedArena(NamedTuple):
    """An arena of another computer, which this one has joined by a certificate."""

    arena: str
    router: tuple[str, ...]
    credentials: Credentials
    role: str  # operator, viewer


Arena = ArenaFile | JoinedArena


def joined_arena(arena: str | None) -> JoinedArena | None:
    """Return the arena that this computer has joined and that was named, or the only one; None where there is none.

    Runs of this computer go first. NoArenaError where several are meant, or where the keys cannot be used.
    """
    if next(Search(arena).permitted(), None) is not None:
        return None
    joins = {name: join for name, join in keys.joined().items() if join.kind != UNIT and arena in (None, name)}
    if len(joins) > 1:
        raise NoArenaError(f"this computer has joined several arenas: name one of {', '.join(joins)}")
    for name, join in joins.items():
        try:
            return JoinedArena(name, join.router, keys.credentials(name, join.name), join.kind)
        except KeysError as error:
            raise NoArenaError(str(error)) from error
    return None


def chosen(arena: str | None, *, own: bool = False) -> ArenaFile:
    """Return the running arena of this user that was named, or the only one; ``own``: not another user's for root."""
    search = Search(arena)
    mine = [*islice(search.own() if own else search.permitted(), None if arena is None else 1)]
    if arena is None and len(mine) > 1:
        raise NoArenaError(f"several arenas have a run: name one of {', '.join(sorted(run.arena for run in mine))}")
    if not mine:
        raise NoArenaError(_not_yours(_others(search, arena)[0]))
    _complain(search)
    return mine[0]


def stop_all(arena: str | None) -> list[tuple[bool, str]]:
    """Stop every run that this user may stop, or those of an arena, all at once; returns for each what ``stop`` does.

    The own ones are asked before the files of other users are opened. Where there is no run on this computer, the
    arena that it has joined is stopped.
    """
    if (elsewhere := joined_arena(arena)) is not None:
        return [stop(elsewhere)]
    search = Search(arena)
    with ThreadPoolExecutor(_CONCURRENT_STOPS) as pool:
        answers = [pool.submit(stop, run) for run in search.own()]
        wait(answers, _OWN_FIRST_S)
        if os.geteuid() == 0:
            answers += [pool.submit(stop, run) for run in search.others()]
        if not answers:
            return [(False, _not_yours(run)) for run in _others(search, arena)]
        _complain(search)
        return [answer.result() for answer in answers]


def _others(search: Search, arena: str | None) -> list[ArenaFile]:
    """Return the runs of others, where there is none that this user may stop; NoArenaError if nobody has one."""
    others = [*search.others()]
    _complain(search)
    if others:
        return others
    everybody = found()
    if not everybody.runs:
        where = " or ".join(reversed(everybody.places)) or "any place"
        raise NoRunError(f"no arena has a run in {where}: start one with `robofleet run CONFIG`")
    raise NoRunError(f"the arena {arena} has no run: name one of {', '.join(run.arena for run in everybody.runs)}")


def _complain(search: Search) -> None:
    """Print which places could not be read."""
    for trouble in search.troubles:
        print(f"some runs may not be listed: {trouble}", file=sys.stderr)


def _not_yours(run: ArenaFile) -> str:
    whose = f"the arena {run.arena} has a run of {run.user} (process {run.pid})"
    if run.mine:  # root's, who may stop it
        return f"{whose}, whose configuration may name code of {run.user}: do this as {run.user} (`sudo -u`)"
    return f"{whose}, which is not yours: ask {run.user} or an administrator (`sudo robofleet stop {run.arena}`)"


def stop(arena: Arena) -> tuple[bool, str]:
    """Stop every robot at once and latch its gate; returns whether all have acknowledged, and what happened.

    Where the bus of a run of this computer does not answer, the launcher is told by signals to cut its processes'
    lifelines.
    """
    clock = WallClock()
    try:
        with urgent(), reached(arena, clock) as bus:
            if isinstance(arena, ArenaFile):
                stopped = emergency_stop(bus, clock, arena.units)
                words = stopped.describe()
            else:
                stopped = emergency_stop(bus, clock, None)
                words = by_supervisor(stopped)
            return not stopped.silent, f"emergency stop of {arena.arena}: {words}"
    except UnreachableError as error:
        if isinstance(arena, JoinedArena):
            return False, f"{error}: no robot has acknowledged: go and look"
        _signalled(arena)
        clock.sleep_until(clock.now_ns() + _BETWEEN_SIGNALS_NS)
        _signalled(arena)
        return False, (
            f"the bus of {arena.arena} does not answer: the launcher was told to end every process; "
            "no robot has acknowledged: go and look"
        )


def by_supervisor(stopped: Stopped) -> str:
    """Return in words what came of an emergency stop of which the supervisor alone says who has acknowledged."""
    if not stopped.silent:
        return f"every robot acknowledged, after {stopped.last_ms:.0f} ms"
    if stopped.silent == (SUPERVISOR,):
        return "the supervisor does not answer: go and look"
    return f"{len(stopped.silent)} robots have not acknowledged: go and look"


def _signalled(run: ArenaFile) -> None:
    """Signal a launcher, if the process is its user's: what the file says is the user's word alone."""
    with suppress(OSError):  # it is gone
        if Path(f"/proc/{run.pid}").stat().st_uid == run.uid:
            os.kill(run.pid, signal.SIGTERM)


def ask(arena: Arena, what: str) -> tuple[bool, str]:
    """Ask the supervisor; returns whether it does so, and its answer."""
    clock, role = WallClock(), OPERATOR if isinstance(arena, ArenaFile) else arena.role
    if isinstance(arena, JoinedArena) and role != OPERATOR and what.encode() not in SAFE:
        who = f"{arena.credentials.name} is a {role} of {arena.arena}"
        return False, f"{who}, who may ask for {SAFE_WORDS}: {what} is an operator's"
    try:
        with reached(arena, clock) as bus:
            return ask_supervisor(bus, clock, what, role)
    except (UnreachableError, TimeoutError) as error:
        if isinstance(arena, JoinedArena):
            return False, f"{error}: see at the computer of {arena.arena} whether a run is on"
        if isinstance(error, UnreachableError):
            return False, str(error)
        return False, f"{error}: end the run with Ctrl-C in its terminal, or with `kill {arena.pid}`"


def status(run: ArenaFile) -> dict[str, Any]:
    """Return what a run says of itself within a moment; None for what is silent."""
    from robofleet.recording.state_words import state_words  # noqa: PLC0415 - it loads numpy

    clock = WallClock()
    with reached(run, clock) as bus:
        observer = Observer(bus, [STATE, *((STATUS, unit) for unit in run.units)])
        end_ns = clock.now_ns() + _LISTEN_NS
        while (now_ns := clock.now_ns()) < end_ns:
            observer.update(now_ns)
            clock.sleep_until(now_ns + _POLL_NS)
    state: RunState | None = observer[STATE]
    words = None if state is None else state_words(state, None, run.robots)
    robots = robots_observed(observer, run.units, run.robots)
    return {
        "arena": run.arena,
        "folder": run.folder,
        "started": run.started,
        "pid": run.pid,
        "endpoint": run.endpoint,
        "phase": words and words.phase,
        "cause": words and words.advice,
        "next": _SILENT if state is None else WAY_OUT.get(state.phase),
        "robots": [
            {"id": robot, **_robot(robots[row], now_ns), "halted": (halt_cause(state, row) if state else "") or None}
            for row, robot in enumerate(run.robots)
        ],
    }


def _robot(observed: RobotObserved, now_ns: int) -> dict[str, Any]:
    status, arrival_ns = observed
    if status is None:
        return {"gate": None, "latch": None, "battery": None, "age_ms": None}
    return {
        "gate": named(GateStatus, status.gate),
        "latch": named(Latch, status.latch),
        "battery": None if status.battery < 0.0 else round(status.battery, 3),
        "age_ms": round((now_ns - arrival_ns) / MS, 1),
    }


def reached(arena: Arena, clock: WallClock) -> AbstractContextManager[ZenohBus]:
    """Join an arena's bus; UnreachableError where it does not answer."""
    if isinstance(arena, ArenaFile):
        silent = f"the bus of {arena.arena} at {arena.endpoint} does not answer: end the run with `kill {arena.pid}`"
        return answering(silent, arena.arena, arena.endpoint, clock)
    at = ", ".join(arena.router)
    silent = f"the router of {arena.arena} at {at} does not answer, or refuses this certificate"
    return answering(
        silent, arena.arena, arena.router, clock, _CONNECT_ELSEWHERE_WITHIN_S, arena.role, arena.credentials
    )


@contextmanager
def answering(
    silent: str, arena: str, endpoint: str | Sequence[str], clock: WallClock, within_s: float = _CONNECT_WITHIN_S,
    role: str = OPERATOR, credentials: Credentials | None = None,
) -> Iterator[ZenohBus]:  # fmt: skip
    """Join a bus; UnreachableError with the message ``silent`` where nobody answers."""
    try:
        bus = joined(arena, endpoint, role, clock, within_s, credentials=credentials)
    except TimeoutError as error:
        raise UnreachableError(silent) from error
    with closing(bus):
        yield bus

"""What an operator does to a running arena from another terminal. It is in a hurry: nothing heavy is imported here."""

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any

from robofleet.bus.arena_file import ArenaFile, Search, found
from robofleet.bus.joining import joined
from robofleet.bus.keys import STATE, STATUS, key
from robofleet.bus.messages import RUN_STATE, UNIT_STATUS, RobotStatus, RunState
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.core.clock import MS, WallClock
from robofleet.core.errors import RobofleetError
from robofleet.operator.estop import emergency_stop, urgent
from robofleet.recording.causes import halt_cause, named, run_cause
from robofleet.safety.advice import WAY_OUT, advised
from robofleet.safety.gate import GateStatus, Latch
from robofleet.safety.supervisor import Phase

_CONNECT_WITHIN_S = 1.0
_LISTEN_NS = 300 * MS
_POLL_NS = 2 * MS
_AT_ONCE = 128  # stops; each of a bus that does not answer takes a second
_OWN_FIRST_S = 0.3  # then others' runs are looked for, whatever the own ones do
_SILENT = "the robots get no permission to move: end the run with Ctrl-C in its terminal, and see its supervisor's log"
_BETWEEN_NS = 100 * MS  # two signals at once are one


class NoArenaError(RobofleetError):
    """Raised where there is no run, or not the one that was named, or several. The message is a line."""


class UnreachableError(RobofleetError):
    """Raised where a run is on and its bus does not answer."""


def chosen(name: str | None, *, own: bool = False) -> ArenaFile:
    """Return the running arena of this user that was named, or the only one; ``own``: not another user's for root."""
    search = Search(name)
    mine = [*islice(search.own() if own else search.permitted(), None if name is None else 1)]
    if name is None and len(mine) > 1:
        raise NoArenaError(f"several arenas have a run: name one of {', '.join(sorted(run.arena for run in mine))}")
    if not mine:
        raise NoArenaError(_not_yours(_others(search, name)[0]))
    _complain(search)
    return mine[0]


def stop_all(name: str | None) -> list[tuple[bool, str]]:
    """Stop every run that this user may stop, or those of an arena, all at once; returns for each what ``stop`` does.

    The own ones are asked before the files of other users are opened.
    """
    search = Search(name)
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        answers = [pool.submit(stop, run) for run in search.own()]
        wait(answers, _OWN_FIRST_S)
        if os.geteuid() == 0:
            answers += [pool.submit(stop, run) for run in search.others()]
        if not answers:
            return [(False, _not_yours(run)) for run in _others(search, name)]
        _complain(search)
        return [answer.result() for answer in answers]


def _others(search: Search, name: str | None) -> list[ArenaFile]:
    """Return the runs of others, where there is none that this user may stop; NoArenaError if nobody has one."""
    others = [*search.others()]
    _complain(search)
    if others:
        return others
    everybody = found()
    if not everybody.runs:
        where = " or ".join(reversed(everybody.places)) or "any place"
        raise NoArenaError(f"no arena has a run in {where}: start one with `robofleet run CONFIG`")
    raise NoArenaError(f"the arena {name} has no run: name one of {', '.join(run.arena for run in everybody.runs)}")


def _complain(search: Search) -> None:
    """Print which places could not be read."""
    for trouble in search.troubles:
        print(f"some runs may not be listed: {trouble}", file=sys.stderr)


def _not_yours(run: ArenaFile) -> str:
    whose = f"the arena {run.arena} has a run of {run.user} (process {run.pid})"
    if run.mine:  # root's, who may stop it
        return f"{whose}, whose configuration may name code of {run.user}: do this as {run.user} (`sudo -u`)"
    return f"{whose}, which is not yours: ask {run.user} or an administrator (`sudo robofleet stop {run.arena}`)"


def stop(run: ArenaFile) -> tuple[bool, str]:
    """Stop every robot at once and latch its gate; returns whether all have said so, and what happened.

    Where the bus does not answer, the launcher is told by signals to cut its processes' lifelines.
    """
    clock = WallClock()
    try:
        with urgent(), reached(run, clock) as bus:
            stopped = emergency_stop(bus, clock, run.units)
            return not stopped.silent, f"emergency stop of {run.arena}: {stopped.describe()}"
    except UnreachableError:
        _signalled(run)
        clock.sleep_until(clock.now_ns() + _BETWEEN_NS)
        _signalled(run)
        return False, (
            f"the bus of {run.arena} does not answer: the launcher was told to end every process; "
            "no robot has acknowledged: go and look"
        )


def _signalled(run: ArenaFile) -> None:
    """Signal a launcher, if the process is its user's: what the file says is the user's word alone."""
    with suppress(OSError):  # it is gone
        if Path(f"/proc/{run.pid}").stat().st_uid == run.uid:
            os.kill(run.pid, signal.SIGTERM)


def ask(run: ArenaFile, what: str) -> tuple[bool, str]:
    """Ask the supervisor; returns whether it does so, and its answer."""
    clock = WallClock()
    try:
        with reached(run, clock) as bus:
            answer = asked(bus, clock, "supervisor", what.encode()).decode(errors="replace")
            return answer.startswith("ok"), answer
    except UnreachableError as error:
        return False, str(error)
    except TimeoutError as error:
        return False, f"{error}: end the run with Ctrl-C in its terminal, or with `kill {run.pid}`"


def status(run: ArenaFile) -> dict[str, Any]:
    """Return what a run says of itself within a moment; None for what is silent."""
    clock = WallClock()
    state: RunState | None = None
    newest: dict[str, tuple[int, RobotStatus]] = {}
    with reached(run, clock) as bus:
        names = {key(run.arena, STATUS, unit): robots for unit, robots in run.units.items()}
        states, statuses = bus.newest(STATE), bus.stream(*names, capacity=16 * len(names))
        end_ns = clock.now_ns() + _LISTEN_NS
        while (now_ns := clock.now_ns()) < end_ns:
            if (payload := states.take()) is not None:
                state = RUN_STATE.decode(payload) or state
            for _, full, payload in statuses.drain():
                if full in names and (message := UNIT_STATUS.decode(payload)) is not None:
                    for robot, status in zip(names[full], message.robots, strict=False):
                        newest[robot] = now_ns, status
            clock.sleep_until(now_ns + _POLL_NS)
    return {
        "arena": run.arena,
        "folder": run.folder,
        "started": run.started,
        "pid": run.pid,
        "endpoint": run.endpoint,
        "phase": None if state is None else named(Phase, state.phase),
        "cause": None if state is None else advised(run_cause(state, run.robots), state.cause),
        "next": _SILENT if state is None else WAY_OUT.get(state.phase),
        "robots": [
            _robot(robot, newest.get(robot), "" if state is None else halt_cause(state, row), clock.now_ns())
            for row, robot in enumerate(run.robots)
        ],
    }


def _robot(robot: str, status: tuple[int, RobotStatus] | None, halted: str, now_ns: int) -> dict[str, Any]:
    if status is None:
        return {"id": robot, "gate": None, "latch": None, "battery": None, "age_ms": None, "halted": halted or None}
    heard_ns, message = status
    return {
        "id": robot,
        "gate": named(GateStatus, message.gate),
        "latch": named(Latch, message.latch),
        "battery": None if message.battery < 0.0 else round(message.battery, 3),
        "age_ms": round((now_ns - heard_ns) / MS, 1),
        "halted": halted or None,
    }


@contextmanager
def reached(run: ArenaFile, clock: WallClock) -> Iterator[ZenohBus]:
    """Join a run's bus; UnreachableError where it does not answer."""
    silent = f"the bus of {run.arena} at {run.endpoint} does not answer: end the run with `kill {run.pid}`"
    with answering(silent, run.arena, run.endpoint, "operator", clock, _CONNECT_WITHIN_S) as bus:
        yield bus


@contextmanager
def answering(silent: str, *bus_of: Any, **more: Any) -> Iterator[ZenohBus]:
    """Join a bus as ``joining.joined`` does; UnreachableError with these words where nobody answers."""
    try:
        bus = joined(*bus_of, **more)
    except TimeoutError as error:
        raise UnreachableError(silent) from error
    with closing(bus):
        yield bus

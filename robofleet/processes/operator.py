"""What an operator does to a running arena from another terminal. It is in a hurry: nothing heavy is imported here."""

import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from robofleet.clock import MS, WallClock
from robofleet.comms.joining import joined
from robofleet.comms.keys import STATE, STATUS, key
from robofleet.comms.messages import RUN_STATE, UNIT_STATUS, RobotStatus, RunState
from robofleet.comms.requests import asked
from robofleet.comms.zenoh_bus import ZenohBus
from robofleet.processes.arena_file import ArenaFile, found
from robofleet.processes.estop import emergency_stop, urgent
from robofleet.recording.causes import halt_cause, named, run_cause
from robofleet.safety.advice import WAY_OUT, advised
from robofleet.safety.gate import GateStatus, Latch
from robofleet.safety.supervisor import Phase

_CONNECT_WITHIN_S = 1.0
_LISTEN_NS = 300 * MS
_POLL_NS = 2 * MS
_SILENT = "the robots get no permission to move: end the run with Ctrl-C in its terminal, and see its supervisor's log"
_BETWEEN_NS = 100 * MS  # two signals at once are one


class NoArenaError(Exception):
    """There is no run, or not the one that was named, or several; the message is a line."""


class UnreachableError(Exception):
    """A run is there and its bus does not answer."""


def chosen(name: str | None, *, own: bool = False) -> ArenaFile:
    """Return the running arena of this user that was named, or the only one; ``own``: not another user's for root."""
    there = named_runs(None)
    mine = [run for run in there if (run.own if own else run.mine)]
    names = ", ".join(run.arena for run in mine)
    if name is None and len(mine) > 1:
        raise NoArenaError(f"several arenas have a run: name one of {names}")
    for run in mine:
        if name in (None, run.arena):
            return run
    for run in there:
        if name in (None, run.arena):
            raise NoArenaError(_not_yours(run))
    raise NoArenaError(f"the arena {name} has no run: name one of {names}")


def named_runs(name: str | None) -> list[ArenaFile]:
    """Return all users' runs, or those of an arena; NoArenaError if there is none. What is in the way is said."""
    runs, places, troubles = found()
    for trouble in troubles:
        print(f"some runs may not be listed: {trouble}", file=sys.stderr)
    if not runs:
        where = " or ".join(places) or "any place"
        raise NoArenaError(f"no arena has a run in {where}: start one with `robofleet run CONFIG`")
    named_so = [run for run in runs if name in (None, run.arena)]
    if not named_so:
        raise NoArenaError(f"the arena {name} has no run: name one of {', '.join(run.arena for run in runs)}")
    return named_so


def stop_all(name: str | None) -> list[tuple[bool, str]]:
    """Stop every run, or those of an arena, all at once; returns for each what ``stop`` does."""

    def stopped(there: ArenaFile) -> tuple[bool, str]:
        return stop(there) if there.mine else (False, _not_yours(there))

    runs = named_runs(name)
    with ThreadPoolExecutor(len(runs)) as pool:
        return list(pool.map(stopped, runs))


def _not_yours(there: ArenaFile) -> str:
    whose = f"the arena {there.arena} has a run of {there.user} (process {there.pid})"
    if there.mine:  # root's, who may stop it
        return f"{whose}, whose configuration may name code of {there.user}: do this as {there.user} (`sudo -u`)"
    return f"{whose}, which is not yours: ask {there.user} or an administrator (`sudo robofleet stop {there.arena}`)"


def stop(there: ArenaFile) -> tuple[bool, str]:
    """Stop every robot at once and latch its gate; returns whether all have said so, and what happened.

    Where the bus does not answer, the launcher is told by signals to cut its processes' lifelines.
    """
    clock = WallClock()
    try:
        with urgent(), reached(there, clock) as bus:
            stopped = emergency_stop(bus, clock, there.units)
            return not stopped.silent, f"emergency stop of {there.arena}: {stopped.describe()}"
    except UnreachableError:
        _signalled(there)
        clock.sleep_until(clock.now_ns() + _BETWEEN_NS)
        _signalled(there)
        return False, (
            f"the bus of {there.arena} does not answer: the launcher was told to end every process; "
            "no robot has acknowledged: go and look"
        )


def _signalled(there: ArenaFile) -> None:
    """Signal a launcher, if the process is its user's: what the file says is the user's word alone."""
    with suppress(OSError):  # it is gone
        if Path(f"/proc/{there.pid}").stat().st_uid == there.uid:
            os.kill(there.pid, signal.SIGTERM)


def ask(there: ArenaFile, what: str) -> tuple[bool, str]:
    """Ask the supervisor; returns whether it does so, and its answer."""
    clock = WallClock()
    try:
        with reached(there, clock) as bus:
            answer = asked(bus, clock, "supervisor", what.encode()).decode(errors="replace")
            return answer.startswith("ok"), answer
    except UnreachableError as error:
        return False, str(error)
    except TimeoutError as error:
        return False, f"{error}: end the run with Ctrl-C in its terminal, or with `kill {there.pid}`"


def status(there: ArenaFile) -> dict[str, Any]:
    """Return what a run says of itself within a moment; None for what is silent."""
    clock = WallClock()
    state: RunState | None = None
    newest: dict[str, tuple[int, RobotStatus]] = {}
    with reached(there, clock) as bus:
        names = {key(there.arena, STATUS, unit): robots for unit, robots in there.units.items()}
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
        "arena": there.arena,
        "folder": there.folder,
        "started": there.started,
        "pid": there.pid,
        "endpoint": there.endpoint,
        "phase": None if state is None else named(Phase, state.phase),
        "cause": None if state is None else advised(run_cause(state, there.robots), state.cause),
        "next": _SILENT if state is None else WAY_OUT.get(state.phase),
        "robots": [
            _robot(robot, newest.get(robot), "" if state is None else halt_cause(state, row), clock.now_ns())
            for row, robot in enumerate(there.robots)
        ],
    }


def _robot(robot: str, heard: tuple[int, RobotStatus] | None, halted: str, now_ns: int) -> dict[str, Any]:
    if heard is None:
        return {"id": robot, "gate": None, "latch": None, "battery": None, "age_ms": None, "halted": halted or None}
    heard_ns, message = heard
    return {
        "id": robot,
        "gate": named(GateStatus, message.gate),
        "latch": named(Latch, message.latch),
        "battery": None if message.battery < 0.0 else round(message.battery, 3),
        "age_ms": round((now_ns - heard_ns) / MS, 1),
        "halted": halted or None,
    }


@contextmanager
def reached(there: ArenaFile, clock: WallClock) -> Iterator[ZenohBus]:
    """Join a run's bus; UnreachableError where it does not answer."""
    silent = f"the bus of {there.arena} at {there.endpoint} does not answer: end the run with `kill {there.pid}`"
    with answering(silent, there.arena, there.endpoint, "operator", clock, _CONNECT_WITHIN_S) as bus:
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

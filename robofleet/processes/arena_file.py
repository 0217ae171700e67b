"""The file that a launcher leaves for who wants to reach its run: where the bus is, and who is on it.

A lock beside it is held as long as the launcher lives, however it ends: so a file that was left behind is known, and
an arena has one run at a time.
"""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robofleet.clock import MS, Clock, utc_now

if TYPE_CHECKING:  # who looks for a run needs no configuration, and is in a hurry
    from robofleet.config.tree import Config

_PATIENCE_NS = 200 * MS  # who looks whether a file was left behind holds the lock for a moment
_AGAIN_NS = 10 * MS


class ArenaFile(NamedTuple):
    """A running arena."""

    arena: str
    endpoint: str
    pid: int  # the launcher's
    folder: str  # of the run
    started: str  # UTC, ISO 8601
    robots: tuple[str, ...]  # the group's in its order, then the bystanders


class ArenaBusyError(Exception):
    """The arena has a run already; the message says whose, and how to end it."""


@contextmanager
def claimed(config: "Config", folder: Path, clock: Clock) -> Iterator[None]:
    """Leave the file for as long as the run is on; ArenaBusyError where there is one."""
    arena = config.arena.name
    file = _folder() / f"{arena}.json"
    lock = file.with_suffix(".lock")
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        if not _locked(descriptor, clock):
            raise ArenaBusyError(_whose(arena, _read(file)))
        started = f"{utc_now():%Y-%m-%dT%H:%M:%SZ}"
        robots = config.ids
        mine = ArenaFile(arena, config.bus.endpoint, os.getpid(), str(folder.absolute()), started, robots)
        beside = file.with_suffix(".new")
        beside.write_text(json.dumps(mine._asdict()))
        beside.replace(file)
        try:
            yield
        finally:
            file.unlink(missing_ok=True)
    finally:
        os.close(descriptor)


def running() -> list[ArenaFile]:
    """Return the arenas that have a run; files that were left behind are removed."""
    found = []
    for file in sorted(_folder().glob("*.json")):
        lock = file.with_suffix(".lock")
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            file.unlink(missing_ok=True)
        except BlockingIOError:
            if (there := _read(file)) is not None:
                found.append(there)
        finally:
            os.close(descriptor)
    return found


def twin_port(arena: str, robot: str) -> Path:
    """Return where a robot's twin leaves its serial port: a link to a pseudo-terminal."""
    return _folder() / f"{arena}-{robot}.tty"


def _folder() -> Path:
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "robofleet" if runtime else Path(f"/tmp/robofleet-{os.getuid()}")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if folder.stat().st_uid != os.getuid():  # in /tmp anybody may have made it
        raise PermissionError(f"{folder} belongs to somebody else: set XDG_RUNTIME_DIR to a folder of yours")
    return folder


def _locked(descriptor: int, clock: Clock) -> bool:
    deadline_ns = clock.now_ns() + _PATIENCE_NS
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if clock.now_ns() > deadline_ns:
                return False
            clock.sleep_until(clock.now_ns() + _AGAIN_NS)


def _read(file: Path) -> ArenaFile | None:
    try:
        found = json.loads(file.read_text())
        return ArenaFile(**found | {"robots": tuple(found["robots"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _whose(arena: str, there: ArenaFile | None) -> str:
    if there is None:
        return f"the arena {arena} has a run already: end it first"
    return (
        f"the arena {arena} has a run already, in {there.folder} since {there.started} (process {there.pid}): "
        f"end it with Ctrl-C there, or with `kill {there.pid}`"
    )

"""What a driver must remember when it is started again: the epoch of its lease, and what latched its gate."""

import errno
import fcntl
import json
import os
import re
import sys
import weakref
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, Protocol

from robofleet.core.errors import BadInputError
from robofleet.core.patterns import NAME_PATTERN
from robofleet.safety.gate import GateState
from robofleet.safety.latches import Latch

_MOST = 1 << 63  # half of what the wire carries: so many leases or latches nobody lives to see
_HALF = 4096  # bytes: the halves of a file share no block of a disk
_SPARE = b'"spare": '
_LOCK = "lock"  # beside the robots' files: drivers share it, and who clears latches has it alone


class StoredRobot(NamedTuple):
    """One robot's memory."""

    epoch: int = 0
    latch: Latch = Latch.NONE
    latch_id: int = 0

    def latched_as(self, other: "StoredRobot") -> bool:
        """Whether the same latch holds both."""
        return self.latch != Latch.NONE and (self.latch, self.latch_id) == (other.latch, other.latch_id)


_LOST = Latch.MEMORY_LOST
_UNKNOWN = StoredRobot(0, _LOST, 1)


class StoredLatch(NamedTuple):
    """A latch that a robot's driver has left on this computer."""

    robot: str
    memory: StoredRobot
    simulated: bool  # nothing real was in the run that left it
    since: datetime  # UTC; when it was written

    @property
    def latch(self) -> Latch:
        return self.memory.latch


class DriverRunningError(BadInputError):
    """Raised where a driver uses the stored latches. The message says what to do."""


class StateStore(Protocol):
    """Where it is kept."""

    def load(self, robot: str) -> StoredRobot:
        """Return what was kept, or what a new robot starts with; what cannot be read latches. Raises nothing."""

    def save(self, robot: str, kept: StoredRobot) -> None:
        """Keep it; it is there, whatever happens next, when this returns. OSError where that cannot be."""

    def lose(self, robot: str) -> None:
        """Let what is kept count as lost until the next save: it latches. OSError where even that cannot be."""


class MemoryStateStore:
    """Lockstep's: nothing outlives the run."""

    def __init__(self) -> None:
        self._kept: dict[str, StoredRobot] = {}

    def load(self, robot: str) -> StoredRobot:
        return self._kept.get(robot, StoredRobot())

    def save(self, robot: str, kept: StoredRobot) -> None:
        self._kept[robot] = kept

    def lose(self, robot: str) -> None:
        self._kept[robot] = _UNKNOWN


def state_folder() -> Path:
    """Return the folder with one folder an arena."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "robofleet"


def latched_arenas() -> tuple[str, ...]:
    """Return the arenas whose drivers have left a latch on this computer."""
    arenas = [name for name in _names(state_folder()) if re.fullmatch(NAME_PATTERN, name)]
    return tuple(arena for arena in arenas if FileStateStore(arena).latches())


def _names(folder: Path) -> list[str]:
    """Return what is in a folder, r2 before r10; nothing where there is none."""
    try:
        return sorted((entry.name for entry in folder.iterdir()), key=lambda name: (len(name), name))
    except (FileNotFoundError, NotADirectoryError):
        return []


class FileStateStore:
    """One file a robot, in the user's state folder, of full size from the start: a full disk has room for a latch.

    It is JSON, and its second half says what the first one says, each with a number and a checksum. The spare half is
    written first: a half that was not written to its end counts for nothing, and then the other one is whole.
    """

    def __init__(self, arena: str, *, simulated: bool = False) -> None:
        """``simulated``: nothing is real in the run whose drivers write here."""
        self._arena, self._folder, self._simulated = arena, state_folder() / arena, simulated
        self._holds = False  # the lock, as a driver, for as long as this lives

    def prove(self, robots: tuple[str, ...]) -> None:
        """Make room for what these robots must keep, and write it once; OSError, which names the place, if not.

        From now on nobody else clears their latches.
        """
        for robot in robots:
            try:
                if not self._holds:
                    weakref.finalize(self, os.close, self._locked(fcntl.LOCK_SH))
                    self._holds = True
                self.save(robot, self.load(robot))
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._file(robot))) from error

    def latches(self, robots: Sequence[str] | None = None) -> tuple[StoredLatch, ...]:
        """Return the latches that drivers have left, of these robots or of all; what cannot be read is one.

        OSError where the arena's folder cannot be read.
        """
        if robots is None:
            robots = [name.removesuffix(".json") for name in _names(self._folder) if name.endswith(".json")]
        found = ((robot, *self._read(robot)) for robot in robots if re.fullmatch(NAME_PATTERN, robot))
        return tuple(
            StoredLatch(robot, memory, simulated, self._written(robot))
            for robot, memory, simulated, _ in found
            if memory.latch
        )

    @property
    def known(self) -> bool:
        """Whether a driver of this arena was ever started on this computer."""
        return self._folder.is_dir()

    def clear(self, latches: Sequence[StoredLatch]) -> tuple[str, ...]:
        """Clear these latches; return the robots whose latch is another one by now, and stays.

        DriverRunningError while a driver runs, which has its latches in memory; OSError where a file cannot be written.
        """
        with self._alone():
            same = [stored for stored in latches if self._read(stored.robot)[0] == stored.memory]
            for stored in same:
                self.save(stored.robot, stored.memory._replace(latch=Latch.NONE))
        return tuple(stored.robot for stored in latches if stored not in same)

    @contextmanager
    def _alone(self) -> Iterator[None]:
        try:
            lock = self._locked(fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DriverRunningError(
                f"a driver of {self._arena} runs on this computer and keeps its latches: end it first, or reset while "
                "its run is on"
            ) from None
        try:
            yield
        finally:
            os.close(lock)

    def _locked(self, how: int) -> int:
        file = self._folder / _LOCK
        try:
            lock = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except FileNotFoundError:
            self._folder.mkdir(parents=True, exist_ok=True)
            return self._locked(how)
        try:
            fcntl.flock(lock, how)
        except OSError as error:
            os.close(lock)
            raise OSError(error.errno, error.strerror, str(file)) from error
        return lock

    def _written(self, robot: str) -> datetime:
        try:
            return datetime.fromtimestamp(self._file(robot).stat().st_mtime, UTC)
        except OSError:
            return datetime.fromtimestamp(0, UTC)

    def try_place(self, robots: tuple[str, ...]) -> None:
        """Raise OSError, which names the place, where these robots' memories could not be written; touch none of
        them: a driver that is still ending may write its own."""
        for robot in robots:
            file = self._file(robot)
            beside = file.with_suffix(f".{os.getpid()}.try")
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
                if file.exists():
                    os.close(os.open(file, os.O_RDWR))
                try:
                    with beside.open("wb", buffering=0) as stream:
                        _write(stream.fileno(), 0, bytes(2 * _HALF))
                finally:
                    beside.unlink(missing_ok=True)
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(file)) from error

    def load(self, robot: str) -> StoredRobot:
        """Return what was kept; a file that cannot be read latches the robot: nobody knows what was before."""
        memory, _, trouble = self._read(robot)
        if trouble:
            file = self._file(robot)
            print(f"{robot}: {file}: cannot be read ({trouble}): look at the robot, then reset", file=sys.stderr)
        return memory

    def _read(self, robot: str) -> tuple[StoredRobot, bool, str]:
        """Return what was kept, whether nothing was real in its run, and why it cannot be read."""
        try:
            found = _found(self._file(robot).read_bytes())
        except FileNotFoundError:
            return StoredRobot(), False, ""
        except OSError as error:
            return _UNKNOWN, False, str(error)
        return (*max(found)[1:], "") if found else (_UNKNOWN, False, "it is damaged, or of another version")

    def save(self, robot: str, kept: StoredRobot) -> None:
        """Write it over what is there, which stays where that fails and the disk lets it."""
        file = self._file(robot)
        try:
            content = file.read_bytes()
        except FileNotFoundError:
            content = b""
        found = _found(content)
        if len(content) != 2 * _HALF or not found:
            self._make(file, kept)
            return
        number, before, simulated = max(found)
        simulated = simulated if before.latched_as(kept) else self._simulated
        main, spare = _halves(number + 1, kept, simulated=simulated)
        with file.open("r+b", buffering=0) as stream:
            try:
                _write(stream.fileno(), _HALF, spare)
                _write(stream.fileno(), 0, main)
            except OSError:
                with suppress(OSError):
                    _write(stream.fileno(), 0, content)
                raise

    def lose(self, robot: str) -> None:
        """Leave an empty file, which takes no room."""
        with self._file(robot).open("wb", buffering=0) as stream:
            os.fsync(stream.fileno())

    def _make(self, file: Path, kept: StoredRobot) -> None:
        """Write both halves beside, then in their place."""
        file.parent.mkdir(parents=True, exist_ok=True)
        beside = file.with_suffix(".new")
        with beside.open("wb", buffering=0) as stream:
            _write(stream.fileno(), 0, b"".join(_halves(1, kept, simulated=self._simulated and kept.latch != _LOST)))
        beside.replace(file)
        folder = os.open(file.parent, os.O_RDONLY)  # the new name is not on disk before its folder is
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _file(self, robot: str) -> Path:
        return self._folder / f"{robot}.json"


def _halves(number: int, kept: StoredRobot, *, simulated: bool) -> tuple[bytes, bytes]:
    """Return the halves of a file; spaces fill them."""
    fields = {"number": number, **kept._asdict(), "simulated": simulated}
    whole = json.dumps(fields | {"check": _check(fields)}).encode()
    return whole[:-1].ljust(_HALF - 2) + b",\n", (_SPARE + whole).ljust(_HALF - 2) + b"}\n"


def _check(fields: dict[str, int]) -> int:
    return zlib.crc32(json.dumps(fields).encode())


def _write(descriptor: int, at: int, data: bytes) -> None:
    """Write all of it to the disk; OSError where it takes less."""
    if os.pwrite(descriptor, data, at) != len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(descriptor)


def _found(content: bytes) -> list[tuple[int, StoredRobot, bool]]:
    """Return what the halves of a file say, with their numbers; one that nobody can have written says nothing.

    The last value: whether nothing was real in the run. A file of an older version does not say so.
    """
    main, spare = content[:_HALF], content[_HALF:]
    found = []
    for half in (main.rstrip().removesuffix(b",") + b"}", spare.removeprefix(_SPARE).rstrip().removesuffix(b"}")):
        try:
            fields = json.loads(half)
            check = fields.pop("check")
            if check != _check(fields):
                raise ValueError("a half that was not written to its end")
            found.append((_number(fields["number"]), _checked(fields), fields.get("simulated") is True))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return found


def _number(value: object) -> int:
    """Return a number that can be one of these; ValueError if not."""
    if type(value) is not int or not 0 <= value < _MOST:
        raise ValueError(f"{value!r}")
    return value


def _checked(found: dict[str, int]) -> StoredRobot:
    """Return what a half says; ValueError, KeyError or TypeError if nobody can have written that."""
    kept = StoredRobot(_number(found["epoch"]), Latch(found["latch"]), _number(found["latch_id"]))
    if kept.latch and not kept.latch_id:
        raise ValueError("a latch without its number")
    return kept


class RobotState:
    """What one robot's gate must remember: in memory, and where it is kept."""

    def __init__(self, robot: str, state_store: StateStore, complain: Callable[[str], None]) -> None:
        self._robot, self._state_store, self._complain = robot, state_store, complain
        self.kept = state_store.load(robot)
        self._unsaved: StoredRobot | None = None
        self._lost = False  # what is kept was made to count as lost

    def keep(self, memory: StoredRobot, *, due: bool) -> None:
        """Keep it, if it is new; ``due``: try again what could not be kept before.

        A latch that cannot be kept must not be forgotten by a restart: nothing is known then.
        """
        if memory == self.kept or not (due or memory != self._unsaved) or self.save(memory):
            return
        if memory.latch and not (self.kept.latch or self._lost):
            try:
                self._state_store.lose(self._robot)
                self._lost = True
            except OSError as error:
                self._complain(f"after a restart its latch is lost: {error}")

    def save(self, memory: StoredRobot) -> bool:
        """Return whether it could be kept."""
        try:
            self._state_store.save(self._robot, memory)
        except OSError as error:
            self._unsaved = memory
            self._complain(f"its lease and its latch cannot be written to disk: {error}")
            return False
        self.kept, self._unsaved, self._lost = memory, None, False
        return True


def kept(state: GateState) -> StoredRobot:
    """Return what of a gate's state must be kept: a drill is forgotten."""
    latch = Latch.NONE if state.latch == Latch.DRILL else Latch(state.latch)
    return StoredRobot(state.epoch, latch, state.latch_id)

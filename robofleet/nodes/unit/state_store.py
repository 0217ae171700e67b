"""What a driver must remember when it is started again: the epoch of its lease, and what latched its gate."""

import errno
import json
import os
import sys
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol

from robofleet.safety.gate import GateState
from robofleet.safety.latches import Latch

_MOST = 1 << 63  # half of what the wire carries: so many leases or latches nobody lives to see
_HALF = 4096  # bytes: the halves of a file share no block of a disk
_SPARE = b'"spare": '


class StoredRobot(NamedTuple):
    """One robot's memory."""

    epoch: int = 0
    latch: Latch = Latch.NONE
    latch_id: int = 0


_UNKNOWN = StoredRobot(0, Latch.MEMORY_LOST, 1)


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


class FileStateStore:
    """One file a robot, in the user's state folder, of full size from the start: a full disk has room for a latch.

    It is JSON, and its second half says what the first one says, each with a number and a checksum. The spare half is
    written first: a half that was not written to its end counts for nothing, and then the other one is whole.
    """

    def __init__(self, arena: str) -> None:
        self._folder = state_folder() / arena

    def prove(self, robots: tuple[str, ...]) -> None:
        """Make room for what these robots must keep, and write it once; OSError, which names the place, if not."""
        for robot in robots:
            try:
                self.save(robot, self.load(robot))
            except OSError as error:
                raise OSError(error.errno, error.strerror, str(self._file(robot))) from error

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
        file = self._file(robot)
        try:
            found = _found(file.read_bytes())
        except FileNotFoundError:
            return StoredRobot()
        except OSError as error:
            return self._unreadable(robot, error)
        return max(found)[1] if found else self._unreadable(robot, "it is damaged, or of another version")

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
        main, spare = _halves(max(found)[0] + 1, kept)
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
            _write(stream.fileno(), 0, b"".join(_halves(1, kept)))
        beside.replace(file)
        folder = os.open(file.parent, os.O_RDONLY)  # the new name is not on disk before its folder is
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _unreadable(self, robot: str, why: object) -> StoredRobot:
        print(f"{robot}: {self._file(robot)}: cannot be read ({why}): look at the robot, then reset", file=sys.stderr)
        return _UNKNOWN

    def _file(self, robot: str) -> Path:
        return self._folder / f"{robot}.json"


def _halves(number: int, kept: StoredRobot) -> tuple[bytes, bytes]:
    """Return the halves of a file; spaces fill them."""
    fields = {"number": number, **kept._asdict()}
    whole = json.dumps(fields | {"check": _check(fields)}).encode()
    return whole[:-1].ljust(_HALF - 2) + b",\n", (_SPARE + whole).ljust(_HALF - 2) + b"}\n"


def _check(fields: dict[str, int]) -> int:
    return zlib.crc32(json.dumps(fields).encode())


def _write(descriptor: int, at: int, data: bytes) -> None:
    """Write all of it to the disk; OSError where it takes less."""
    if os.pwrite(descriptor, data, at) != len(data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(descriptor)


def _found(content: bytes) -> list[tuple[int, StoredRobot]]:
    """Return what the halves of a file say, with their numbers; one that nobody can have written says nothing."""
    main, spare = content[:_HALF], content[_HALF:]
    found = []
    for half in (main.rstrip().removesuffix(b",") + b"}", spare.removeprefix(_SPARE).rstrip().removesuffix(b"}")):
        try:
            fields = json.loads(half)
            check = fields.pop("check")
            if check != _check(fields):
                raise ValueError("a half that was not written to its end")
            found.append((_number(fields["number"]), _checked(fields)))
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

"""The file by which a run is found: where its bus is, and who is on it.

It stands in two folders: the register, ``/tmp/robofleet``, where every user of this computer sees every run; and this
user's private folder, by which an own run is found even where somebody has spoiled the register. Root also reads the
private folders of all users. A lock is held on a file as long as the launcher lives, however it ends: so a file that
was left behind is known, and an arena has one run at a time. Asking takes no lock. What others have written is believed
as far as the system vouches for it: the owner. Own runs are found before any file of another user is opened.
"""

import fcntl
import json
import os
import pwd
import re
import stat
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robofleet.bus.private_folder import PlaceError, private_folder, temporary_folder, users_folders
from robofleet.core.clock import utc_now
from robofleet.core.errors import BadInputError
from robofleet.core.patterns import ENDPOINT_PATTERN, NAME_PATTERN, PRIVATE

if TYPE_CHECKING:  # who looks for a run needs no configuration, and is in a hurry
    from robofleet.config.tree import Config

_LARGEST_FILE_BYTES = 65536
_LONGEST_PATH = 4096
_TRIES = 10
_MOST_FILES_OF_USER = 256  # that are opened of another user
_FILE = re.compile(rf"({NAME_PATTERN.strip('^$')})\.(\d{{1,10}})\.json")
_LOCK = struct.Struct("hhqqi4x")  # struct flock: kind, whence, start, length, process
_REGISTER_MODE = 0o1777


class ArenaFile(NamedTuple):
    """A running arena."""

    arena: str
    endpoint: str
    pid: int  # the launcher's
    folder: str  # of the run
    started: str  # UTC, ISO 8601
    robots: tuple[str, ...]  # the group's in its order, then the bystanders
    units: dict[str, tuple[str, ...]]  # the same robots by the processes that drive them
    uid: int  # whose run it is

    @property
    def mine(self) -> bool:
        """Whether this user may stop it."""
        return os.geteuid() in (0, self.uid)

    @property
    def own(self) -> bool:
        """Whether this user may load its configuration, and with it the modules that it names: root's is root's."""
        return os.geteuid() == self.uid

    @property
    def user(self) -> str:
        try:
            return pwd.getpwuid(self.uid).pw_name
        except KeyError:
            return f"user {self.uid}"


class ArenaBusyError(BadInputError):
    """Raised where an arena has a run already. The message says whose, and how to end it."""


class Found(NamedTuple):
    """What runs on this computer."""

    runs: tuple[ArenaFile, ...]  # of all users
    places: tuple[str, ...]  # where was looked
    troubles: tuple[str, ...]  # places that cannot be trusted or read, a line each


@contextmanager
def claimed(config: "Config", folder: Path) -> Iterator[None]:
    """Leave the files for as long as the run is on; ArenaBusyError where there is one, PlaceError where none can be."""
    uid, started = os.geteuid(), f"{utc_now():%Y-%m-%dT%H:%M:%SZ}"
    mine = ArenaFile(
        config.arena.name, config.bus.endpoint, os.getpid(), str(folder.absolute()), started,
        config.ids, config.units, uid,
    )  # fmt: skip
    with ExitStack() as held:
        for directory in (_register(), private_folder()):
            held.enter_context(_held(directory / f"{mine.arena}.{uid}.json", mine))
        for other in Search(mine.arena).others():  # two who begin in the same moment see each other
            raise ArenaBusyError(_whose(other.arena, other))
        yield


class Search:
    """A look for the runs of an arena, or for all; ``places`` and ``troubles`` grow with it, as ``Found`` has them."""

    def __init__(self, arena: str | None = None) -> None:
        self.places: list[str] = []
        self.troubles: list[str] = []
        self._arena, self._uid = arena, os.geteuid()
        self._seen: set[tuple[str, int]] = set()

    def permitted(self) -> Iterator[ArenaFile]:
        """Yield the runs that this user may stop, the own ones first."""
        yield from self.own()
        if self._uid == 0:
            yield from self.others()

    def own(self) -> Iterator[ArenaFile]:
        """Yield the runs of this user; no file of another user is opened."""
        for directory in (private_folder, _register):
            for file in self._files(self._place(directory), self._uid):
                yield from self._running(file)
        for folder, uid in users_folders():  # of a session with another XDG_RUNTIME_DIR
            for file in self._files(folder, self._uid) if uid == self._uid else ():
                yield from self._running(file)

    def others(self) -> Iterator[ArenaFile]:
        """Yield the runs of all other users, a file of each in turn: many of one user do not delay the others'.

        Root reads the private folders of users, too: who owns the register can remove what stands there.
        """
        folders: list[tuple[Path | None, int | None]] = [(self._place(_register), None)]
        folders += users_folders() if self._uid == 0 else ()
        of_users: dict[int, list[Path]] = {}
        for folder, user in folders:
            for file in self._files(folder, user):
                with suppress(OSError):
                    if (uid := file.lstat().st_uid) != self._uid and file.name.endswith(f".{uid}.json"):
                        of_users.setdefault(uid, []).append(file)
        for uid, files in of_users.items():
            if len(files) > _MOST_FILES_OF_USER:
                self._trouble(f"user {uid} has more than {_MOST_FILES_OF_USER} files of runs: name the arena")
        for turn in zip_longest(*(files[:_MOST_FILES_OF_USER] for files in of_users.values())):
            for file in filter(None, turn):
                yield from self._running(file)

    def _place(self, directory: Callable[[], Path]) -> Path | None:
        try:
            folder = directory()
        except OSError as error:
            self._trouble(str(error))
            return None
        if str(folder) not in self.places:
            self.places.append(str(folder))
        return folder

    def _files(self, folder: Path | None, uid: int | None) -> list[Path]:
        """Return a folder's files about the runs that are looked for; ``uid``: those of one user."""
        if folder is None:
            return []
        if self._arena is not None and uid is not None:
            names = [f"{self._arena}.{uid}.json"]
        else:
            try:
                names = sorted(entry.name for entry in folder.iterdir())
            except OSError as error:
                self._trouble(str(error))
                return []
        matches = filter(None, map(_FILE.fullmatch, names))
        return [
            folder / match[0] for match in matches if self._arena in (None, match[1]) and uid in (None, int(match[2]))
        ]

    def _running(self, file: Path) -> Iterator[ArenaFile]:
        run = _running(file)
        if run is not None and (run.arena, run.uid) not in self._seen:
            self._seen.add((run.arena, run.uid))
            yield run

    def _trouble(self, line: str) -> None:
        if line not in self.troubles:
            self.troubles.append(line)


def found() -> Found:
    """Look for all runs of all users, as far as this user sees them."""
    search = Search()
    runs = sorted((*search.own(), *search.others()), key=lambda run: (run.arena, run.uid))
    return Found(tuple(runs), tuple(search.places), tuple(search.troubles))


def running(arena: str | None = None) -> list[ArenaFile]:
    """Return the runs that this user may stop, or those of an arena; the own ones first."""
    return [*Search(arena).permitted()]


def twin_port(arena: str, robot: str) -> Path:
    """Return where a robot's twin leaves its serial port: a link to a pseudo-terminal."""
    return private_folder() / f"{arena}-{robot}.tty"


def _register() -> Path:
    """Return the register, made if need be; PlaceError where somebody has put something else in its place."""
    folder = temporary_folder() / "robofleet"
    try:
        if not os.path.lexists(folder):
            _make(folder)
        seen = folder.lstat()
    except OSError as error:
        raise PlaceError(f"{folder}: {error.strerror}: set TMPDIR to a folder that every user may write to") from error
    if not stat.S_ISDIR(seen.st_mode) or stat.S_IMODE(seen.st_mode) & _REGISTER_MODE != _REGISTER_MODE:
        raise PlaceError(
            f"{folder} is not the folder in which every user's runs are found (mode 1777): an administrator "
            f"moves it away with `mv {folder} {folder}.old`, or set TMPDIR for everybody who uses robofleet"
        )
    return folder


def _make(folder: Path) -> None:
    """Make the register, with its mode from the beginning, whatever the umask is; somebody else may be faster."""
    fresh = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))
    fresh.chmod(_REGISTER_MODE)
    try:
        fresh.rename(folder)  # which replaces nothing but an empty folder
    except OSError:
        fresh.rmdir()


@contextmanager
def _held(file: Path, mine: ArenaFile) -> Iterator[None]:
    """Write a file and keep it locked."""
    descriptor = _locked(file, mine.arena)
    try:
        text = json.dumps({name: value for name, value in mine._asdict().items() if name != "uid"}).encode()
        os.pwrite(descriptor, text, 0)
        os.ftruncate(descriptor, len(text))
        try:
            yield
        finally:
            with suppress(OSError):
                file.unlink()
    finally:
        os.close(descriptor)


def _locked(file: Path, arena: str) -> int:
    for _ in range(_TRIES):
        try:
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
        except OSError as error:
            raise _spoiled(file) from error
        try:
            seen = os.fstat(descriptor)
            if not stat.S_ISREG(seen.st_mode) or seen.st_uid != os.geteuid() or seen.st_nlink > 1:
                raise _spoiled(file)
            if _is_locked(descriptor):
                raise ArenaBusyError(_whose(arena, _running(file)))
            try:
                fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0))
            except BlockingIOError:  # a stranger may lock it for reading: then another file takes its place
                if not _is_locked(descriptor):
                    file.unlink(missing_ok=True)
            else:
                if os.path.samestat(seen, file.lstat()):
                    os.fchmod(descriptor, 0o644)
                    kept, descriptor = descriptor, -1
                    return kept
        except FileNotFoundError:
            pass  # who had it has just ended
        finally:
            if descriptor >= 0:
                os.close(descriptor)
    raise ArenaBusyError(_whose(arena, _running(file)))


def _spoiled(file: Path) -> PlaceError:
    return PlaceError(f"{file} is not a file of yours, and yours alone: an administrator removes it with `rm {file}`")


def _is_locked(descriptor: int) -> bool:
    """Return whether a launcher lives that holds a file: only who may write to it can lock it for writing."""
    lock = _LOCK.pack(fcntl.F_RDLCK, os.SEEK_SET, 0, 0, 0)
    kind, *_ = _LOCK.unpack(fcntl.fcntl(descriptor, fcntl.F_OFD_GETLK, lock))
    return bool(kind != fcntl.F_UNLCK)


def _running(file: Path) -> ArenaFile | None:
    """Return what a file says whose launcher lives, and which the user wrote who is in its name."""
    name = _FILE.fullmatch(file.name)
    if name is None:
        return None
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        seen, uid = os.fstat(descriptor), int(name[2])
        if not stat.S_ISREG(seen.st_mode) or seen.st_uid != uid or seen.st_nlink > 1 or not _is_locked(descriptor):
            return None
        before = None
        for _ in range(_TRIES):
            text = os.pread(descriptor, _LARGEST_FILE_BYTES, 0)
            if text != before and (run := _checked(text, name[1], uid)) is not None:
                return run
            before = text
            os.sched_yield()  # it is being written
    except OSError:
        pass
    finally:
        os.close(descriptor)
    return None


def _checked(text: bytes, arena: str, uid: int) -> ArenaFile | None:
    """Return what a file says; None if no launcher can have written that."""
    try:
        fields = json.loads(text)
        units = {unit: tuple(robots) for unit, robots in fields["units"].items()}
        run = ArenaFile(**fields | {"robots": tuple(fields["robots"]), "units": units, "uid": uid})
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    lines = run.folder, run.started, run.endpoint
    if not all(type(line) is str and line.isprintable() and len(line) <= _LONGEST_PATH for line in lines):
        return None
    if type(run.pid) is not int or run.pid <= 1 or run.arena != arena:
        return None
    if run.endpoint == PRIVATE or not re.match(ENDPOINT_PATTERN, run.endpoint):
        return None
    named = all(type(name) is str and re.match(NAME_PATTERN, name) for name in (*run.robots, *run.units))
    if not named or sorted(chain(*run.units.values())) != sorted(run.robots):
        return None
    return run


def _whose(arena: str, run: ArenaFile | None) -> str:
    if run is None:
        return f"the arena {arena} has a run already: end it first"
    what = f"the arena {arena} has a run already, in {run.folder} since {run.started} (process {run.pid}"
    if run.mine and run.uid == os.geteuid():
        return f"{what}): end it with Ctrl-C there, or with `kill {run.pid}`"
    return f"{what} of {run.user}): ask {run.user} to end it, or an administrator"

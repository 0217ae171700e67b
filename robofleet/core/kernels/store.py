"""Where compiled functions are kept on disk: one file for each signature, named after all that decides its content.

A file is code that runs. So the folder is the user's alone (mode 0700), and each file is the user's, no link, and
writable for nobody else. What is not so is not read: a process compiles anew.

A built wheel brings kernels for a common processor in ``compiled/`` (``tools/compile_kernels.py``). They are read
before the user's own, where only the owner of the package's own source can write them.
"""

import contextlib
import fcntl
import functools
import hashlib
import os
import pickle
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from multiprocessing import parent_process
from pathlib import Path
from typing import IO, Any

from llvmlite.binding import get_host_cpu_features
from numba.core import serialize
from numba.core.caching import _Cache
from numba.core.codegen import RuntimeLinker
from numba.core.compiler import CompileResult

from robofleet.core.clock import MS, Clock, S
from robofleet.core.files import open_plain
from robofleet.core.folders import kernels_folder
from robofleet.core.kernels import SHIPPED, label

folder: Callable[[], Path] = kernels_folder  # another one in tests, and where a wheel is built
_TURN_EVERY_NS, _LONGEST_WAIT_NS = 20 * MS, 60 * S
_LARGEST = 256_000_000  # bytes in the folder; those that nobody has read for longest go first
_CHECK = 16  # bytes of digest before the content
SHIPPED_CPU = "x86-64-v3"
_SHIPPED_CPU_FEATURES = (
    "avx",
    "avx2",
    "bmi",
    "bmi2",
    "f16c",
    "fma",
    "lzcnt",
    "movbe",
    "popcnt",
    "xsave",
)  # LLVM's names


def labels() -> frozenset[str]:
    """Return those of which there are files that this processor may run: the package's, and this user's."""
    found = set[str]()
    for where in (folder(), *([SHIPPED] if runs_shipped() else [])):
        with contextlib.suppress(OSError):
            found |= {file.name.rpartition("-")[0] for file in where.iterdir()}
    return frozenset(found)


def kept(compiled: Any, meaning: Callable[[], str]) -> Any:
    """Let what numba compiles be kept on disk, by the digest of its function."""
    if hasattr(compiled, "py_func"):  # else numba is switched off
        compiled._cache = KernelCache(compiled.py_func.__name__, meaning)  # enable_caching() takes none but numba's own
    return compiled


class KernelCache(_Cache):
    """The cache of one of numba's dispatchers, which asks it before it compiles and gives it what it compiled.

    A file that is missing, damaged or cannot be written costs a compilation, never an error. It is complete or not
    there: two processes that compile the same replace each other's file by an equal one.
    """

    def __init__(self, name: str, meaning: Callable[[], str]) -> None:
        """``meaning``: the digest of the function."""
        self._name, self._meaning = name, meaning

    @property
    def cache_path(self) -> str:
        return str(folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function of a signature, None where there is none."""
        target_context.refresh()
        machine = target_context.codegen().magic_tuple()
        if runs_shipped():  # first: what was compiled here before must not change what is computed
            content = _shipped_content(self._name_of(sig, (machine[0], SHIPPED_CPU, "")))
            if (found := _rebuilt(target_context, content)) is not None:
                return found
        content = b""
        with _opened(folder()) as directory, contextlib.suppress(OSError):
            if directory is not None:
                content = _content(directory / self._name_of(sig, machine))
        return _rebuilt(target_context, content)

    def save_overload(self, sig: Any, data: Any) -> None:
        if data.library.has_dynamic_globals or any(not lifted.can_cache for lifted in data.lifted) or _calls_back(data):
            return  # addresses of this process are in it
        dumps: Callable[..., bytes] = serialize.dumps
        content = dumps(data._reduce())
        with contextlib.suppress(OSError):
            folder().mkdir(mode=0o700, parents=True, exist_ok=True)
        with _opened(folder()) as directory, contextlib.suppress(OSError):
            if directory is not None:
                _write(directory / self._name_of(sig, data.codegen.magic_tuple()), _digest(content) + content)
                _make_room(directory)

    def enable(self) -> None:
        """It always is."""

    def disable(self) -> None:
        """It never is."""

    def flush(self) -> None:
        """Nothing in it is ever stale."""

    def _name_of(self, sig: Any, machine: tuple[str, ...]) -> str:
        fields = [getattr(kind, "fields", ()) for kind in getattr(sig, "args", sig)]
        what = repr((self._meaning(), sig, fields, machine))
        return f"{label(self._name, self._meaning())}-{_digest(what.encode()).hex()}"


def _rebuilt(target_context: Any, content: bytes) -> Any:
    """Return the compiled function that a file holds; None where it holds none that fits."""
    check, data = content[:_CHECK], content[_CHECK:]
    if check != _digest(data):  # cut, or changed: the linker would end the process
        return None
    try:
        rebuild: Callable[..., Any] = CompileResult._rebuild
        return rebuild(target_context, *pickle.loads(data))
    except Exception:  # noqa: BLE001 - whatever it needs is no longer there: compile it again
        return None


@functools.cache
def runs_shipped() -> bool:
    """Return whether this processor runs the kernels that a wheel brings."""
    features = get_host_cpu_features()
    return all(features.get(name) for name in _SHIPPED_CPU_FEATURES)


def _shipped_content(name: str) -> bytes:
    """Return what a file of the package holds; nothing where more users can write it than the package's source."""
    trusted = Path(__file__).stat().st_uid
    with contextlib.suppress(OSError), open_plain(SHIPPED / name) as stream:
        found = SHIPPED.lstat(), os.fstat(stream.fileno())
        if all(_is_only_of(trusted, status) for status in found):
            return stream.read()
    return b""


@contextlib.contextmanager
def turn(clock: Clock) -> Iterator[None]:
    """Wait for one of as many turns to compile as there are cores, and keep it.

    The processes of a run compile for 3 to 20 s each. Where all of them share two cores, the longest one is slow as
    long as the others are there, and alone afterwards. Where nothing can be kept, nobody waits; nobody waits for long
    for a process that does not go on.
    """
    with contextlib.suppress(OSError):
        folder().mkdir(mode=0o700, parents=True, exist_ok=True)
    with contextlib.ExitStack() as held:
        directory, files = held.enter_context(_opened(folder())), list[IO[str]]()
        if directory is not None:
            with contextlib.suppress(OSError):
                cores = range(len(os.sched_getaffinity(0)))
                files = [held.enter_context((directory / f"turn-{core}").open("a")) for core in cores]
        until_ns = clock.now_ns() + _LONGEST_WAIT_NS
        while files and clock.now_ns() < until_ns and not any(map(_locks, files)):
            clock.sleep_until(clock.now_ns() + _TURN_EVERY_NS)
        yield


def _locks(file: IO[str]) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextlib.contextmanager
def _opened(directory: Path) -> Iterator[Path | None]:
    """Yield a folder as it is now, whatever somebody puts in its place; None: it is not there, or not the user's alone.

    One that others may only read, as an older version made it, is closed.
    """
    with contextlib.ExitStack() as held:
        opened = None
        try:
            handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            held.callback(os.close, handle)
            if _is_own(found := os.fstat(handle)):
                opened = Path(f"/proc/self/fd/{handle}")
                if found.st_mode & 0o077:
                    os.fchmod(handle, 0o700)
            else:
                _say_unused(f"{directory} is not yours alone: remove it with `rm -r {directory}`")
        except FileNotFoundError:
            pass
        except OSError as error:
            _say_unused(f"{directory}: {error.strerror}")
        yield opened


def _is_own(found: os.stat_result) -> bool:
    """Return whether a file or folder is no link, is this user's, and can be written by nobody else."""
    return _is_only_of(os.geteuid(), found)


def _is_only_of(user: int, found: os.stat_result) -> bool:
    return not stat.S_ISLNK(found.st_mode) and found.st_uid == user and not found.st_mode & 0o022


@functools.cache
def _say_unused(why: str) -> None:
    if parent_process() is None:  # the workers of one command would all say it
        print(f"compiled kernels are not kept, and every start compiles: {why}", file=sys.stderr)


def _content(file: Path) -> bytes:
    """Return what a file of this user holds; nothing where it may be another's."""
    with open_plain(file) as stream:
        found = os.fstat(stream.fileno())
        if found.st_nlink > 1 or not _is_own(found):
            return b""
        os.utime(stream.fileno())
        return stream.read()


def _calls_back(compiled: Any) -> bool:
    """Whether it calls a function that calls it: numba links such in memory."""
    variables = compiled.library._final_module.global_variables
    return any(variable.name.startswith(RuntimeLinker.PREFIX) for variable in variables)


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECK).digest()


def _write(path: Path, content: bytes) -> None:
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=".part-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(part).replace(path)
    except OSError:
        Path(part).unlink(missing_ok=True)
        raise


def _make_room(where: Path) -> None:
    files = sorted(((file, file.stat()) for file in where.iterdir()), key=lambda found: found[1].st_mtime)
    total = sum(found.st_size for _, found in files)
    for file, found in files:
        if total <= _LARGEST:
            return
        file.unlink(missing_ok=True)
        total -= found.st_size

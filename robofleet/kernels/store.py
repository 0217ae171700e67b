"""Where compiled functions are kept on disk: one file for each signature, named after all that decides its content."""

import contextlib
import hashlib
import os
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core import serialize
from numba.core.caching import _Cache
from numba.core.codegen import RuntimeLinker
from numba.core.compiler import CompileResult

_PACKAGE = Path(__file__).parents[1]
_LARGEST = 256_000_000  # bytes in the folder; those that nobody has read for longest go first
_CHECK = 16  # bytes of digest before the content


def folder() -> Path:
    """Return where they are kept: beside the package, where that can be written to, else this user's cache."""
    beside = _PACKAGE / "__pycache__"
    if os.access(beside if beside.exists() else _PACKAGE, os.W_OK):
        return beside / "kernels"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robofleet" / "kernels"


def kept(compiled: Any, meaning: Callable[[], str]) -> Any:
    """Let what numba compiles be kept on disk, by the digest of its function."""
    if hasattr(compiled, "py_func"):  # else numba is switched off
        compiled._cache = Kept(compiled.py_func.__name__, meaning)  # enable_caching() takes none but numba's own
    return compiled


class Kept(_Cache):
    """The cache of one of numba's dispatchers, which asks it before it compiles and gives it what it compiled.

    A file that is missing, damaged or cannot be written costs a compilation, never an error. It is complete or not
    there: two processes that compile the same replace each other's file by an equal one.
    """

    def __init__(self, name: str, meaning: Callable[[], str]) -> None:
        """``meaning``: the digest of the function."""
        self._name, self._meaning = name, meaning

    @property
    def cache_path(self) -> str:
        """Return the folder."""
        return str(folder())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function of a signature, None where there is none."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        try:
            content = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        check, data = content[:_CHECK], content[_CHECK:]
        if check != _digest(data):  # cut, or changed: the linker would end the process
            return None
        try:
            rebuild: Callable[..., Any] = CompileResult._rebuild
            return rebuild(target_context, *pickle.loads(data))
        except Exception:  # noqa: BLE001 - whatever it needs is no longer there: compile it again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        if data.library.has_dynamic_globals or any(not one.can_cache for one in data.lifted) or _calls_back(data):
            return  # addresses of this process are in it
        dumps: Callable[..., bytes] = serialize.dumps
        path, content = self._path(sig, data.codegen), dumps(data._reduce())
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            _write(path, _digest(content) + content)
            _make_room(path.parent)

    def enable(self) -> None:
        """It always is."""

    def disable(self) -> None:
        """It never is."""

    def flush(self) -> None:
        """Nothing in it is ever stale."""

    def _path(self, sig: Any, codegen: Any) -> Path:
        fields = [getattr(one, "fields", ()) for one in getattr(sig, "args", sig)]
        what = repr((self._meaning(), sig, fields, codegen.magic_tuple()))
        return folder() / f"{self._name}-{_digest(what.encode()).hex()}"


def _calls_back(compiled: Any) -> bool:
    """Whether it calls a function that calls it: numba links such in memory."""
    variables = compiled.library._final_module.global_variables
    return any(one.name.startswith(RuntimeLinker.PREFIX) for one in variables)


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

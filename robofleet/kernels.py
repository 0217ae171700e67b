"""``@kernel``: a function compiled by numba, once, and kept on disk.

numba's cache looks at the file of the compiled function alone: a kernel that calls one of another file would go on
with its old code. So the cache's folder is named after all sources that hold kernels or are compiled into them.
"""

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

_PACKAGE = Path(__file__).parent
_ROOMS = ("vehicles", "control", "safety", "tracking", "simulation")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call, or load it from the cache."""
    compiled: Callable[P, R] = numba.njit(cache=True)(function)
    return compiled


def image_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """As ``kernel``, for pixels: the order of sums is the compiler's, and a division by zero is an infinity."""
    compiled: Callable[P, R] = numba.njit(cache=True, fastmath=True, error_model="numpy")(function)
    return compiled


def _cache_folder() -> Path:
    """Return a folder that can be written to, beside the package or for this user; older sources' are removed."""
    digest = hashlib.blake2b(digest_size=8)
    for source in sorted(source for room in _ROOMS for source in (_PACKAGE / room).glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    name = f"kernels-{digest.hexdigest()}"
    beside = _PACKAGE / "__pycache__"
    if not os.access(beside if beside.exists() else _PACKAGE, os.W_OK):
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robofleet" / name
    for folder in beside.glob("kernels-*"):
        if folder.name != name:
            shutil.rmtree(folder, ignore_errors=True)
    return beside / name


numba.config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]

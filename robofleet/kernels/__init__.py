"""``kernel``, ``model``: functions that numba compiles once, kept on disk by what they mean."""

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba

from robofleet.kernels.meaning import UnknownMeaningError, digest_of, snapshot
from robofleet.kernels.store import Kept

__all__ = ["INFINITE", "UnknownMeaningError", "image_kernel", "infinite_kernel", "kernel", "model", "snapshot"]

P = ParamSpec("P")
R = TypeVar("R")

INFINITE: dict[str, Any] = {"error_model": "numpy"}  # a division by zero is an infinity, which is then reported
_models: dict[str, Any] = {}


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call, or load it. What it reads must be constant: that is looked at once."""
    return _kernel(function, {})


def infinite_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """As ``kernel``; a division by zero is an infinity."""
    return _kernel(function, INFINITE)


def image_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """As ``kernel``, for pixels: the order of sums is the compiler's, and a division by zero is an infinity."""
    return _kernel(function, {"fastmath": True, **INFINITE})


def model(function: Callable[..., Any]) -> Any:
    """Return the compiled function of what ``function`` means now: the same one for the same meaning.

    All that it reads is taken as it is now, so that a value that changes later, and a new model, are a new function.
    A division by zero is an infinity.

    Raises:
        UnknownMeaningError: the function, or one that it calls, reads a value that cannot be told from a changed one.
    """
    copy, digest = snapshot(function, INFINITE)
    if digest not in _models:
        _models[digest] = _kept(copy, lambda: digest)
    return _models[digest]


def _kernel(function: Callable[P, R], options: dict[str, Any]) -> Callable[P, R]:
    compiled: Callable[P, R] = _kept(
        numba.njit(**options)(function), functools.cache(lambda: digest_of(function, options))
    )
    return compiled


def _kept(compiled: Any, digest: Callable[[], str]) -> Any:
    if hasattr(compiled, "py_func"):  # else numba is switched off
        compiled._cache = Kept(compiled.py_func.__name__, digest)  # enable_caching() takes none but numba's own
        compiled.meaning = digest
    return compiled

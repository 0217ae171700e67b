"""``kernel``, ``model``: functions that numba compiles once, kept on disk by what they mean."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from robofleet.core.errors import RobofleetError
from robofleet.core.kernels.lazy import Kernel, PlainKernel, reached

__all__ = [
    "INFINITE",
    "Kernel",
    "UnknownMeaningError",
    "image_kernel",
    "infinite_kernel",
    "kernel",
    "kernel_of_plain",
    "model",
    "reached",
    "snapshot",
]

P = ParamSpec("P")
R = TypeVar("R")

INFINITE: dict[str, Any] = {"error_model": "numpy"}  # a division by zero is an infinity, which is then reported
_NO_CALLBACK = {"no_cfunc_wrapper": True}  # nobody calls a kernel from C
_models: dict[str, Any] = {}


class UnknownMeaningError(RobofleetError, TypeError):
    """Raised where a function reads a value of which nobody can tell whether it changed. The message names both."""


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call, or load it. What it reads must be constant: that is looked at once."""
    return _kernel(function, {})


def kernel_of_plain(function: Callable[P, R]) -> Callable[..., R]:
    """As ``kernel``, for a function that others call uncompiled; the plain functions that it calls are compiled too.

    The compiled form takes rows of arrays where the function takes records with the same fields.
    """
    return cast("Callable[..., R]", PlainKernel(function, dict(_NO_CALLBACK)))


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
    from robofleet.core.kernels.store import kept  # noqa: PLC0415 - numba takes a second to load

    copy, digest = snapshot(function, INFINITE)
    if digest not in _models:
        _models[digest] = kept(copy, lambda: digest)
    return _models[digest]


def snapshot(function: Callable[..., Any], options: dict[str, Any]) -> tuple[Any, str]:
    """Return a compiled copy of a function as it means now, and its digest; see ``meaning.snapshot``."""
    from robofleet.core.kernels import meaning  # noqa: PLC0415

    return meaning.snapshot(function, options)


def _kernel(function: Callable[P, R], options: dict[str, Any]) -> Callable[P, R]:
    return cast("Callable[P, R]", Kernel(function, {**options, **_NO_CALLBACK}))

"""``kernel``, ``model``: functions that numba compiles once, kept on disk by what they mean.

Numba, and the modules here that need it, are loaded where a kernel is first called: that takes a second.
"""

import functools
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

SHIPPED = Path(__file__).parent / "compiled"  # what a built wheel brings
P = ParamSpec("P")
R = TypeVar("R")

INFINITE: dict[str, Any] = {"error_model": "numpy"}  # a division by zero is an infinity, which is then reported
_NO_CALLBACK = {"no_cfunc_wrapper": True}  # nobody calls a kernel from C
_LABEL = 16  # signs of a function's digest in the names of its files
_models: dict[str, Any] = {}


class Kernel:
    """A function that numba compiles at its first call, or loads from disk.

    Processes that only import it need no numba. Kernels may call each other.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self._options = function, {**options, **_NO_CALLBACK}

    def __call__(self, *arguments: Any) -> Any:
        return self.compiled(*arguments)

    @functools.cached_property
    def compiled(self) -> Any:
        """numba's dispatcher for calls from Python; the function itself where numba is switched off."""
        return self._kept({}, self.meaning)

    @functools.cached_property
    def _inner(self) -> Any:
        """numba's dispatcher for calls from other kernels."""
        from robofleet.core.kernels.meaning import INNER  # noqa: PLC0415

        return self._kept(INNER, lambda: f"{self.meaning()}, inner")

    @property
    def _numba_type_(self) -> Any:
        """What numba takes a call in another kernel for."""
        return self._inner._numba_type_

    def meaning(self) -> str:
        """Return the digest of the function and of all that it reads."""
        return self._digest

    @functools.cached_property
    def _digest(self) -> str:
        from robofleet.core.kernels.meaning import digest_of  # noqa: PLC0415

        return digest_of(self.py_func, self._options)

    def _kept(self, options: dict[str, Any], meaning: Callable[[], str]) -> Any:
        from robofleet.core.kernels.store import kept  # noqa: PLC0415

        return kept(self._dispatcher({**self._options, **options}), meaning)

    def _dispatcher(self, options: dict[str, Any]) -> Any:
        import numba  # noqa: PLC0415

        return numba.njit(**options)(self.py_func)


class PlainKernel(Kernel):
    """A kernel whose function calls plain functions: numba compiles copies of them all."""

    def _dispatcher(self, options: dict[str, Any]) -> Any:
        return snapshot(self.py_func, options)[0]


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call, or load it. What it reads must be constant: that is looked at once."""
    return _kernel(function, {})


def free_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """As ``kernel``; other threads of the interpreter run meanwhile."""
    return _kernel(function, {"nogil": True})


def kernel_of_plain(function: Callable[P, R]) -> Callable[..., R]:
    """As ``kernel``, for a function that others call uncompiled; the plain functions that it calls are compiled too.

    The compiled form takes rows of arrays where the function takes records with the same fields.
    """
    return cast("Callable[..., R]", PlainKernel(function, {}))


def infinite_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """As ``kernel``; a division by zero is an infinity."""
    return _kernel(function, INFINITE)


def infinite_kernel_of_plain(function: Callable[P, R]) -> Callable[..., R]:
    """As ``kernel_of_plain``; a division by zero is an infinity."""
    return cast("Callable[..., R]", PlainKernel(function, INFINITE))


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
    return cast("Callable[P, R]", Kernel(function, options))


def label(name: str, meaning: str) -> str:
    """Return how the names of a function's files begin: one for each signature follows."""
    return f"{name}-{meaning[:_LABEL]}"


def reached(*kernels: Callable[..., Any]) -> frozenset[Kernel]:
    """Return these kernels and all that they call."""
    found: set[Kernel] = set()
    waiting: list[Any] = list(kernels)
    while waiting:
        value = waiting.pop()
        if isinstance(value, Kernel) and value not in found:
            found.add(value)
            waiting += _named(value.py_func)
    return frozenset(found)


def _named(function: Any) -> Iterator[Any]:
    """What a function's code names: globals, and attributes of modules that are globals."""
    names = function.__code__.co_names
    for value in (function.__globals__.get(name) for name in names):
        yield value
        if isinstance(value, types.ModuleType):
            yield from (vars(value).get(name) for name in names)

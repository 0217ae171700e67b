"""A compiled function that costs nothing until it is called: numba itself is loaded then."""

import functools
import types
from collections.abc import Callable, Iterator
from typing import Any


class Kernel:
    """A function that numba compiles at its first call, or loads from disk.

    Processes that only import it need no numba: it takes seconds to load. Kernels may call each other.
    """

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self._options = function, options

    def __call__(self, *arguments: Any) -> Any:
        """Return what the compiled function returns."""
        return self.compiled(*arguments)

    @functools.cached_property
    def compiled(self) -> Any:
        """numba's dispatcher; the function itself where numba is switched off."""
        import numba  # noqa: PLC0415

        from robofleet.core.kernels.store import kept  # noqa: PLC0415

        return kept(numba.njit(**self._options)(self.py_func), self.meaning)

    @functools.cached_property
    def _numba_type_(self) -> Any:
        """Return what numba takes a call of it for, in another kernel."""
        return self.compiled._numba_type_

    def meaning(self) -> str:
        """Return the digest of the function and of all that it reads."""
        return self._digest

    @functools.cached_property
    def _digest(self) -> str:
        from robofleet.core.kernels.meaning import digest_of  # noqa: PLC0415

        return digest_of(self.py_func, self._options)


class PlainKernel(Kernel):
    """A kernel whose function calls plain functions: numba compiles copies of them all."""

    @functools.cached_property
    def compiled(self) -> Any:
        """numba's dispatcher of the function's copy."""
        from robofleet.core.kernels.meaning import snapshot  # noqa: PLC0415
        from robofleet.core.kernels.store import kept  # noqa: PLC0415

        return kept(snapshot(self.py_func, self._options)[0], self.meaning)


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

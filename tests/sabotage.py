"""Checks taken out one by one, in a copy of a module that is never written to disk: the tests must notice."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from types import ModuleType
from typing import Any

from robofleet.core.kernels import Kernel


def sabotaged(module: ModuleType, old: str, new: str) -> ModuleType:
    """Return the module with one piece of its source replaced."""
    source = inspect.getsource(module)
    assert source.count(old) == 1, f"{source.count(old)} places read {old!r}"
    return remade(module, source.replace(old, new))


def remade(module: ModuleType, source: str) -> ModuleType:
    """Return the module as another source makes it."""
    copy = ModuleType(module.__name__)
    exec(compile(source, str(module.__file__), "exec"), copy.__dict__)
    return copy


def uncompiled(copy: ModuleType) -> ModuleType:
    """Let the kernels of a module run as Python: what is changed for one test is not worth compiling."""
    copy.__dict__.update({name: value.py_func for name, value in vars(copy).items() if isinstance(value, Kernel)})
    return copy


def notices(test: Callable[..., None], fixtures: Mapping[str, Callable[[], Any]]) -> bool:
    """Whether a test, or what it calls, fails for any of its parameters; ``fixtures`` are made anew for each."""
    for case in _cases(test):
        wanted = set(inspect.signature(test).parameters) - set(case)
        try:
            test(**case, **{name: fixtures[name]() for name in wanted})
        except (AssertionError, LookupError):
            return True
    return False


def _cases(test: Callable[..., None]) -> Iterator[dict[str, Any]]:
    """Give the keyword arguments of every case that a test's marks ask for."""
    tables = []
    for mark in (mark for mark in getattr(test, "pytestmark", []) if mark.name == "parametrize"):
        names, rows = mark.args
        names = [names] if isinstance(names, str) else names
        tables.append([dict(zip(names, row if len(names) > 1 else [row], strict=True)) for row in rows])
    for rows in product(*tables):
        yield {name: value for row in rows for name, value in row.items()}

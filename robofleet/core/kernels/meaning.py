"""What decides the machine code of a function: its bytecode, and every value that it reads, recursively.

numba freezes the globals and closure cells that a function reads, and those of the functions that it calls. Its own
cache looks at the function's file alone. Here a digest is taken of all of them: bytecode, constants, defaults, globals,
cells, attributes of modules, options of compilation. What cannot be taken a digest of is refused, by name.
"""

import builtins
import dis
import enum
import functools
import hashlib
import inspect
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import llvmlite
import numba
import numpy as np
from llvmlite.binding import parse_assembly
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher

from robofleet.core.errors import UnknownMeaningError
from robofleet.core.kernels import Kernel

# what they compile to is known from their name and the version
_LIBRARIES = {"numpy", "numba", "math", "cmath", "operator", "builtins"}
_VERSIONS = (str(sys.implementation.cache_tag), numba.__version__, llvmlite.__version__, np.__version__)


class InnerLibrary(JITCodeLibrary):
    """A function that only compiled code calls: optimised and translated into machine code as a part of its callers.

    A quarter of all compilation would go into machine code that nobody runs.
    """

    def __init__(self, codegen: Any, *, fastmath: bool) -> None:
        super().__init__(codegen, "inner")  # type: ignore[no-untyped-call]
        self._fastmath = fastmath
        self.enable_object_caching()  # type: ignore[no-untyped-call]

    def _optimize_final_module(self) -> None:
        if self._fastmath:  # the order of its sums is decided here
            super()._optimize_final_module()  # type: ignore[no-untyped-call]

    def _finalize_final_module(self) -> None:
        """Compile nothing but the addresses of numba's environments, which numba writes."""
        module = self._final_module
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        names = [value.name for value in module.global_variables if value.name.startswith("_ZN08NumbaEnv")]
        self._final_module = parse_assembly("\n".join(f'@"{name}" = common global ptr null' for name in names))
        self._final_module.triple, self._final_module.data_layout = module.triple, module.data_layout
        super()._finalize_final_module()  # type: ignore[no-untyped-call]
        self._final_module = module


class InnerCompiler(Compiler):
    """Compiles into an ``InnerLibrary``."""

    def __init__(self, typing: Any, target: Any, library: Any, args: Any, result: Any, flags: Any, types: Any) -> None:
        library = InnerLibrary(target.codegen(), fastmath=bool(flags.fastmath))
        super().__init__(typing, target, library, args, result, flags, types)  # type: ignore[no-untyped-call]


# A function that only compiled code calls becomes a part of each caller, and has no wrapper for Python. A copy beside a
# caller would be shared by all callers that are loaded. Copies round differently where the order of sums is the
# compiler's: results would depend on which caller was loaded first.
INNER = {"no_cpython_wrapper": True, "forceinline": True, "pipeline_class": InnerCompiler}
_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


def digest_of(function: Callable[..., Any], options: object) -> str:
    """Return the digest of what a function, compiled with ``options``, means now.

    Raises:
        UnknownMeaningError: it reads a value of which no digest can be taken.
    """
    return _Walk(copies=False).digest(function, options)


def snapshot(function: Callable[..., Any], options: dict[str, Any]) -> tuple[Any, str]:
    """Return a copy of a function as it means now, for numba to compile with ``options``, and its digest.

    Functions that it calls are copied too, compiled anew with their own options, or with ``options`` where they are
    plain Python: a compiled one of the user's may hold old values. Kernels of this project stay: theirs are constants.

    Raises:
        UnknownMeaningError: it reads a value of which no digest can be taken.
    """
    walk = _Walk(copies=True, options=options)
    digest = walk.digest(function, options)
    for copy in walk.copies_made:  # numba names machine code after it: two models in one process must not share names
        copy.__qualname__ = f"{copy.__qualname__}_{digest}"
    return walk.top, digest


class _Walk:
    """Goes through a function and all that it reads, once."""

    def __init__(self, *, copies: bool, options: dict[str, Any] | None = None) -> None:
        self._copies, self._options = copies, options or {}
        self._hash = hashlib.blake2b(digest_size=16)
        self._met: dict[object, tuple[int, Any]] = {}  # by identity: a number, and what takes its place in the copy
        self._alive: list[Any] = []  # what was met: identities are not used again meanwhile
        self._path: list[str] = []  # the user's functions on the way to where it is
        self.copies_made: list[types.FunctionType] = []
        self.top: Any = None

    def digest(self, function: Callable[..., Any], options: object) -> str:
        self._say("versions", *_VERSIONS, "options", repr(options), repr(INNER))
        plain = function.py_func if isinstance(function, Dispatcher | Kernel) else function
        if not isinstance(plain, types.FunctionType):
            raise UnknownMeaningError(f"expected a Python function, got a {type(function).__name__}")
        self.top = self._function(plain, numba.njit(**self._options))
        return self._hash.hexdigest()

    def _say(self, *words: str | bytes) -> None:
        for word in words:
            data = word.encode() if isinstance(word, str) else word
            self._hash.update(f"{len(data)}:".encode() + data)

    def _value(self, value: Any, name: str) -> Any:
        """Take the digest of the value of ``name``; return what takes its place in the copy."""
        if isinstance(value, enum.Enum):
            self._say("enum", _name(type(value)), value.name)
            self._value(value.value, name)
        elif type(value) in _PLAIN:
            self._say(type(value).__name__, repr(value))
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            order = f"{value.flags.c_contiguous}{value.flags.f_contiguous}"
            self._say("array", repr(value.dtype), repr(value.shape), order, value.tobytes())
            return value.copy(order="K") if self._copies else value
        elif isinstance(value, np.generic | np.dtype | numba.types.Type):
            self._say(type(value).__name__, repr(value))
        elif isinstance(value, tuple | list):
            self._say(_name(type(value)), repr(getattr(type(value), "_fields", "")), str(len(value)))
            items = [self._value(item, name) for item in value]
            return value if all(a is b for a, b in zip(items, value, strict=True)) else _like(value, items)
        elif isinstance(value, type) and issubclass(value, enum.Enum):
            self._say("enum class", _name(value), *(f"{member.name}={member.value!r}" for member in value))
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            self._say("named tuple", _name(value), repr(value._fields))
        else:
            return self._by_name_or_code(value, name)
        return value

    def _by_name_or_code(self, value: Any, name: str) -> Any:
        if isinstance(value, Kernel):
            if _is_ours(value.py_func):
                self._say("kernel", value.meaning())
                return value
            value = numba.typeof(value).dispatcher  # type: ignore[no-untyped-call]
        if isinstance(value, Dispatcher):
            options = {**value.targetoptions, "locals": value.locals}
            self._say("compiled", repr(sorted(options.items(), key=str)))
            inner = INNER if self._is_part(value) else {}
            return self._function(value.py_func, numba.jit(**{**options, **inner}))
        if (library := _library_name(value)) is not None:
            self._say("library", library)
            return value
        if isinstance(value, types.FunctionType):
            return self._function(value, numba.njit(**{**self._options, **INNER}))
        raise UnknownMeaningError(
            f"{', which calls '.join(self._path)} reads {name}, of type {type(value).__name__}: nobody can tell when "
            "it changes; use numbers, tuples, arrays or functions"
        )

    def _is_part(self, compiled: Dispatcher) -> bool:
        """Whether a function may become a part of its callers: it has the model's options, and does not call itself."""
        code = compiled.py_func.__code__
        calls_itself = code.co_name in (*code.co_names, *code.co_freevars)
        return {**self._options, "nopython": True, "boundscheck": None} == compiled.targetoptions and not calls_itself

    def _function(self, function: types.FunctionType, placed: Callable[[types.FunctionType], Any]) -> Any:
        """Take the digest of a function; return its copy as ``placed``."""
        if id(function) in self._met:
            number, placed_at = self._met[id(function)]
            self._say("met", str(number))
            return placed_at
        self._alive.append(function)
        code, copy, placed_at = function.__code__, function, function
        if self._copies:
            copy = _empty_copy(function)
            placed_at = placed(copy)
            self.copies_made.append(copy)
        self._met[id(function)] = len(self._met), placed_at
        shown = [] if _is_ours(function) else [f"{function.__qualname__} ({code.co_filename}:{code.co_firstlineno})"]
        self._path += shown
        self._code(code)
        self._value(function.__defaults__ or (), "a default value")
        self._value(tuple(sorted((function.__kwdefaults__ or {}).items())), "a default value")
        self._globals(function, copy)
        self._cells(function, copy)
        del self._path[len(self._path) - len(shown) :]
        return placed_at

    def _globals(self, function: types.FunctionType, copy: types.FunctionType) -> None:
        attributes = _attributes(function.__code__)
        for name in sorted(_globals_read(function.__code__)):
            self._say("global", name)
            if name in function.__globals__:
                read = self._read(function.__globals__[name], name, attributes)
                if self._copies:
                    copy.__globals__[name] = read

    def _cells(self, function: types.FunctionType, copy: types.FunctionType) -> None:
        attributes = _attributes(function.__code__)
        cells = zip(function.__closure__ or (), copy.__closure__ or (), strict=True)
        for name, (cell, into) in zip(function.__code__.co_freevars, cells, strict=True):
            self._say("cell", name)
            try:
                contents = cell.cell_contents
            except ValueError:  # empty yet: numba names it
                continue
            read = self._read(contents, name, attributes)
            if self._copies:
                into.cell_contents = read

    def _read(self, value: Any, name: str, attributes: frozenset[str]) -> Any:
        """As ``_value``; of a module only those attributes that the function's code names."""
        if not isinstance(value, types.ModuleType):
            return self._value(value, name)
        self._say("module", value.__name__)
        if value.__name__.partition(".")[0] in _LIBRARIES:
            return value
        if (key := (id(value), attributes)) in self._met:
            return self._met[key][1]
        twin = types.ModuleType(value.__name__) if self._copies else value
        self._alive.append(value)
        self._met[key] = len(self._met), twin
        for attribute in sorted(attributes & vars(value).keys()):
            self._say("attribute", attribute)
            found = self._read(vars(value)[attribute], f"{name}.{attribute}", attributes)
            if self._copies:
                setattr(twin, attribute, found)
        return twin

    def _code(self, code: types.CodeType) -> None:
        """Take the digest of a code, without its place in a file."""
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        kinds = code.co_flags & (
            inspect.CO_VARARGS | inspect.CO_VARKEYWORDS | inspect.CO_GENERATOR
        )  # profilers set more
        counts = (code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, kinds)
        self._say("code", code.co_code, code.co_exceptiontable, repr(names), repr(counts), str(len(code.co_consts)))
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self._code(constant)
            elif isinstance(constant, frozenset):
                self._say("set", *sorted(map(repr, constant)))
            else:
                self._say(type(constant).__name__, repr(constant))


def _is_ours(function: Callable[..., Any]) -> bool:
    return (function.__module__ or "").partition(".")[0] == "robofleet"


def _empty_copy(function: types.FunctionType) -> types.FunctionType:
    """Return a copy whose globals and cells are not filled yet."""
    cells = tuple(types.CellType() for _ in function.__closure__ or ())
    copy = types.FunctionType(function.__code__, {}, function.__name__, closure=cells)
    known = function.__module__ in sys.modules  # numba cannot link a function that calls itself, of another module
    copy.__qualname__, copy.__module__ = function.__qualname__, function.__module__ if known else "__main__"
    copy.__defaults__, copy.__kwdefaults__ = function.__defaults__, function.__kwdefaults__
    copy.__globals__.update(__builtins__=builtins, __name__=copy.__module__)
    return copy


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """A code and those of the functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


@functools.lru_cache(maxsize=1024)
def _attributes(code: types.CodeType) -> frozenset[str]:
    """Names that could be attributes of a module."""
    return frozenset(name for part in _codes(code) for name in part.co_names)


@functools.lru_cache(maxsize=1024)
def _globals_read(code: types.CodeType) -> frozenset[str]:
    loads = (instruction for part in _codes(code) for instruction in dis.get_instructions(part))
    return frozenset(instruction.argval for instruction in loads if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"))


def _like(value: Any, items: list[Any]) -> Any:
    return type(value)(*items) if hasattr(value, "_fields") else type(value)(items)


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _library_name(value: Any) -> str | None:
    """Return what a library calls a function or class of its own; None: it is not one's."""
    if isinstance(value, np.ufunc):
        name = str(getattr(value, "__name__", None))
        return f"numpy.{name}" if getattr(np, name, None) is value else None
    if not (inspect.isroutine(value) or isinstance(value, type) or hasattr(value, "__wrapped__")):
        return None
    owner = getattr(value, "__self__", None)
    module, called = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if owner is not None and not isinstance(owner, types.ModuleType):
        return None
    root = str(module).partition(".")[0]
    return f"{module}.{called}" if root in _LIBRARIES and called is not None else None

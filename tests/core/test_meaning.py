"""A compiled model means what its functions mean now: whatever they read, however deep."""

import math
import types
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from robofleet.core.errors import UnknownMeaningError
from robofleet.core.kernels import model


class Gains(NamedTuple):
    first: float
    second: float


class Kind(IntEnum):
    SMALL = 1
    LARGE = 2


class World:
    """A module of a user's own, whose values change."""

    def __init__(self, source: str, **values: Any) -> None:
        self.module = types.ModuleType("somebodys_module")
        self.names = vars(self.module)
        self.names.update(np=np, math=math, numba=numba, **values)
        exec(source, self.names)

    def function(self) -> Callable[[float], Any]:
        found: Callable[[float], Any] = self.names["f"]
        return found


def plain(world: World) -> str:
    """What Python itself makes of the function now: numba keeps what it compiled."""
    compiled = {name: value for name, value in world.names.items() if hasattr(value, "py_func")}
    world.names.update({name: value.py_func for name, value in compiled.items()})
    found = world.function()(1.5)
    world.names.update(compiled)
    return repr(found.item() if isinstance(found, np.generic) else found)


def made(source: str, name: str = "f", **values: Any) -> Any:
    return World(source, **values).names[name]


def closed_over(value: Any) -> Callable[[float], float]:
    def f(x: float) -> float:
        return x * value

    return f


def setting(**values: Any) -> Callable[[World], None]:
    return lambda world: world.names.update(values)


def running(source: str) -> Callable[[World], None]:
    return lambda world: exec(source, world.names)


def module(source: str) -> Any:
    return World(source).module


SWAPPED = NamedTuple("Gains", [("second", float), ("first", float)])(2.0, 3.0)
DEEP = "def e(x): return K\ndef h(x): return e(x)\ndef g(x): return h(x)\ndef f(x): return g(x)"
OTHERS = "def g(x): return car.drag\ndef f(x): return x * car.mass + g(x)"
PULL = "mass = 2.0\ndef pull(x): return x * mass"
CALLS = "@numba.njit\ndef g(x): return %s\ndef f(x): return g(x)"
CHANGES: dict[str, tuple[str, dict[str, Any], Callable[[World], Any]]] = {  # a source, what it reads, a change
    "a number": ("def f(x): return x * K", {"K": 2.0}, setting(K=3.0)),
    "its type": ("def f(x): return 7 // K", {"K": 2}, setting(K=2.0)),
    "the sign of zero": ("def f(x): return math.copysign(x, K)", {"K": 0.0}, setting(K=-0.0)),
    "an array, in place": (
        "def f(x): return x * A[1]", {"A": np.array([1.0, 2.0])}, lambda world: world.names["A"].__setitem__(1, 5.0)
    ),
    "a tuple in a tuple": ("def f(x): return x * K[1][0]", {"K": (1.0, (2.0,))}, setting(K=(1.0, (4.0,)))),
    "fields that change places": ("def f(x): return x * K.first", {"K": Gains(2.0, 3.0)}, setting(K=SWAPPED)),
    "a member of an enumeration": ("def f(x): return x + K.value", {"K": Kind.SMALL}, setting(K=Kind.LARGE)),
    "a compiled function": (CALLS % "x + 1.0", {}, running("@numba.njit\ndef g(x): return x - 1.0")),
    "a number that a compiled function reads": (CALLS % "x * K", {"K": 2.0}, setting(K=3.0)),
    "a number that a plain function reads, three calls deep": (DEEP, {"K": 2.0}, setting(K=3.0)),
    "an attribute of a module": (
        "def f(x): return x * car.mass", {"car": module("mass = 2.0")}, running("car.mass = 3.0")
    ),
    "a number that a function of a module reads": (
        "def f(x): return car.pull(x)", {"car": module(PULL)}, running("car.mass = 3.0")
    ),
    "another function's attribute of the same module": (
        OTHERS, {"car": module("mass, drag = 2.0, 1.0")}, running("car.drag = 3.0")
    ),
    "a default value": ("def f(x, k=2.0): return x * k", {}, running("f.__defaults__ = (3.0,)")),
    "which function of a library": ("def f(x): return wave(x)", {"wave": math.sin}, setting(wave=math.cos)),
    "the body alone": ("def f(x): return x + 1.0", {}, running("def f(x): return x + 2.0")),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_a_model_made_after_a_change_is_another(change: str) -> None:
    source, values, alter = CHANGES[change]
    world = World(source, **values)
    before = plain(world)
    first = model(world.function())
    assert repr(first(1.5)) == before
    alter(world)
    after = plain(world)
    assert after != before  # the change is one
    second = model(world.function())
    assert repr(second(1.5)) == after
    assert repr(first(1.5)) == before


def test_a_model_keeps_what_it_was_made_of_until_it_is_compiled() -> None:
    world = World("def f(x): return x * A[0] * K", A=np.array([2.0]), K=3.0)
    first = model(world.function())
    world.names["A"][0], world.names["K"] = 5.0, 7.0
    assert first(1.0) == 6.0


def test_the_same_meaning_is_the_same_model() -> None:
    assert model(closed_over(2.0)) is model(closed_over(2.0))
    assert model(closed_over(2.0)) is not model(closed_over(3.0))
    moved = "\n\n# a line of a file is not a meaning\n"
    source = "def f(x):\n    return x + 1.0"
    assert model(made(source)) is model(made(moved + source))


def test_a_function_that_calls_itself() -> None:
    source = "def f(n):\n    if n <= 0:\n        return 0\n    return K + f(n - 1)"
    assert [model(made(source, K=k))(4) for k in (1, 10)] == [4, 40]


@pytest.mark.parametrize(
    ("value", "kind"),
    [({"mass": 1.0}, "dict"), (object(), "object"), (np.array([None]), "ndarray"), (iter([1]), "list_iterator")],
)
def test_what_cannot_be_told_from_a_changed_one_is_refused_by_name(value: object, kind: str) -> None:
    source = "def g(x): return x * BOX\ndef f(x): return g(x)"
    with pytest.raises(UnknownMeaningError, match=rf"f \(<string>:2\), which calls g .* reads BOX, of type {kind}"):
        model(made(source, BOX=value))
    with pytest.raises(UnknownMeaningError, match=f"reads value, of type {kind}"):
        model(closed_over(value))

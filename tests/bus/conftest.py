"""Every layout with messages to fill it, and a memory bus with its clock."""

from collections.abc import Callable
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import strategies as st

from robofleet.bus import messages
from robofleet.bus.bus import MemoryBus
from robofleet.bus.layouts import Layout, ListLayout
from robofleet.core.clock import SimulatedClock

LAYOUTS: dict[str, Layout[Any] | ListLayout[Any]] = {
    layout.describe()[0]: layout
    for layout in vars(messages).values()
    if isinstance(layout, ListLayout) or (isinstance(layout, Layout) and not layout.blob)
}
LISTS = {name: layout for name, layout in LAYOUTS.items() if isinstance(layout, ListLayout)}

FURTHEST_NS = 2**62 - 1  # of an instant in a head


def _value(kind: np.dtype[Any], head: bool) -> st.SearchStrategy[Any]:
    if kind.kind == "f":
        return st.floats(-1e300, 1e300)
    if head and kind == np.int64:
        return st.integers(-FURTHEST_NS, FURTHEST_NS)
    limits = np.iinfo(kind)
    return st.integers(int(limits.min), int(limits.max))


def _row(dtype: np.dtype[Any], skip: tuple[str, ...] = ()) -> st.SearchStrategy[tuple[Any, ...]]:
    """Draw a row of a layout; a head is what has fields to ``skip``."""
    return st.tuples(*(_value(dtype[name], bool(skip)) for name in dtype.names or () if name not in skip))


@st.composite
def any_message(draw: st.DrawFn, name: str) -> Any:
    layout, make = LAYOUTS[name], getattr(messages, name)
    if isinstance(layout, Layout):
        return make(*draw(_row(layout.dtype, ("version",))))
    item = next(get_args(hint)[0] for hint in get_type_hints(make).values() if get_origin(hint) is tuple)
    head = draw(_row(layout.head_dtype, ("version", "count")))
    rows = tuple(item(*row) for row in draw(st.lists(_row(layout.item_dtype), max_size=5)))
    numbers: list[tuple[float, ...]] = [()] if "rest" in layout.describe()[1] else []
    return make(*head, rows, *numbers)


@pytest.fixture(scope="session", params=list(LAYOUTS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="session")
def layout(kind: str) -> Layout[Any] | ListLayout[Any]:
    return LAYOUTS[kind]


@pytest.fixture(scope="session")
def any_of(kind: str) -> st.SearchStrategy[Any]:
    """Return the strategy for messages of this kind."""
    return any_message(kind)


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def memory_bus(clock: SimulatedClock) -> Callable[[int], MemoryBus]:
    return lambda delay_ns: MemoryBus("lab", clock, delay_ns)

"""Every layout with messages to fill it, and a memory bus with its clock."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from robofleet.bus import messages
from robofleet.bus.bus import MemoryBus
from robofleet.bus.layouts import Layout, ListLayout
from robofleet.core.clock import SimulatedClock

LAYOUTS: dict[str, tuple[Any, type[Any]]] = {
    "UnitCommand": (messages.UNIT_COMMAND, messages.UnitCommand),
    "UnitStatus": (messages.UNIT_STATUS, messages.UnitStatus),
    "UnitEnable": (messages.UNIT_ENABLE, messages.UnitEnable),
    "RunState": (messages.RUN_STATE, messages.RunState),
    "BusyMachine": (messages.BUSY_MACHINE, messages.BusyMachine),
    "UnitTruth": (messages.UNIT_TRUTH, messages.UnitTruth),
    "UnitSensors": (messages.UNIT_SENSORS, messages.UnitSensors),
    "FleetPoses": (messages.FLEET_POSES, messages.FleetPoses),
    "TickRecord": (messages.TICK_RECORD, messages.TickRecord),
    "TrackerNews": (messages.TRACKER_NEWS, messages.TrackerNews),
    "RecorderStatus": (messages.RECORDER_STATUS, messages.RecorderStatus),
    "LeaseRequest": (messages.LEASE_REQUEST, messages.LeaseRequest),
    "UnitLeases": (messages.UNIT_LEASES, messages.UnitLeases),
}
ITEMS: dict[str, type[Any]] = {
    "UnitCommand": messages.WheelCommand,
    "UnitStatus": messages.RobotStatus,
    "UnitEnable": messages.Enable,
    "UnitTruth": messages.Truth,
    "UnitSensors": messages.RobotSensors,
    "UnitLeases": messages.LeaseAnswer,
    "FleetPoses": messages.TagPose,
    "TickRecord": messages.RobotTick,
    "RunState": messages.RobotState,
    "BusyMachine": messages.Late,
}


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
    layout, make = LAYOUTS[name]
    if isinstance(layout, Layout):
        return make(*draw(_row(layout.dtype, ("version",))))
    head = draw(_row(layout.head_dtype, ("version", "count")))
    items = draw(st.lists(_row(layout.item_dtype), max_size=5))
    numbers: tuple[float, ...] | None = () if name in ("TickRecord", "UnitSensors") else None
    rows = tuple(ITEMS[name](*item) for item in items)
    return make(*head, rows) if numbers is None else make(*head, rows, numbers)


@pytest.fixture(scope="session", params=list(LAYOUTS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="session")
def layout(kind: str) -> Layout[Any] | ListLayout[Any]:
    return LAYOUTS[kind][0]  # type: ignore[no-any-return]


@pytest.fixture(scope="session")
def any_of(kind: str) -> st.SearchStrategy[Any]:
    """Return the strategy for messages of this kind."""
    return any_message(kind)


@pytest.fixture(scope="session", params=list(ITEMS))
def listed(request: pytest.FixtureRequest) -> tuple[ListLayout[Any], st.SearchStrategy[Any]]:
    """Return a layout with a list at its end, and the strategy for its messages."""
    return LAYOUTS[request.param][0], any_message(request.param)


@pytest.fixture
def clock() -> SimulatedClock:
    return SimulatedClock()


@pytest.fixture
def memory_bus(clock: SimulatedClock) -> Callable[[int], MemoryBus]:
    return lambda delay_ns: MemoryBus("lab", clock, delay_ns)

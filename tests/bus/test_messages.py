"""Layouts: what is encoded is decoded; what is damaged is refused and never raises."""

import math
import struct
import sys
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.bus.layouts import VERSION, Layout, ListLayout
from robofleet.bus.messages import (
    FLEET_POSES,
    PICTURE,
    TICK_RECORD,
    UNIT_COMMAND,
    FleetPoses,
    Picture,
    RobotTick,
    RunState,
    TagPose,
    TickRecord,
    UnitCommand,
    WheelCommand,
)
from tests.bus.conftest import FURTHEST_NS, LAYOUTS, LISTS, any_message

EXACT = settings(deadline=None, derandomize=True, max_examples=20)
AnyLayout = Layout[Any] | ListLayout[Any]
Messages = st.SearchStrategy[Any]


@EXACT
@given(st.data())
def test_round_trip(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    message = data.draw(any_of)
    payload = layout.encode(message)
    decoded = layout.decode(payload)
    assert decoded == message
    assert type(decoded) is type(message)
    if isinstance(layout, Layout):
        assert np.frombuffer(payload, layout.dtype)[0].item() == (VERSION, *message)


@pytest.mark.slow_after_first
@EXACT
@given(st.data())
def test_not_a_number_in_any_float_is_refused(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    """Whoever sends it: our own encoding cannot say it, so it is written over the payload's last bytes."""
    message = data.draw(any_of)
    payload, floats = layout.encode(message), places(layout, message)
    wrong = [{at: bad} for at in floats for bad in (math.nan, math.inf, -math.inf)]
    wrong += [{at: math.inf, other: -math.inf} for at, other in pairwise(floats)]  # infinities do not cancel out
    for numbers in wrong:
        damaged = bytearray(payload)
        for at, number in numbers.items():
            struct.pack_into("<d", damaged, at, number)
        assert layout.decode(bytes(damaged)) is None
        if isinstance(layout, ListLayout):
            assert layout.view(bytes(damaged)) is layout.arrays(bytes(damaged)) is None


def places(layout: AnyLayout, message: Any) -> list[int]:
    """Return where each float of a message stands in its payload [bytes]."""

    def of(dtype: np.dtype[Any], start: int) -> list[int]:
        fields = dtype.fields or {}
        return [start + fields[name][1] for name in dtype.names or () if fields[name][0].kind == "f"]

    if isinstance(layout, Layout):
        return of(layout.dtype, 0)
    head, item = layout.head_dtype, layout.item_dtype
    items = next(value for value in message if isinstance(value, tuple))
    return of(head, 0) + [at for k in range(len(items)) for at in of(item, head.itemsize + k * item.itemsize)]


WILD = st.one_of(
    st.floats(),  # also those that are not finite, and those whose sum is not
    st.sampled_from([math.nan, math.inf, -math.inf, sys.float_info.max, -sys.float_info.max]),
)
HUGE = st.one_of(st.integers(), *(st.integers(2**k - 2, 2**k + 2) for k in (8, 16, 31, 32, 63, 64)))


def wild(draw: Callable[[Messages], Any], message: Any) -> Any:
    """Return the message with every number replaced by any number of its kind."""

    def other(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(type(item)._make(map(other, item)) for item in value)
        return draw(WILD if isinstance(value, float) else HUGE)

    return message._make(map(other, message))


def flat(message: Any) -> list[float]:
    return [
        n for value in message for n in ([x for row in value for x in row] if isinstance(value, tuple) else [value])
    ]


@pytest.mark.slow_after_first
@settings(EXACT, max_examples=40)
@given(st.data())
def test_whatever_is_encoded_is_decoded(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    """What a field cannot hold becomes the nearest that it can; what is not a number, the least."""
    message = wild(data.draw, data.draw(any_of))
    payload = layout.encode(message)
    decoded = layout.decode(payload)
    assert decoded is not None
    for wanted, got in zip(flat(message), flat(decoded), strict=True):
        if isinstance(wanted, int):
            assert got == wanted or (abs(got) < abs(wanted) and (got == 0 or wanted > 0 or got < 0))
        elif math.isnan(wanted):
            assert got == -1e300
        else:
            assert got == wanted or (math.copysign(1e300, wanted) == got and abs(wanted) > 1e300)
    assert layout.encode(decoded) == payload


@pytest.mark.slow_after_first
@EXACT
@given(st.data())
def test_an_instant_that_no_clock_shows_is_refused(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    """The differences of all that are taken have 64 bits, as arrays of instants need it."""
    payload, head = layout.encode(data.draw(any_of)), layout.describe()[1]["fields"]
    columns = np.dtype(head)
    instants = [columns.fields[name][1] for name, kind in head if kind == "<i8"]  # type: ignore[index]
    for at in instants:
        for ns in (-(2**63), -FURTHEST_NS - 1, FURTHEST_NS + 1, 2**63 - 1):
            wrong = bytearray(payload)
            struct.pack_into("<q", wrong, at, ns)
            assert layout.decode(bytes(wrong)) is None
            if isinstance(layout, ListLayout):
                assert layout.view(bytes(wrong)) is layout.arrays(bytes(wrong)) is None
                assert layout.decode_head(bytes(wrong)) is None


def test_a_list_that_is_too_long_is_cut() -> None:
    poses = (TagPose(1, 0, 0, 0.5, 0.5, 0.5),) * 65_540
    decoded = FLEET_POSES.decode(FLEET_POSES.encode(FleetPoses(1, 2, 3, 4, 5, 6, 7, 8, 9, poses)))
    assert decoded is not None
    assert len(decoded.poses) == 65_535


@EXACT
@given(WILD, st.sampled_from([1, 2, 3, 40]))
def test_parts_that_are_packed_already_are_decoded_too(bad: float, rows: int) -> None:
    items = np.full((rows, len(RobotTick._fields)), 0.5)
    items[-1, 3] = bad
    head = (2**32, 1, 2**64, -(2**63) - 1, *range(12))
    payload = TICK_RECORD.encode_parts(head, rows, items.tobytes())
    assert TICK_RECORD.encode_array(head, items) == payload
    decoded = TICK_RECORD.decode(payload)
    assert decoded is not None
    assert (decoded.epoch, decoded.tick, decoded.run_tick) == (2**32 - 1, 2**64 - 1, -FURTHEST_NS)
    assert decoded.robots[0].x_m == 0.5


@EXACT
@given(HUGE, st.binary(max_size=9))
def test_a_picture_is_encoded_too(number: int, jpeg: bytes) -> None:
    decoded = PICTURE.decode(PICTURE.encode(Picture(number, number, number, number, number, jpeg)))
    assert decoded is not None
    assert decoded.jpeg == jpeg


def test_what_counts_has_64_bits_and_goes_on_where_32_end() -> None:
    counting = {"seq", "tick", "poses_seq", "state_seq", "command_seq", "latch_id", "clear", "rejected", "refused",
                "overruns", "messages", "dropped", "echo_tick", "nonce"}  # fmt: skip
    leases = {"UnitStatus", "UnitCommand", "UnitEnable", "UnitLeases"}
    for name, layout in LAYOUTS.items():
        _, described = layout.describe()
        for field, kind in [*described["fields"], *described.get("items", ())]:
            if field in counting or (field == "epoch" and name in leases):
                assert kind in ("<u8", "<i8"), f"{name}.{field}"


@pytest.mark.slow_after_first
@EXACT
@given(st.data())
def test_a_wrong_length_or_version_is_refused(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    payload = layout.encode(data.draw(any_of))
    assert payload[0] == VERSION
    for length in range(len(payload)):
        assert layout.decode(payload[:length]) is None
    assert layout.decode(payload + b"\0") is None
    assert layout.decode(payload + payload) is None
    for version in (0, VERSION + 1, 255):
        assert layout.decode(bytes([version]) + payload[1:]) is None


@pytest.mark.slow_after_first
@settings(EXACT, max_examples=80)
@given(st.binary(max_size=400), st.booleans())
def test_random_bytes_never_raise(layout: AnyLayout, noise: bytes, versioned: bool) -> None:
    payload = bytes([VERSION]) + noise if versioned else noise
    message = layout.decode(payload)
    assert message is None or layout.encode(message) == payload
    if isinstance(layout, ListLayout):
        layout.decode_head(payload)
        layout.arrays(payload)


@pytest.mark.slow_after_first
@settings(EXACT, max_examples=40)
@given(st.data())
def test_damaged_bytes_never_raise_and_a_view_is_what_is_decoded(
    layout: AnyLayout, any_of: Messages, data: st.DataObject
) -> None:
    payload = bytearray(layout.encode(data.draw(any_of)))
    for _ in range(data.draw(st.integers(0, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(payload)[: data.draw(st.integers(len(payload) - 1, len(payload)))]
    decoded = layout.decode(cut)
    assert decoded is None or layout.encode(decoded) == cut
    if isinstance(layout, ListLayout):
        viewed = layout.view(cut)
        assert (decoded is None) == (viewed is None)
        assert viewed is None or viewed[1].tolist() == [tuple(item) for item in decoded[layout_head(layout)]]


def layout_head(layout: ListLayout[Any]) -> int:
    """Return how many fields stand before a message's items."""
    return len(layout.head_dtype.names or ()) - 2  # without version and count


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", LISTS)
@EXACT
@given(data=st.data())
def test_heads_and_items_alone_say_what_the_message_says(name: str, data: st.DataObject) -> None:
    """Also of an empty list, and of a message that is damaged."""
    layout, message = LISTS[name], data.draw(any_message(name))
    payload, count = layout.encode(message), layout_head(LISTS[name])
    head, items = message[:count], [tuple(item) for item in message[count]]
    arrays, viewed, alone = layout.arrays(payload), layout.view(payload), layout.decode_head(payload)
    assert arrays is not None and viewed is not None and alone is not None
    assert arrays[0][0].item()[1:-1] == viewed[0][:count] == alone[:count] == head
    assert all(rest == () for rest in (*alone[count:], *viewed[0][count:]))
    assert arrays[1].tolist() == viewed[1].tolist() == items
    assert not viewed[1].flags.writeable
    for field in layout.head_dtype.names or ():
        assert field in ("version", "count") or layout.head_of(payload, field) == getattr(message, field)
    for field in layout.item_dtype.names or ():
        column = layout.column(payload, field)
        assert column is not None and column.tobytes() == arrays[1][field].tobytes()
    assert layout.floats(arrays[1]).tolist() == [[x for x in item if isinstance(x, float)] for item in items]
    packed = np.array(items, dtype=layout.item_dtype)
    assert layout.encode_parts(head, len(items), packed.tobytes()) == layout.encode_view(message, packed) == payload
    for wrong in (payload[:-1], b"\0" + payload[1:]):
        assert layout.arrays(wrong) is layout.view(wrong) is layout.decode_head(wrong) is None


@EXACT
@given(any_message("TickRecord"), st.lists(st.floats(), max_size=6))
def test_figures_are_kept_whatever_they_are(tick: TickRecord, figures: list[float]) -> None:
    """NaN is a figure that a robot has not."""
    payload = TICK_RECORD.encode(tick._replace(figures=tuple(figures)))
    decoded = TICK_RECORD.decode(payload)
    assert decoded is not None
    (row,) = np.frombuffer(payload, TICK_RECORD.dtype(len(tick.robots), len(figures)))
    for kept in (decoded.figures, row["figures"]):
        np.testing.assert_array_equal(np.asarray(kept), np.asarray(figures, dtype=float))
    assert decoded.robots == tick.robots
    assert TICK_RECORD.decode(payload[:-1]) is None


@EXACT
@given(st.lists(st.tuples(st.integers(0, 2**64 - 1), WILD, WILD), max_size=4), HUGE)
def test_whatever_is_encoded_from_an_array_is_decoded(rows: list[tuple[int, float, float]], number: int) -> None:
    items = np.array(rows, UNIT_COMMAND.item_dtype)
    message = UnitCommand(number, number, number, number, number, ())
    whole = message._replace(robots=tuple(WheelCommand(*row) for row in rows))
    assert UNIT_COMMAND.encode_view(message, items) == UNIT_COMMAND.encode(whole)
    assert UNIT_COMMAND.decode(UNIT_COMMAND.encode_view(message, items)) is not None


@pytest.mark.parametrize("field", RunState._fields)
def test_a_run_state_repeats_one_that_differs_in_its_number_alone(field: str) -> None:
    state = RunState(epoch=1, seq=1, phase=1, cause=0, robot=0, detail=0.0, stage=0, robots=())
    assert state._replace(**{field: 7}).repeats(state) == (field in ("epoch", "seq"))  # type: ignore[arg-type]

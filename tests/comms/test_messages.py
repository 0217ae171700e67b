"""Layouts: what is encoded is decoded; what is damaged is refused and never raises."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.comms.layouts import VERSION, Layout, ListLayout

EXACT = settings(deadline=None, derandomize=True, max_examples=40)
AnyLayout = Layout[Any] | ListLayout[Any]
Messages = st.SearchStrategy[Any]


def floats_of(message: Any) -> list[tuple[int | None, str]]:
    """Return (item, field) of every float in a message; item None: the head's."""
    head = [(None, name) for name, value in message._asdict().items() if isinstance(value, float)]
    items = message[-1] if isinstance(message[-1], tuple) else ()
    inside = [(k, n) for k, row in enumerate(items) for n, v in row._asdict().items() if isinstance(v, float)]
    return head + inside


def with_float(message: Any, where: tuple[int | None, str], value: float) -> Any:
    item, name = where
    if item is None:
        return message._replace(**{name: value})
    rows = list(message[-1])
    rows[item] = rows[item]._replace(**{name: value})
    return message._replace(**{message._fields[-1]: tuple(rows)})


@EXACT
@given(st.data())
def test_round_trip(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    message = data.draw(any_of)
    decoded = layout.decode(layout.encode(message))
    assert decoded == message
    assert type(decoded) is type(message)


@EXACT
@given(st.data())
def test_not_a_number_in_any_float_is_refused(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    message = data.draw(any_of)
    places = floats_of(message)
    for where in places:
        for bad in (math.nan, math.inf, -math.inf):
            assert layout.decode(layout.encode(with_float(message, where, bad))) is None
    for where, other in pairwise(places):  # infinities do not cancel out
        damaged = with_float(with_float(message, where, math.inf), other, -math.inf)
        assert layout.decode(layout.encode(damaged)) is None


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


@settings(EXACT, max_examples=200)
@given(st.binary(max_size=400), st.booleans())
def test_random_bytes_never_raise(layout: AnyLayout, noise: bytes, versioned: bool) -> None:
    payload = bytes([VERSION]) + noise if versioned else noise
    message = layout.decode(payload)
    assert message is None or layout.encode(message) == payload
    if isinstance(layout, ListLayout):
        layout.decode_head(payload)


@settings(EXACT, max_examples=100)
@given(st.data())
def test_flipped_bytes_never_raise(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    payload = bytearray(layout.encode(data.draw(any_of)))
    for _ in range(3):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    message = layout.decode(bytes(payload))
    assert message is None or layout.encode(message) == bytes(payload)


@EXACT
@given(st.data())
def test_numpy_reads_the_same_values(layout: AnyLayout, any_of: Messages, data: st.DataObject) -> None:
    message = data.draw(any_of)
    payload = layout.encode(message)
    if isinstance(layout, Layout):
        (row,) = np.frombuffer(payload, layout.dtype)
        assert row.tolist() == (VERSION, *message)
        return
    *head, items = message
    (row,) = np.frombuffer(payload, layout.dtype(len(items)))
    assert [row[name] for name in layout.head_dtype.names or ()] == [VERSION, *head, len(items)]
    assert [tuple(item) for item in row["items"].tolist()] == [tuple(item) for item in items]


@EXACT
@given(st.data())
def test_a_heads_fields_alone(listed: tuple[ListLayout[Any], Messages], data: st.DataObject) -> None:
    layout, any_of = listed
    message = data.draw(any_of)
    *head, items = message
    payload = layout.encode(message)
    assert layout.decode_head(payload) == tuple(head)
    assert layout.decode_head(payload[:-1]) is None
    assert layout.decode_head(b"\0" + payload[1:]) is None
    packed = np.array([tuple(item) for item in items], dtype=layout.item_dtype).tobytes()
    assert layout.encode_parts(tuple(head), len(items), packed) == payload

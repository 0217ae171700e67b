"""Fixed little-endian layouts, version byte first, and what decoding refuses.

numpy is imported where many messages are read at once, and not before: `robofleet stop` is in a hurry.

``decode`` checks length, version, finiteness and the head's instants, and returns None for a message that fails; the
caller counts it and does nothing else with it. An instant is at most 146 years away from its clock's zero: so the
difference of any two has 64 bits, also in arrays, which do not tell when they overflow.

``encode`` never raises, and what it returns can be decoded: a number that its field cannot hold becomes the nearest one
that it can, and what is not a number becomes the least. So a wrong speed or pose is far outside every limit, a wrong
permission permits nothing, and a counter that is used up repeats its last value, which nobody takes for a newer one.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from operator import itemgetter
from struct import Struct, error
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

VERSION = 6
_NUMPY = {"B": "u1", "H": "<u2", "I": "<u4", "i": "<i4", "Q": "<u8", "q": "<i8", "d": "<f8"}
_BITS = {"B": 8, "H": 16, "I": 32, "Q": 64}
_RANGES: dict[str, tuple[int, int]] = {letter: (0, 2**bits - 1) for letter, bits in _BITS.items()}
_RANGES |= {letter: (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for letter, bits in (("i", 32), ("q", 64))}
_FURTHEST_INSTANT_NS = 2**62 - 1
_RANGES["q"] = -_FURTHEST_INSTANT_NS, _FURTHEST_INSTANT_NS
_LARGEST_FLOAT = 1e300  # a list of them has a finite sum, by which decoding judges
_FEW_FLOATS = 128  # so many Python adds up before numpy has begun
_MOST_ITEMS = _RANGES["H"][1]
_TOO_LARGE = (error, OverflowError)  # what packing raises

M = TypeVar("M", bound=NamedTuple)


class Encoded(bytes):
    """A message with a list that this process encoded: decoding it here does not judge its numbers again.

    What comes from another process, or was changed, is plain ``bytes``.
    """

    __slots__ = ()


Description = tuple[str, dict[str, Any]]  # of a layout, in words that numpy reads


def _columns(make: type[Any], fields: str) -> list[tuple[str, str]]:
    """Pair a named tuple's fields with the types of a layout's letters."""
    return [(name, _NUMPY[letter]) for name, letter in zip(make._fields, fields, strict=False)]


def _nearest(letter: str, value: float) -> float:
    """Return the nearest number that a field can hold; for what is not a number, the least."""
    if letter == "d":
        return min(max(-_LARGEST_FLOAT, value), _LARGEST_FLOAT)  # in this order: no comparison with NaN is true
    low, high = _RANGES[letter]
    return int(min(max(low, value), high))


def _judge_instants(letters: str) -> Callable[[Sequence[Any]], bool]:
    """Return what judges whether no field that is an instant [ns] is so far away that a difference of two overflows."""
    fields = [k for k, letter in enumerate(letters) if letter == "q"]
    if not fields:
        return lambda values: True
    if len(fields) == 1:
        (only,) = fields
        return lambda values: -_FURTHEST_INSTANT_NS <= values[only] <= _FURTHEST_INSTANT_NS
    instants_of = itemgetter(*fields)
    return lambda values: max(map(abs, instants_of(values))) <= _FURTHEST_INSTANT_NS


def _fitted(letters: str, values: Iterable[float]) -> tuple[float, ...]:
    return tuple(map(_nearest, letters, values))


class Layout(Generic[M]):
    """A fixed layout: version byte, then the fields of a named tuple. ``blob``: its last field are all bytes behind."""

    def __init__(self, make: type[M], fields: str, *, blob: bool = False) -> None:
        self._make, self._letters, self.blob = make, fields, blob
        self._struct, self._near = Struct(f"<B{fields}"), _judge_instants(fields)
        self._columns = [("version", "u1"), *_columns(make, fields)]
        self.size = self._struct.size  # without a blob

    @cached_property
    def dtype(self) -> "np.dtype[Any]":
        """The layout of a message, for reading many at once."""
        import numpy as np  # noqa: PLC0415

        return np.dtype(self._columns)

    def describe(self) -> Description:
        rest = {"rest": self._make._fields[-1]} if self.blob else {}
        return self._make.__name__, {"fields": self._columns, **rest}

    def encode(self, message: M) -> bytes:
        values, rest = (message[:-1], bytes(message[-1])) if self.blob else (tuple(message), b"")
        try:
            packed = self._struct.pack(VERSION, *values)
            fits = self._sound(values)
        except _TOO_LARGE:
            fits = False
        return (packed if fits else self._struct.pack(VERSION, *_fitted(self._letters, values))) + rest

    def _sound(self, values: Sequence[float]) -> bool:
        return math.isfinite(sum(values)) and self._near(values)

    def decode(self, payload: bytes) -> M | None:
        """Return the message, or None where length, version, finiteness or an instant is wrong."""
        too_long = len(payload) > self.size and not self.blob
        if len(payload) < self.size or too_long or payload[0] != VERSION:
            return None
        _, *values = self._struct.unpack_from(payload)
        if not self._sound(values):
            return None
        return self._make._make([*values, payload[self.size :]] if self.blob else values)


class ListLayout(Generic[M]):
    """A layout with a list: version byte, the head's fields, the items' count, then equal items.

    With ``numbers`` every double after the items is one of the message's last field, NaN allowed: whoever reads them
    knows what they mean.
    """

    def __init__(
        self, make: type[M], head: str, make_item: type[NamedTuple], item: str, *, numbers: bool = False
    ) -> None:
        self._make, self._make_item, self._numbers = make, make_item, numbers
        self._head, self._body, self._item = Struct(f"<B{head}H"), Struct(f"<x{head}H"), Struct(f"<{item}")
        self._head_letters, self._item_letters, self._count = head, item, Struct("<H")
        self._near, self._head_has_floats = _judge_instants(head), "d" in head
        self._columns = [("version", "u1"), *_columns(make, head), ("count", "<u2")]
        self._item_columns = _columns(make_item, item)
        plain = item.rstrip("d")
        assert "d" not in plain, "an item's floats are its last fields"
        self.item_floats, self._floats_at = len(item) - len(plain), self._item.size - 8 * (len(item) - len(plain))
        self._strides = self._item.size, 8
        self._few_floats: dict[int, Struct] = {}  # of so many items, without their other fields
        self._none: tuple[tuple[()], ...] = ((),) * (1 + numbers)  # the lists of a message that is only a head

    @cached_property
    def head_dtype(self) -> "np.dtype[Any]":
        """The layout of a head."""
        import numpy as np  # noqa: PLC0415

        return np.dtype(self._columns)

    @cached_property
    def item_dtype(self) -> "np.dtype[Any]":
        """The layout of an item."""
        import numpy as np  # noqa: PLC0415

        return np.dtype(self._item_columns)

    def dtype(self, count: int, numbers: int = 0) -> "np.dtype[Any]":
        """Return the layout of a message of ``count`` items, for reading many at once."""
        import numpy as np  # noqa: PLC0415

        rest = [(self._make._fields[-1], "<f8", (numbers,))] if self._numbers else []
        return np.dtype([*self._columns, ("items", self.item_dtype, (count,)), *rest])

    def describe(self) -> Description:
        rest = {"rest": self._make._fields[-1]} if self._numbers else {}
        return self._make.__name__, {"fields": self._columns, "items": self._item_columns, **rest}

    def _fits(self, length: int, count: int) -> bool:
        """Return whether a message of this length can have so many items."""
        rest = length - self._head.size - count * self._item.size
        return rest == 0 or (self._numbers and rest > 0 and rest % 8 == 0)

    def _opened(self, payload: bytes) -> tuple[tuple[Any, ...], int] | None:
        """Return the head and the number of items; None where length, version or an instant is wrong."""
        if len(payload) < self._head.size or payload[0] != VERSION:
            return None
        fields = self._body.unpack_from(payload)
        head, count = fields[:-1], fields[-1]
        if not self._fits(len(payload), count):
            return None
        return (head, count) if type(payload) is Encoded or self._near(head) else None

    def decode_head(self, payload: bytes) -> M | None:
        """Return the message without its items, or None where length, version or an instant is wrong."""
        opened = self._opened(payload)
        return None if opened is None else tuple.__new__(self._make, opened[0] + self._none)

    def arrays(self, payload: bytes) -> "tuple[NDArray[Any], NDArray[Any]] | None":
        """Return the head (1,) and the items (N,) as structured arrays that share the payload's memory.

        None where ``decode`` returns None. The numbers of a message with ``numbers`` are left out.
        """
        read, size = self._reader, self._head.size
        if (opened := self._opened(payload)) is None:
            return None
        head, count = opened
        if not self._finite(payload, head, count):
            return None
        return read.array(1, self.head_dtype, payload), read.array(count, self.item_dtype, payload, size)

    def head_of(self, payload: bytes, field: str) -> Any:
        """Return one field of a message's head; None where length or version is wrong."""
        if len(payload) < self._head.size or payload[0] != VERSION:
            return None
        return self._fields[field].unpack_from(payload)[0]

    def column(self, payload: bytes, field: str) -> "NDArray[Any] | None":
        """Return one field of all items (N,), in the payload's memory; None where length or version is wrong."""
        size = self._head.size
        if len(payload) < size or payload[0] != VERSION:
            return None
        (count,) = self._count.unpack_from(payload, size - 2)
        if not self._fits(len(payload), count):
            return None
        dtype, at = self._item_fields[field][:2]
        if not count:  # its place would be behind the payload
            return self._reader.array(0, dtype)
        column: NDArray[Any] = self._reader.array(count, dtype, payload, size + at, self._strides[:1])
        return column

    @cached_property
    def _item_fields(self) -> dict[str, Any]:
        return dict(self.item_dtype.fields or {})

    @cached_property
    def _fields(self) -> dict[str, Struct]:
        at: dict[str, Any] = dict(self.head_dtype.fields or {})
        letters = zip(self._columns[1:], f"{self._head_letters}H", strict=True)
        return {name: Struct(f"<{at[name][1]}x{letter}") for (name, _), letter in letters}

    @cached_property
    def _reader(self) -> "_Reader":
        return _Reader()

    def _tail(self, count: int, memory: Any, at: int) -> "NDArray[Any]":
        """Return the floats of items (count, floats) that begin in some memory."""
        return self._reader.array((count, self.item_floats), self._reader.double, memory, at, self._strides)

    def floats(self, items: "NDArray[Any]") -> "NDArray[Any]":
        """Return the floats of items (N,), which are their last fields, as an array (N, floats) of the same memory."""
        floats: NDArray[Any] = items.view(self._split_dtype)["floats"]
        return floats

    @cached_property
    def _split_dtype(self) -> "np.dtype[Any]":
        """The layout of an item, its floats as one array."""
        import numpy as np  # noqa: PLC0415

        count = self.item_floats
        return np.dtype([("plain", f"V{self._item.size - 8 * count}"), ("floats", "<f8", (count,))])

    def encode_view(self, message: M, items: "NDArray[Any]") -> bytes:
        """Return the payload of a message whose items are an array (N,) of ``item_dtype``; its own are passed over."""
        return self.encode_array(message[: len(self._head_letters)], items)

    def view(self, payload: bytes) -> "tuple[M, NDArray[Any]] | None":
        """Return the message without its lists, and its items as a structured array that lies in the payload.

        None where ``decode`` returns None. Nothing is copied, and nothing can be written there.
        """
        size = self._head.size
        if (opened := self._opened(payload)) is None:
            return None
        head, count = opened
        if not self._finite(payload, head, count):
            return None
        message = tuple.__new__(self._make, head + self._none)
        return message, self._reader.array(count, self.item_dtype, payload, size)

    def encode(self, message: M) -> bytes:
        *head, items = message[:-1] if self._numbers else message
        try:
            packed = b"".join([self._item.pack(*item) for item in items])
        except _TOO_LARGE:
            packed = self._packed(items)
        numbers = Struct(f"<{len(message[-1])}d").pack(*message[-1]) if self._numbers else b""
        return self.encode_parts(tuple(head), len(items), packed, numbers)

    def encode_parts(self, head: tuple[Any, ...], count: int, items: bytes, numbers: bytes = b"") -> bytes:
        """Return the payload from items and numbers that are packed already; of too many items the first ones."""
        if count > _MOST_ITEMS:
            count, items = _MOST_ITEMS, items[: _MOST_ITEMS * self._item.size]
        try:
            packed = self._head.pack(VERSION, *head, count)
            fits = self._finite_head(head) and self._near(head)
        except _TOO_LARGE:
            fits = False
        if not fits:
            packed = self._head.pack(VERSION, *_fitted(self._head_letters, head), count)
        if not math.isfinite(sum(map(sum, self._item.iter_unpack(items)))):
            items = self._packed(self._item.iter_unpack(items))
        return Encoded(packed + items + numbers)

    def encode_array(self, head: tuple[Any, ...], items: "NDArray[Any]", numbers: bytes = b"") -> bytes:
        """As ``encode_parts``; items: contiguous, structured or not, with the bytes that the layout has."""
        count = len(items)
        try:
            packed = self._head.pack(VERSION, *head, count)
        except _TOO_LARGE:
            return self.encode_parts(head, count, items.tobytes(), numbers)
        body = items.tobytes()
        if not (self._finite_head(head) and self._near(head) and self._finite_items(body, count, 0)):
            return self.encode_parts(head, count, body, numbers)
        return Encoded(packed + body + numbers)

    def _finite_head(self, head: Sequence[float]) -> bool:
        return not self._head_has_floats or math.isfinite(sum(head))

    def _finite(self, payload: bytes, head: Sequence[float], count: int) -> bool:
        """Return whether all floats of a message are finite."""
        if type(payload) is Encoded:
            return True
        return self._finite_head(head) and self._finite_items(payload, count, self._head.size)

    def _finite_items(self, payload: bytes, count: int, start: int) -> bool:
        """Return whether all floats of the items that begin at a place in a payload are finite."""
        if not self.item_floats:
            return True
        if count * self.item_floats <= _FEW_FLOATS:
            return math.isfinite(sum(self._floats_of(count).unpack_from(payload, start)))
        if self._reader.small(self._tail(count, payload, start + self._floats_at)):
            return True
        items = payload[start : start + count * self._item.size]
        return math.isfinite(sum(map(sum, self._item.iter_unpack(items))))

    def _floats_of(self, count: int) -> Struct:
        """Return what unpacks the floats of so many items."""
        if count not in self._few_floats:
            self._few_floats[count] = Struct("<" + f"{self._floats_at}x{self.item_floats}d" * count)
        return self._few_floats[count]

    def _packed(self, items: Iterable[Iterable[float]]) -> bytes:
        return b"".join(self._item.pack(*_fitted(self._item_letters, item)) for item in items)

    def decode(self, payload: bytes) -> M | None:
        """Return the message, or None where length, version, finiteness or an instant is wrong."""
        if (opened := self._opened(payload)) is None:
            return None
        head, count = opened
        end = self._head.size + count * self._item.size
        rows = list(self._item.iter_unpack(payload[self._head.size : end]))
        if not math.isfinite(sum(head) + sum(map(sum, rows))):
            return None
        numbers = (Struct(f"<{(len(payload) - end) // 8}d").unpack(payload[end:]),) if self._numbers else ()
        return self._make._make([*head, tuple(map(self._make_item._make, rows)), *numbers])


class _Reader:
    """What reads arrays out of payloads, made when the first one is read: numpy is loaded then."""

    def __init__(self) -> None:
        import numpy as np  # noqa: PLC0415

        self.array, self._abs, self._largest, self.double = np.ndarray, np.abs, np.maximum.reduce, np.dtype("<f8")

    def small(self, floats: "NDArray[Any]") -> bool:
        """Return whether all, of one at least, are numbers whose sum is one."""
        return bool(self._largest(self._abs(floats), None) <= _LARGEST_FLOAT)  # not so of NaN

"""Records as rows of arrays: what plain Python does with one record, a compiled function does with each row."""

from collections.abc import Callable
from dataclasses import fields
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, TypeVar

import numpy as np

T = TypeVar("T")
Unsigned = Annotated[int, "<u8"]  # never beside a signed number, but 0: numba makes floats of both


def row_type(record: type) -> np.dtype[Any]:
    """Return the type of a row with the fields of a dataclass of numbers."""
    kinds: dict[Any, str] = {bool: "<i8", int: "<i8", float: "<f8", Unsigned: "<u8"}
    return np.dtype([(field.name, kinds[field.type]) for field in fields(record)])


def row_of(record: Any) -> tuple[Any, ...]:
    """Return a record's fields, as a row takes them: ``dataclasses.astuple`` copies each, which takes long."""
    return _fields_of(type(record))(record)  # type: ignore[arg-type]


@cache
def _fields_of(kind: type) -> Callable[[Any], tuple[Any, ...]]:
    """Return what gets all fields, of which there are two or more."""
    return attrgetter(*(field.name for field in fields(kind)))


def record_of(record: Callable[..., T], row: np.void) -> T:
    return record(**dict(zip(row.dtype.names or (), row.item(), strict=True)))

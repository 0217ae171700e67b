"""Rows of numbers as protobuf messages of plain scalars: a schema that is made here, and messages of equal length.

Every field has four bytes (``fixed32``, ``sfixed32``, ``float``): a table becomes messages without a loop over fields.
The schema says what each field is, as the comment above a field of a ``.proto`` file does.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorSet
from numpy.typing import NDArray

_KINDS = {
    "<u4": FieldDescriptorProto.TYPE_FIXED32,
    "<i4": FieldDescriptorProto.TYPE_SFIXED32,
    "<f4": FieldDescriptorProto.TYPE_FLOAT,
}
_FIXED32_WIRE_TYPE = 5


class Scalar(NamedTuple):
    """A field."""

    name: str
    kind: str  # numpy's name of its type
    meaning: str


class Scalars:
    """A message of fields that are numbers; they are numbered from 1 in their order."""

    def __init__(self, package: str, name: str, fields: tuple[Scalar, ...]) -> None:
        self.name = f"{package}.{name}"
        self.descriptor = _described(package, name, fields)
        self._names = [field.name for field in fields]
        self._blank = _blank([(field.name, field.kind) for field in fields])

    def messages(self, shape: tuple[int, ...], values: Mapping[str, Any]) -> list[bytes]:
        """Return the messages of arrays of a shape, one for each element, in C order."""
        rows = np.full(shape, self._blank)
        for name in self._names:
            rows[name] = values[name]
        data, size = rows.tobytes(), rows.itemsize
        return [data[at : at + size] for at in range(0, len(data), size)]


def table(descriptor: bytes, messages: Sequence[bytes]) -> NDArray[np.void]:
    """Return messages that ``Scalars`` has made as rows with its fields, by their descriptor."""
    (file,) = FileDescriptorSet.FromString(descriptor).file
    kinds = {number: kind for kind, number in _KINDS.items()}
    fields = [(field.name, kinds[field.type]) for field in file.message_type[0].field]
    rows = np.frombuffer(b"".join(messages), _blank(fields).dtype)
    return rows[[name for name, _ in fields]]


def _blank(fields: Sequence[tuple[str, str]]) -> NDArray[np.void]:
    """Return a message of zeros, with the tag that stands before each field (name, kind)."""
    columns: list[tuple[str, str]] = []
    tags: list[int] = []
    for number, (name, kind) in enumerate(fields, 1):
        tag = number << 3 | _FIXED32_WIRE_TYPE
        short = tag < 0x80  # else a varint of two bytes
        tags.append(tag if short else (tag & 0x7F | 0x80) | tag >> 7 << 8)
        columns += (f"tag of {name}", "u1" if short else "<u2"), (name, kind)
    blank: NDArray[np.void] = np.zeros((), columns)
    for (name, _), tag in zip(fields, tags, strict=True):
        blank[f"tag of {name}"] = tag
    return blank


def _described(package: str, name: str, fields: tuple[Scalar, ...]) -> bytes:
    files = FileDescriptorSet()
    file = files.file.add(name=f"{package}/{name}.proto", package=package, syntax="proto3")
    message = file.message_type.add(name=name)
    for index, field in enumerate(fields):
        message.field.add(
            name=field.name, number=index + 1, type=_KINDS[field.kind], label=FieldDescriptorProto.LABEL_OPTIONAL
        )
        path = file.MESSAGE_TYPE_FIELD_NUMBER, 0, message.FIELD_FIELD_NUMBER, index
        file.source_code_info.location.add(path=path, span=(index, 0, 0), leading_comments=f" {field.meaning}\n")
    return files.SerializeToString()

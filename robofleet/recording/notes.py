"""What a file says of its groups, which is checked before it is used, and what their scripts noted in it."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BaseModel, Field, TypeAdapter

from robofleet.behaviours.described import Group
from robofleet.behaviours.interface import Shape
from robofleet.bus.keys import NOTE, key
from robofleet.bus.notes import CheckedShape, Marks, Noted, noted
from robofleet.config.tree import Config
from robofleet.recording.run import Own, Recording

_MOST_FIGURES, _MOST_SHAPES = 100, 100

_Text = Annotated[str, Field(max_length=1000)]


class _Figure(BaseModel):
    name: _Text
    unit: _Text = ""
    shown: _Text = ""
    meaning: _Text = ""
    live: bool = True


class _Group(BaseModel):
    name: _Text
    behaviour: _Text
    robots: list[_Text]
    figures: Annotated[list[_Figure], Field(max_length=_MOST_FIGURES)]
    shapes: Annotated[list[CheckedShape], Field(max_length=_MOST_SHAPES)]


_GROUPS = TypeAdapter(list[_Group])


def believed_groups(text: bytes, config: Config) -> tuple[Group, ...]:
    """Return the groups as a file describes them; ValueError where they cannot be those of its configuration."""
    groups = tuple(Group.from_plain(group.model_dump(exclude_unset=True)) for group in _GROUPS.validate_json(text))
    if [group.robots for group in groups] != [group.robots for group in config.groups]:
        raise ValueError("other groups than the configuration has")
    return groups


def of_group(recording: Recording, group: str, own: Own = Own()) -> Iterator[Noted]:  # noqa: B008
    """Yield a group's notes, in their order; ``own``: of a part of the run."""
    for payload in recording.between(key(recording.config.arena.name, NOTE, group), own.first, own.until):
        if (note := noted(payload)) is not None:
            yield note


def kept(recording: Recording, group: str) -> dict[str, Any]:
    """Return the figures that a group's scripts kept: of one name the newest."""
    found: dict[str, Any] = {}
    for note in of_group(recording, group):
        found |= note.figures or {}
    return found


def marks(recording: Recording, group: str) -> tuple[Shape, ...]:
    """Return the marks that were on the floor when the run ended."""
    found = Marks()
    for note in of_group(recording, group):
        if note.mark is not None:
            found.take(note.mark)
    return found.shapes

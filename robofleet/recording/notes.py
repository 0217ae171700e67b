"""What a file says of its groups, and what scripts noted for people: lines, marks on the floor, figures.

Both may come from a stranger: they are checked before they are used.
"""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, Field, JsonValue, TypeAdapter, ValidationError

from robofleet.behaviours.described import Group, shape_from_plain
from robofleet.behaviours.interface import Shape
from robofleet.bus.keys import NOTE, key
from robofleet.bus.messages import NOTE as LAYOUT
from robofleet.bus.messages import NoteKind
from robofleet.config.files.yamlfile import printable
from robofleet.config.tree import Config
from robofleet.recording.run import Own, Recording

_MOST_FIGURES, _MOST_SHAPES, _MOST_POINTS = 100, 100, 100_000

_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
_Text = Annotated[str, Field(max_length=1000)]


class _Figure(BaseModel):
    name: _Text
    unit: _Text = ""
    shown: _Text = ""
    meaning: _Text = ""
    live: bool = True


class _Shape(BaseModel):
    kind: Literal["Line", "Dots"]
    name: _Text
    points: Annotated[list[tuple[_Number, _Number]], Field(max_length=_MOST_POINTS)]
    closed: bool = False
    directed: bool = False


class _Group(BaseModel):
    name: _Text
    behaviour: _Text
    robots: list[_Text]
    figures: Annotated[list[_Figure], Field(max_length=_MOST_FIGURES)]
    shapes: Annotated[list[_Shape], Field(max_length=_MOST_SHAPES)]


_GROUPS = TypeAdapter(list[_Group])


def believed_groups(text: bytes, config: Config) -> tuple[Group, ...]:
    """Return the groups as a file describes them; ValueError where they cannot be those of its configuration."""
    groups = tuple(Group.from_plain(group.model_dump(exclude_unset=True)) for group in _GROUPS.validate_json(text))
    if [group.robots for group in groups] != [group.robots for group in config.groups]:
        raise ValueError("other groups than the configuration has")
    return groups


_MOST_MARKS = 100  # of a group, by name: more are not drawn
_TEXT = TypeAdapter(Annotated[str, Field(max_length=100_000)])
_FIGURES = TypeAdapter(dict[Annotated[str, Field(max_length=100)], JsonValue])


class Noted(NamedTuple):
    """A note: one of the three."""

    echo_tick: int  # the newest tick that the script knew
    line: str | None = None
    mark: Shape | None = None  # without points: it is taken away
    figures: dict[str, Any] | None = None


def noted(payload: bytes) -> Noted | None:
    """Return what a message notes; None where it cannot be read."""
    note = LAYOUT.decode(payload)
    if note is None:
        return None
    try:
        if note.kind == NoteKind.SAY:
            return Noted(note.echo_tick, line=printable(_TEXT.validate_json(note.text)))
        if note.kind == NoteKind.MARK:
            shape = _Shape.model_validate_json(note.text).model_dump(exclude_unset=True)
            return Noted(note.echo_tick, mark=shape_from_plain(shape))
        if note.kind == NoteKind.KEEP:
            return Noted(note.echo_tick, figures=_FIGURES.validate_json(note.text))
    except (ValidationError, TypeError, ValueError):
        pass
    return None


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


class Marks:
    """The marks of a group that are on the floor, by their names."""

    def __init__(self) -> None:
        self._shapes: dict[str, Shape] = {}

    def take(self, mark: Shape) -> bool:
        """Take a mark; returns whether it changes what is drawn."""
        if not len(mark.points):
            return self._shapes.pop(mark.name, None) is not None
        if mark.name not in self._shapes and len(self._shapes) >= _MOST_MARKS:
            return False
        self._shapes[mark.name] = mark
        return True

    @property
    def shapes(self) -> tuple[Shape, ...]:
        return tuple(self._shapes.values())


def marks(recording: Recording, group: str) -> tuple[Shape, ...]:
    """Return the marks that were on the floor when the run ended."""
    found = Marks()
    for note in of_group(recording, group):
        if note.mark is not None:
            found.take(note.mark)
    return found.shapes

"""What scripts note for people: lines, marks on the floor, figures. They may come from a stranger: they are checked."""

from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, Field, JsonValue, TypeAdapter, ValidationError

from robofleet.behaviours.described import shape_from_plain
from robofleet.behaviours.interface import Shape
from robofleet.bus.messages import NOTE, NoteKind
from robofleet.config.files.yamlfile import printable

_MOST_POINTS = 100_000
_MOST_MARKS = 100  # of a group, by name: more are not drawn

_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]


class CheckedShape(BaseModel):
    """A shape as JSON has it."""

    kind: Literal["Line", "Dots"]
    name: Annotated[str, Field(max_length=1000)]
    points: Annotated[list[tuple[_Number, _Number]], Field(max_length=_MOST_POINTS)]
    closed: bool = False
    directed: bool = False


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
    note = NOTE.decode(payload)
    if note is None:
        return None
    try:
        if note.kind == NoteKind.SAY:
            return Noted(note.echo_tick, line=printable(_TEXT.validate_json(note.text)))
        if note.kind == NoteKind.MARK:
            shape = CheckedShape.model_validate_json(note.text).model_dump(exclude_unset=True)
            return Noted(note.echo_tick, mark=shape_from_plain(shape))
        if note.kind == NoteKind.KEEP:
            return Noted(note.echo_tick, figures=_FIGURES.validate_json(note.text))
    except (ValidationError, TypeError, ValueError):
        pass
    return None


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

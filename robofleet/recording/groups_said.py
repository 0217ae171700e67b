"""What a file says of its groups, as far as it can be believed: it may come from a stranger."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from robofleet.behaviours.described import Group
from robofleet.config.tree import Config

_MOST_FIGURES, _MOST_SHAPES, _MOST_POINTS = 100, 100, 100_000

_Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
_Text = Annotated[str, Field(max_length=1000)]


class _Believed(BaseModel):
    model_config = ConfigDict(extra="ignore")


class _Figure(_Believed):
    name: _Text
    unit: _Text = ""
    shown: _Text = ""
    meaning: _Text = ""
    live: bool = True


class ShapeSaid(_Believed):
    """A shape on the floor."""

    kind: Literal["Line", "Dots"]
    name: _Text
    points: Annotated[list[tuple[_Number, _Number]], Field(max_length=_MOST_POINTS)]
    closed: bool = False
    directed: bool = False


class _Group(_Believed):
    name: _Text
    behaviour: _Text
    robots: list[_Text]
    figures: Annotated[list[_Figure], Field(max_length=_MOST_FIGURES)]
    shapes: Annotated[list[ShapeSaid], Field(max_length=_MOST_SHAPES)]


_GROUPS = TypeAdapter(list[_Group])


def said(text: bytes, config: Config) -> tuple[Group, ...]:
    """Return the groups as a file describes them; ValueError where they cannot be those of its configuration."""
    groups = tuple(Group.from_plain(group.model_dump(exclude_unset=True)) for group in _GROUPS.validate_json(text))
    if [group.robots for group in groups] != [group.robots for group in config.groups]:
        raise ValueError("other groups than the configuration has")
    return groups

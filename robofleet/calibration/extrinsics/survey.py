"""What was surveyed on the floor: tags and points whose places in the world were measured by hand.

A survey is a YAML file; its ``floor_tags`` are written as a configuration's ``tracker.floor_tags``. ``points`` are for
marks that nothing finds by itself, a cross of tape say: someone read their pixels off the image.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from robofleet.calibration.store import CalibrationError, load
from robofleet.config.calibrated import FloorTag
from robofleet.core.settings import FAMILIES, Coordinate, FamilyName, Model, NonNegative, within

LEAST = 4  # marks that determine where a camera hangs
_LINE = 0.02  # marks whose spread to the side is less than this, of that along them, lie on one line


class SurveyedPoint(Model):
    """A mark on the floor, and where it is in the image."""

    name: Annotated[str, Field(min_length=1)]
    x_m: Coordinate  # [world]
    y_m: Coordinate
    height_m: NonNegative = 0.0
    u_px: Annotated[float, within(-1e5, 1e5)]
    v_px: Annotated[float, within(-1e5, 1e5)]


class Survey(Model):
    """Tags and points of one floor."""

    family: FamilyName = "36h11"
    floor_tags: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()
    points: Annotated[tuple[SurveyedPoint, ...], Field(strict=False)] = ()

    @property
    def marks(self) -> tuple[FloorTag | SurveyedPoint, ...]:
        return (*self.floor_tags, *self.points)


def load_survey(file: Path) -> Survey:
    survey = load(file, Survey)
    faults = [f"{file}: {fault}" for fault in _faults(survey)]
    if faults:
        raise CalibrationError(faults)
    return survey


def on_one_line(points: NDArray[np.float64]) -> bool:
    """Return whether points (N, 3) lie on a line, or all in one place: a camera can turn around it unseen."""
    spread = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return bool(spread[1] <= _LINE * spread[0])


def _faults(survey: Survey) -> Iterator[str]:
    """Return what is wrong between entries that are right by themselves."""
    tags = len(survey.floor_tags)
    names: dict[int | str, str] = {}
    places: dict[tuple[float, float, float], str] = {}
    for i, mark in enumerate(survey.marks):
        where = f"floor_tags.{i}" if i < tags else f"points.{i - tags}"
        name = mark.tag if isinstance(mark, FloorTag) else mark.name
        if isinstance(mark, FloorTag) and mark.tag >= (ids := FAMILIES[survey.family].ids):
            yield f"{where}.tag: {mark.tag}: the family {survey.family} has the ids 0 to {ids - 1}: mend one"
        if name in names:
            yield f"{where}: {name!r} is {names[name]}'s already: survey each mark once"
        position = (mark.x_m, mark.y_m, mark.height_m)
        if position in places:
            yield f"{where}: lies where {places[position]} does: two marks cannot lie in one place"
        names.setdefault(name, where)
        places.setdefault(position, where)
    if len(survey.marks) < LEAST:
        yield f"{LEAST} tags and points or more place a camera, and this survey has {len(survey.marks)}: survey more"
    elif on_one_line(np.array([(mark.x_m, mark.y_m, mark.height_m) for mark in survey.marks])):
        yield "all tags and points lie on one line, around which the camera could turn: lay some beside it"

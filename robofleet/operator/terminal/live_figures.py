"""The figures that behaviours tell, as people see them live: columns of the terminal and of the page."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.behaviours.described import Group
from robofleet.behaviours.interface import Figure
from robofleet.bus.messages import TickRecord
from robofleet.safety.supervisor import MOVING

Array = NDArray[np.float64]

_FINE, _COARSE = 10.0, 1000.0  # from here on a digit less is shown


class LiveFigures(NamedTuple):
    """What the groups told in a tick, a row a robot in the order of the members; NaN: not told."""

    references: Array  # (N, 2) [m; world]
    figures: Array  # (N, C) in the units that are shown; C: as ``columns`` returns


def columns(groups: Sequence[Group]) -> list[Figure]:
    """Return the live figures of all groups, each once: figures of one name and unit are one column."""
    every = {figure.shown_key: figure for group in groups for figure in group.figures if figure.live}
    return list(every.values())


def own(group: Group, every: Sequence[Figure]) -> list[int]:
    """Return which of all columns a group has."""
    keys = {figure.shown_key for figure in group.figures if figure.live}
    return [k for k, figure in enumerate(every) if figure.shown_key in keys]


def told(groups: Sequence[Group], record: TickRecord | None) -> LiveFigures:
    """Return what a tick says; nothing where its robots are not to move, or its numbers are of other groups."""
    keys = [figure.shown_key for figure in columns(groups)]
    n = sum(len(group.robots) for group in groups)
    made = LiveFigures(np.full((n, 2), np.nan), np.full((n, len(keys)), np.nan))
    if record is None or len(record.figures) < described.size(groups):
        return made
    running, first = record.run_tick >= 0, 0
    for group, part in zip(groups, described.told(groups, np.array([record.figures])), strict=True):
        rows = slice(first, first := first + len(group.robots))
        if running or record.phase in MOVING:
            made.references[rows] = part.references[0]
        for figure in group.figures if running else ():
            if figure.live:
                made.figures[rows, keys.index(figure.shown_key)] = part.figures[figure.name][0] * figure.scale
    return made


def unit(figure: Figure) -> str:
    return figure.shown or figure.unit


def title(figure: Figure) -> str:
    return figure.name.replace("_", " ")


def digits(figure: Figure) -> int:
    """Return how many digits are shown behind the point of a value near 1: more of metres than of millimetres."""
    return 3 if figure.scale == 1.0 else 2


def words(figure: Figure, value: float) -> str:
    """Return a value in the unit that is shown, without that unit; an empty string where it is not known."""
    if not math.isfinite(value):
        return ""
    fewer = sum(bool(abs(value) >= size) for size in (_FINE, _COARSE))
    return f"{value:.{digits(figure) - fewer}f}"

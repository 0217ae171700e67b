"""What a group measures of its own past: its behaviour's figures and measures, as curves over the ticks.

A behaviour may come from outside the project, or be missing where a recording is read, or be named by a recording
only: then it is not imported. What it cannot tell is missing, and nothing else is.
"""

import re
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from robofleet.behaviours import described
from robofleet.behaviours.interface import Behaviour, Measure, Past, Team, scale, with_unit
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Flags
from robofleet.core.valid_json import dumps

Figures = dict[str, Any]
T = TypeVar("T")

_TRIED_TICKS = 2  # of the past by which a behaviour is asked what it measures


class Curve(NamedTuple):
    """Something of a group over the ticks (K,), in n columns, in the unit that is shown."""

    name: str  # control_error
    key: str  # control_error_mm
    unit: str
    meaning: str
    values: Array  # (K, n); NaN: not known
    counts: Flags | None  # (K,) at which ticks they count in the summary; None: at those that count in the run
    of: tuple[str, ...]  # what each column is about: robots' ids, or pairs of them
    rows: tuple[int | None, ...]  # which of the group's robots each column is about; None: none of them alone
    asked: float | None  # what the values should be
    live: bool  # whether it is drawn
    is_figure: bool  # of each tick; else it was measured afterwards
    robots: int  # of the group

    @property
    def title(self) -> str:
        return self.name.replace("_", " ").capitalize()

    @property
    def counted(self) -> Array:
        """What a table has: of a measure that counts later than others, what counts."""
        return self.values if self.counts is None else np.where(self.counts[:, None], self.values, np.nan)

    @property
    def label(self) -> str:
        return ", ".join(filter(None, (self.name.replace("_", " "), self.unit)))

    @property
    def columns(self) -> dict[str, tuple[tuple[int, ...], tuple[int, ...]]]:
        """Columns of a table with a row for each robot: (rows, columns of ``values``) by the names of the columns.

        Where two columns are about the same robot, or about none, each is a column of the table that every robot has.
        """
        rows = [row for row in self.rows if row is not None]
        if len(rows) == len(self.of) == len(set(rows)):
            return {_field(self.key): (tuple(rows), tuple(range(len(rows))))}
        alone, every = len(self.of) == 1, tuple(range(self.robots))
        return {
            _field(self.key if alone else with_unit(f"{self.name}_{statistic}", self.unit)): (every, (k,) * len(every))
            for k, statistic in enumerate(self.of)
        }


class Gauge:
    """Asks a group's behaviour what it measures."""

    def __init__(self, config: Config, k: int, group: described.Group, foreign: Collection[str] = ()) -> None:
        """Make the behaviour of the ``k``-th group; where it is missing, the group's description is what is known.

        ``foreign``: behaviours that are not imported.
        """
        self.group = group
        self._team = groups.team(config, config.groups[k])
        self._behaviour = _made(config, k, group, foreign) or _only_described(group, self._team)
        self._complained = False
        tried = self.curves(_tried(len(group.robots), group))
        self.asked = {curve.key: curve.asked for curve in tried if curve.asked is not None}  # in the unit that is shown
        self.columns = {name: curve for curve in tried for name in curve.columns}  # of a table; values mean nothing
        self._keys = [curve.key for curve in tried]

    def curves(self, past: Past) -> tuple[Curve, ...]:
        group, robots = self.group, self._team.robots
        figures = [
            (Measure(f.name, f.unit, past.figures[f.name], robots, f.shown, f.meaning), f.live) for f in group.figures
        ]
        measured: list[Measure] = self._tried_to(lambda: self._measures(past), [])
        found: dict[str, Curve] = {}
        for measure, live, is_figure in (
            *((m, live, True) for m, live in figures),
            *((m, True, False) for m in measured),
        ):
            curve = _curve(measure, robots, live=live, is_figure=is_figure)
            found.setdefault(curve.key, curve)
        return tuple(found.values())

    def summary(self, past: Past) -> Figures:
        """Return the group's part of ``summary.json``; a figure that was not measured is None."""
        return self._tried_to(lambda: self._summary(past), dict.fromkeys(self._keys), quietly=not len(past.t))

    def _measures(self, past: Past) -> list[Measure]:
        found = list(self._behaviour.measures(past))
        for measure in found:
            if measure.values.shape != (len(past.t), len(measure.of)):
                wanted = len(past.t), len(measure.of)
                raise ValueError(f"{measure.name}: values of shape {measure.values.shape}, not {wanted}")
            if measure.counts is not None and measure.counts.shape != past.t.shape:
                raise ValueError(f"{measure.name}: counts of shape {measure.counts.shape}, not {past.t.shape}")
        return found

    def _summary(self, past: Past) -> Figures:
        found = self._behaviour.summary(past)
        dumps(found)  # it must be of what JSON has
        return found

    def _tried_to(self, ask: Callable[[], T], otherwise: T, *, quietly: bool = False) -> T:
        try:
            with np.errstate(all="ignore"):
                return ask()
        except Exception:  # noqa: BLE001 - whatever a behaviour raises is its own failure, and no other figure's
            if not (self._complained or quietly):
                self._complained = True
                traceback.print_exc(file=sys.stderr)
                group = self.group
                print(f"group {group.name}: {group.behaviour} cannot measure: its figures are missing", file=sys.stderr)
            return otherwise


def peaked(figures: Figures, parts: Sequence[Figures]) -> Figures:
    """Return a group's part of a summary, of some ticks, with the largest values (``max...``) of all ticks.

    ``parts``: the same of the parts of the run. What is so of its end (``final_...``) is as it is.
    """
    return {
        name: {key: _largest(key, value, [part.get(name) for part in parts]) for key, value in own.items()}
        if isinstance(own, dict) and not name.startswith("final_")
        else own
        for name, own in figures.items()
    }


def _largest(key: str, value: Any, parts: Sequence[Any]) -> Any:
    if not key.startswith("max") or not isinstance(value, float):
        return value
    others = [part[key] for part in parts if isinstance(part, dict) and isinstance(part.get(key), float)]
    return max([value, *others])


def gauges(config: Config, groups: tuple[described.Group, ...], foreign: Collection[str] = ()) -> tuple[Gauge, ...]:
    """Return every group's; ``foreign``: behaviours that are not imported."""
    return tuple(Gauge(config, k, group, foreign) for k, group in enumerate(groups))


def _made(config: Config, k: int, group: described.Group, foreign: Collection[str]) -> Behaviour | None:
    """Return a group's behaviour; None where it is missing, or is not the one that told these figures."""
    if config.groups[k].behaviour in foreign:
        return None
    try:
        made = groups.behaviour(config, config.groups[k])
    except Exception:  # noqa: BLE001 - a module from outside may raise whatever it likes
        return None
    known = {figure.name for figure in group.figures}
    return made if {figure.name for figure in made.figures} == known else None


def _only_described(group: described.Group, team: Team) -> Behaviour:
    """Return what stands for a behaviour that is missing: it has the figures that it told."""
    kind = type("Described", (Behaviour,), {"figures": group.figures})
    made: Behaviour = kind(None, team)
    return made


def _tried(robots: int, group: described.Group) -> Past:
    t, row = np.arange(_TRIED_TICKS) / 30, 1.0 + np.arange(robots)
    poses = np.tile(np.stack([0.1 * row, 0.02 * row, 0.1 * row], axis=-1), (_TRIED_TICKS, 1, 1))
    every = np.ones(_TRIED_TICKS, dtype=np.bool_)
    return Past(
        t=t, poses=poses, points=poses[..., :2].copy(), known=np.ones(robots, dtype=np.bool_), settled=every,
        spaced=every, references=poses[..., :2].copy(),
        figures={figure.name: np.zeros((_TRIED_TICKS, robots)) for figure in group.figures},
    )  # fmt: skip


def _curve(measure: Measure, robots: tuple[str, ...], *, live: bool, is_figure: bool) -> Curve:
    unit, factor = _shown(measure)
    target = None if measure.asked is None else measure.asked * factor
    return Curve(
        measure.name, with_unit(measure.name, unit), unit, measure.meaning.rstrip("."), measure.values * factor,
        measure.counts, measure.of, tuple(_rows(measure.of, robots)), target, live, is_figure,
        len(robots),
    )  # fmt: skip


def _shown(measure: Measure) -> tuple[str, float]:
    """Return the unit that is shown, and its factor; the measure's own where there is none."""
    try:
        return measure.shown or measure.unit, scale(measure.unit, measure.shown)
    except ValueError:
        return measure.unit, 1.0


def _rows(owners: tuple[str, ...], robots: tuple[str, ...]) -> Iterator[int | None]:
    """Yield which robot each column is about: of a pair, the second."""
    for words in owners:
        last = words.split()[-1] if words.split() else ""
        yield robots.index(last) if last in robots else None


def _field(name: str) -> str:
    """Return a name that a field of a message and a column can have."""
    return re.sub(r"\W", "_", name, flags=re.ASCII)

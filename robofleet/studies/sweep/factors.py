"""What is looked at in a sweep: the settings as factors with levels, and the figures that differ between runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.config.load import spelled
from robofleet.core.arrays import Array
from robofleet.reports.bounds import JUDGED, JUDGED_KEYS
from robofleet.reports.own_figures import is_number, own_figures
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.table import Ran

_MOST_LEVELS, _BINS = 12, 6  # of a key; more values are put into so many classes


@dataclass(frozen=True)
class Factor:
    """A setting that varies."""

    name: str  # the end of its key by which it is known
    key: str
    levels: tuple[str, ...]
    run_levels: NDArray[np.int64]  # (R,) each run's level

    def __len__(self) -> int:
        return len(self.levels)


@dataclass(frozen=True)
class Measure:
    """A figure of every run."""

    label: str
    unit: str
    values: Array  # (R,); NaN: not measured
    limit: float | None = None  # the bound, where all runs have the same
    at_least: bool = False

    @property
    def title(self) -> str:
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def varies(self) -> bool:
        known = self.values[np.isfinite(self.values)]
        return len(known) > 1 and bool(known.max() > known.min())

    @property
    def worst(self) -> int:
        """The run that is furthest on the wrong side."""
        return int(np.nanargmin(self.values) if self.at_least else np.nanargmax(self.values))


def factors(study: Study) -> list[Factor]:
    """Return the keys with more than one value, and the files of faults."""
    names = _short(study.keys)
    found = [_factor(study, key, names[key]) for key in study.keys]
    files = list(dict.fromkeys(run.faults for run in study.runs))
    run_levels = np.array([files.index(run.faults) for run in study.runs])
    found.append(Factor("faults", "faults", tuple("none" if f is None else Path(f).stem for f in files), run_levels))
    return [factor for factor in found if len(factor) > 1]


def measures(runs: Sequence[Ran]) -> list[Measure]:
    """Return the figures that were measured in some run: those with a bound, the groups' own, then the others."""
    summaries = _summaries(runs)
    own: dict[tuple[str, str], list[float | None]] = {}
    for k, summary in enumerate(summaries):
        for label, unit, value in _own(summary):
            own.setdefault((label, unit), [None] * len(runs))[k] = value
    judged = list(_judged(summaries))
    found = [measure for measure in judged if measure.limit is not None]
    found += [Measure(label, unit, _array(values)) for (label, unit), values in own.items()]
    found += [measure for measure in judged if measure.limit is None]
    return [measure for measure in found if np.isfinite(measure.values).any()]


def unmeasured(runs: Sequence[Ran]) -> list[Measure]:
    """Return the figures that have a bound, and that no run measured."""
    judged = _judged(_summaries(runs))
    return [measure for measure in judged if measure.limit is not None and np.isnan(measure.values).all()]


def _summaries(runs: Sequence[Ran]) -> list[dict[str, Any] | None]:
    return [None if ran.played is None else ran.played.summary for ran in runs]


def _judged(summaries: Sequence[dict[str, Any] | None]) -> Iterator[Measure]:
    """Yield the figures that bounds can judge."""
    for name, figure in JUDGED.items():
        limits = {bound["limit"] for s in summaries if s for bound in s["bounds"] if bound["figure"] == name}
        values = [None if s is None else figure.value_of(s) for s in summaries]
        limit = limits.pop() if len(limits) == 1 else None
        yield Measure(figure.label, figure.unit, _array(values), limit, figure.at_least)


def _own(summary: dict[str, Any] | None) -> Iterator[tuple[str, str, float]]:
    """Yield the groups' own figures that no bound judges."""
    for name, group in summary["groups"].items() if summary else ():
        tail = f" of {name}" if summary and len(summary["groups"]) > 1 else ""
        for own in own_figures(group):
            if own.mean is not None and own.key not in JUDGED_KEYS:
                yield f"{own.label}{', mean' if own.each else ''}{tail}", own.unit, own.mean


def _factor(study: Study, key: str, name: str) -> Factor:
    values = [run.values[key] for run in study.runs]
    spellings = [spelled(value) for value in values]
    numeric = all(map(is_number, values))
    if numeric and len(set(values)) > _MOST_LEVELS:
        return _classes(key, name, np.array(values, np.float64), logarithmic=study.spans.get(key, False))
    known = list(dict.fromkeys(spellings))
    if numeric:
        known.sort(key=float)
    return Factor(name, key, tuple(known), np.array([known.index(spelling) for spelling in spellings]))


def _classes(key: str, name: str, values: Array, *, logarithmic: bool) -> Factor:
    """Return the classes into which numbers fall, equally wide."""
    low, high = values.min(), values.max()
    edges = np.geomspace(low, high, _BINS + 1) if logarithmic else np.linspace(low, high, _BINS + 1)
    run_levels = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1)
    levels = tuple(f"{a:.3g}–{b:.3g}" for a, b in pairwise(edges))
    return Factor(name, key, levels, run_levels)


def _short(keys: Sequence[str]) -> dict[str, str]:
    """Return for each key the shortest end that no other one has."""
    names = {}
    for key in keys:
        parts = key.split(".")
        ends = [".".join(parts[-count:]) for count in range(1, len(parts) + 1)]
        others = [other for other in keys if other != key]
        names[key] = next(end for end in ends if not any(f".{other}".endswith(f".{end}") for other in others))
    return names


def _array(values: Sequence[float | None]) -> Array:
    return np.array([np.nan if value is None else value for value in values], np.float64)

"""A recorded run in tables: columns of arrays, read part by part, and only the topics that a table needs."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.bus.keys import STATE, STATUS, TICK, TRUTH, Topic
from robofleet.config.faults import did_you_mean
from robofleet.core.arrays import Array
from robofleet.core.refusal import RefusedError, need_extra
from robofleet.recording.columns import COLUMNS, Column, own_names, own_table
from robofleet.recording.measures import exposure_to_tick_ms
from robofleet.recording.reading import Imports, nothing_imported
from robofleet.recording.run import Run
from robofleet.reports.sampled import looks
from robofleet.reports.stops import stops
from robofleet.safety.supervisor import Phase

Library = Literal["pandas", "polars", "numpy"]

_TOGETHER = 1 << 20  # [bytes] of messages that are looked at together
_OF_COMMANDS = {
    "u_x_m_s", "u_y_m_s", "left_commanded_rad_s", "right_commanded_rad_s", "left_measured_rad_s",
    "right_measured_rad_s", "saturated", "filtered", "blocked", "failed", "exposure_to_wheel_ms",
}  # fmt: skip
KEYS = "t_s", "run_time_s", "tick", "counts"  # the first columns of all tables but ``stops``
_UNKNOWN = -1  # a flag that is not known


class Words(NamedTuple):
    """A column of few different words."""

    codes: NDArray[np.int16]  # of each row the index of its word; -1: not known
    words: tuple[str, ...]


Columns = dict[str, NDArray[Any] | Words]


class _Table(NamedTuple):
    topics: tuple[Topic, ...]  # that it is made of
    columns: Callable[[Run], Columns]


def names(groups: Sequence[described.Group]) -> tuple[str, ...]:
    """Return the names of a run's tables."""
    return (*_TABLES, *_groups(groups))


def parts(
    run: Path, groups: Sequence[described.Group], name: str, imports: Imports = nothing_imported
) -> Iterator[Columns]:
    """Yield a table of a run part by part; the columns of all parts are the same.

    ``groups``: those of the run; ``imports``: as of ``reading.read``.

    Raises:
        RefusedError: There is no such table.
        RecordingError: The recording cannot be read.
    """
    own = _groups(groups)
    if name not in own and name not in _TABLES:
        raise RefusedError(f"{run}: there is no table {name!r}: {did_you_mean(name, names(groups))}")
    table = _TABLES.get(name) or _Table((TICK, TRUTH), partial(_group, own[name]))
    return (table.columns(part) for part in looks(run, imports, _TOGETHER, table.topics))


def joined(parts: Iterable[Columns]) -> Columns:
    """Return the parts of a table together."""
    first: Columns = {}
    grown: dict[str, bytearray] = {}  # it grows in place: no column is in memory twice
    texts: dict[str, list[str]] = {}
    for part in parts:
        first = first or part
        for name, values in part.items():
            column = values.codes if isinstance(values, Words) else values
            if column.dtype == object:
                texts.setdefault(name, []).extend(column)
            else:
                grown.setdefault(name, bytearray()).extend(column.data.cast("B") if len(column) else b"")
        del part
    return {
        name: Words(np.frombuffer(grown[name], np.int16), values.words)
        if isinstance(values, Words)
        else np.array(texts[name], object)
        if name in texts
        else np.frombuffer(grown[name], values.dtype)
        for name, values in first.items()
    }


def chosen(library: Library | None) -> Library:
    """Return the library of tables that is asked for, else the first that is installed.

    Raises:
        RefusedError: It is unknown, or not installed.
    """
    known: tuple[Library, ...] = get_args(Library)
    if library is None:
        return next(name for name in known if find_spec(name) is not None)
    if library not in known:
        raise RefusedError(f"library: {library!r}: {did_you_mean(str(library), known)}")
    need_extra("notebook", library)
    return library


def frame(columns: Columns, library: Library) -> Any:
    """Return a table as a DataFrame; for numpy as a dict of arrays."""
    if library == "numpy":
        return {name: _spelled(values) if isinstance(values, Words) else values for name, values in columns.items()}
    module = import_module(library)
    made = _pandas if library == "pandas" else _polars
    series = {name: made(module, values) for name, values in columns.items()}
    return module.DataFrame(series, copy=False) if library == "pandas" else module.DataFrame(series)


def _pandas(pandas: Any, values: NDArray[Any] | Words) -> Any:
    if isinstance(values, Words):
        return pandas.Categorical.from_codes(values.codes, values.words)
    return values


def _polars(polars: Any, values: NDArray[Any] | Words) -> Any:
    if isinstance(values, Words):
        words = polars.Series(values.words, dtype=polars.Enum(values.words))
        return words.gather(polars.Series(values.codes).replace(_UNKNOWN, None))
    if values.dtype == object:
        return polars.Series(values.tolist(), dtype=polars.String)
    return polars.Series(values, nan_to_null=True)


def _spelled(column: Words) -> NDArray[Any]:
    return np.array([*column.words, ""])[column.codes]


def _groups(groups: Sequence[described.Group]) -> dict[str, int]:
    """Return the number of each group by the name of its table."""
    return {f"own_{group.name}" if group.name in _TABLES else group.name: k for k, group in enumerate(groups)}


def _ticks(run: Run) -> Columns:
    run = run.whole()
    ticks = run.ticks
    phases = ticks["phase"].astype(np.int16)
    return {
        **_when(run, 1),
        "run_tick": ticks["run_tick"].astype(np.int64),
        "phase": Words(np.where(phases < len(Phase), phases, _UNKNOWN), tuple(phase.name.lower() for phase in Phase)),
        "overruns": ticks["overruns"].astype(np.int64),
        "lateness_ms": ticks["lateness_ns"] / 1e6,
        "previous_compute_ms": ticks["compute_ns"] / 1e6,
        "exposure_to_tick_ms": exposure_to_tick_ms(run),
    }


def _of_robots(columns: Sequence[Column], run: Run) -> Columns:
    run = run.whole()
    robots = [(robot, k) for k, group in enumerate(run.groups) for robot in group.robots]
    group_names = tuple(group.name for group in run.groups)
    group_of = np.tile(np.array([k for _, k in robots], np.int16), len(run.ticks))
    table = {**_rows(run, [robot for robot, _ in robots]), "group": Words(group_of, group_names)}
    return table | {column.name: _column(column, run) for column in columns}


def _column(column: Column, run: Run) -> NDArray[Any]:
    values = column.values(run).ravel()
    if not column.whole:
        return values
    return np.where(np.abs(values) < np.iinfo(np.int16).max, values, _UNKNOWN).astype(np.int16)


def _group(k: int, run: Run) -> Columns:
    run = run.whole()
    part = run.parts[k]
    own = own_names([part.gauge])
    values = own_table(part, own, counted=True)
    robots = part.group.robots
    return _rows(run, robots) | {name: values[..., column].ravel() for column, name in enumerate(own)}


def _stops(run: Run) -> Columns:
    found, robots = stops(run), tuple(run.robots)
    return {
        "t_s": _numbers(found, "t_s"),
        "robot": Words(np.array([robots.index(stop["robot"]) for stop in found], np.int16), robots),
        "cause": np.array([stop["cause"] for stop in found], object),
        "by_operator": np.array([stop["by_operator"] for stop in found], np.bool_),
        "target_ms": _numbers(found, "target_ms"),
        "output_ms": _numbers(found, "output_ms"),
    }


def _numbers(stops: Sequence[dict[str, Any]], name: str) -> Array:
    return np.array([np.nan if stop[name] is None else stop[name] for stop in stops], np.float64)


def _rows(run: Run, robots: Sequence[str]) -> Columns:
    """Return what names each row of a table with a row for each tick and robot."""
    codes = np.tile(np.arange(len(robots), dtype=np.int16), len(run.ticks))
    return {**_when(run, len(robots)), "robot": Words(codes, tuple(robots))}


def _when(run: Run, repeats: int) -> Columns:
    """Return which tick each row is of, and whether the figures count there."""
    columns = run.clock_time_s, run.run_time_s, run.ticks["tick"].astype(np.int64), run.counts
    return dict(zip(KEYS, (np.repeat(column, repeats) for column in columns), strict=True))


_TABLES = {
    "poses": _Table((TICK, TRUTH), partial(_of_robots, [c for c in COLUMNS if c.name not in _OF_COMMANDS])),
    "commands": _Table((TICK, STATUS), partial(_of_robots, [c for c in COLUMNS if c.name in _OF_COMMANDS])),
    "ticks": _Table((TICK,), _ticks),
    "stops": _Table((TICK, STATUS, STATE), _stops),
}

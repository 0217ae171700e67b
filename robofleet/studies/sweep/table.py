"""A sweep's table: a row for each run, its settings and the figures of its summary, as CSV and Parquet.

Only what a run's configuration decides is in it, so the same sweep leaves the same bytes wherever it runs. How long the
computers took is in a table of its own.
"""

import csv
import io
from collections.abc import Iterator, Sequence
from enum import IntEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.config.load import spelled
from robofleet.core.files import replaced, write_text
from robofleet.reports.bounds import missed, unmeasured
from robofleet.studies.sweep.load import Planned, Study
from robofleet.studies.sweep.unit import Played

CSV, PARQUET, TIMES = "runs.csv", "runs.parquet", "times.csv"
_LEFT_OUT = {
    "version", "config", "seed", "mode", "began", "outcome", "cause", "trace_hash", "robots", "bystanders", "estimated",
    "groups", "stops", "bounds", "busy_machine",
    "real_time_factor", "tick.compute_us", "tracker.frame_ms",  # how fast the computer was
}  # fmt: skip
_GROUPS_OWN = "behaviour", "robots", "asked"

Cell = str | int | float | bool | None
Row = dict[str, Cell]


class Ending(IntEnum):
    """How a run ended, the worst last."""

    MET = 0  # it completed, and met its bounds
    NOT_JUDGED = 1  # it completed, and the figure of a bound was not measured
    MISSED = 2  # it completed, and did not meet a bound
    BROKEN = 3  # it did not complete


class Ran(NamedTuple):
    """A run of the sweep, and what became of it."""

    plan: Planned
    played: Played | None
    failure: str = ""  # why there is nothing of it

    @property
    def outcome(self) -> str:
        return "failed" if self.played is None else str(self.played.summary["outcome"])

    @property
    def cause(self) -> str | None:
        return self.failure if self.played is None else self.played.summary["cause"]

    @property
    def missed(self) -> list[str]:
        return [] if self.played is None else missed(self.played.summary)

    @property
    def not_judged(self) -> list[str]:
        return [] if self.played is None else unmeasured(self.played.summary)

    @property
    def ending(self) -> Ending:
        if self.outcome != "completed":
            return Ending.BROKEN
        return Ending.MISSED if self.missed else Ending.NOT_JUDGED if self.not_judged else Ending.MET


def row(study: Study, ran: Ran) -> Row:
    plan = ran.plan
    settings = {key: _cell(plan.values[key]) for key in study.keys}
    faults = {"faults": plan.faults} if any(run.faults for run in study.runs) else {}
    cells: Row = {"run": plan.number, **settings, **faults, "seed": plan.seed, "outcome": ran.outcome}
    cells["cause"] = ran.cause
    if ran.played is None:
        return cells
    summary = ran.played.summary
    figures = {**summary, "groups": None}
    own = {
        f"groups.{name}.{key}": (figure, group["robots"])
        for name, group in summary["groups"].items()
        for key, figure in group.items()
        if key not in _GROUPS_OWN and figure != summary.get(key)
    }
    cells["trace_hash"] = summary.get("trace_hash")
    cells["bounds_missed"] = len(ran.missed)
    cells["bounds_not_judged"] = len(ran.not_judged)
    cells["stops"] = sum(not stop["by_operator"] for stop in summary["stops"])
    cells.update(_flat(figures, "", summary["robots"]))
    for name, (figure, robots) in own.items():
        cells.update(_flat({name: figure}, "", robots))
    return cells


def write(study: Study, runs: Sequence[Ran], folder: Path) -> list[Path]:
    rows = [row(study, ran) for ran in runs]
    columns = _columns(rows)
    write_text(folder / CSV, _csv(columns, rows))
    files = [folder / CSV]
    if find_spec("pyarrow") is not None:
        _write_parquet(columns, rows, folder / PARQUET)
        files.append(folder / PARQUET)
    times: list[Row] = [
        {"run": ran.plan.number, "cpu_s": ran.played.cpu_s, "lockstep_s": ran.played.lockstep_s}
        for ran in runs
        if ran.played is not None
    ]
    write_text(folder / TIMES, _csv(["run", "cpu_s", "lockstep_s"], times))
    return files


def _flat(tree: dict[str, Any], path: str, robots: Sequence[str]) -> Iterator[tuple[str, Cell]]:
    """Yield figures by their dotted names; of a list each robot's."""
    for key, value in tree.items():
        name = f"{path}{key}"
        if name in _LEFT_OUT:
            continue
        if isinstance(value, list):
            if any(isinstance(entry, dict) for entry in value) or key == "events":
                yield name, len(value)
                continue
            owners = robots[len(robots) - len(value) :] if len(robots) - len(value) in (0, 1) else range(len(value))
            value = {str(entry): number for entry, number in zip(owners, value, strict=True)}  # noqa: PLW2901
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.", robots)
        else:
            yield name, value


def _columns(rows: Sequence[Row]) -> list[str]:
    """Return every column once: a figure that was not measured somewhere has parts elsewhere."""
    known = list(dict.fromkeys(name for cells in rows for name in cells))
    parents = {name[:i] for name in known for i, letter in enumerate(name) if letter == "."}
    return [name for name in known if name not in parents]


def _cell(value: Any) -> Cell:
    return value if isinstance(value, str | int | float) else spelled(value)


def _csv(columns: Sequence[str], rows: Sequence[Row]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([cells.get(name) for name in columns] for cells in rows)
    return text.getvalue()


def _write_parquet(columns: Sequence[str], rows: Sequence[Row], file: Path) -> None:
    import pyarrow as pa  # noqa: PLC0415 - an extra
    from pyarrow import parquet  # noqa: PLC0415

    arrays = {}
    for name in columns:
        cells = [cells.get(name) for cells in rows]
        kinds = {type(cell) for cell in cells if cell is not None}
        if kinds == {int, float}:
            kinds = {float}
        kind = {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}.get(kinds.pop() if len(kinds) == 1 else str)
        if kind is None:  # text, or of several kinds
            arrays[name] = pa.array([None if cell is None else str(cell) for cell in cells], pa.string())
        else:
            arrays[name] = pa.array(cells, kind)
    with replaced(file) as stream:
        parquet.write_table(pa.table(arrays), stream)

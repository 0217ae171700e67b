"""What an experiment returns: tables and figures as plain data. ``drawing.py`` draws them, ``paper.py`` prints them."""

from dataclasses import dataclass
from typing import Any, Literal

from robofleet.core.arrays import Array
from robofleet.reports.canvas import Plot, RunView

Cell = str | float | None  # None: not given by its source


@dataclass(frozen=True)
class Table:
    """A table; ``formats`` holds one format specification a column (of its numbers), '' for three digits."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    formats: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return what goes into JSON: rows as mappings from column to number or text."""
        rows = [dict(zip(self.columns, row, strict=True)) for row in self.rows]
        return {"title": self.title, "rows": rows, "notes": list(self.notes)}

    def text(self, row: tuple[Cell, ...]) -> tuple[str, ...]:
        formats = self.formats or ("",) * len(row)
        return tuple(_text(cell, form) for cell, form in zip(row, formats, strict=True))


@dataclass(frozen=True)
class Curve:
    """One line of a panel: y over x, both shape (N,)."""

    label: str
    x: Array
    y: Array
    style: Literal["solid", "dashed", "dots"] = "solid"


@dataclass(frozen=True)
class Map:
    """A field over a panel: ``values`` (rows of y, columns of x) in [0, 1], 0 blank and 1 full colour."""

    x: Array
    y: Array
    values: Array


@dataclass(frozen=True)
class Panel:
    """A pair of axes; labels carry their units."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...] = ()
    title: str = ""
    field: Map | None = None
    scales: tuple[Literal["linear", "log"], Literal["linear", "log"]] = ("linear", "linear")
    equal: bool = False  # one metre is as long on both axes
    y_limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Figure:
    """A picture of one topic: panels side by side."""

    name: str
    title: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True)
class RunFigure:
    """A plot of a run, as its report has it."""

    plot: Plot
    view: RunView

    @property
    def name(self) -> str:
        return self.plot.file_name


@dataclass(frozen=True)
class Result:
    """All that an experiment has to say; ``data`` is further JSON, keys with units."""

    tables: tuple[Table, ...]
    figures: tuple[Figure | RunFigure, ...]
    data: dict[str, Any]


def _text(cell: Cell, form: str) -> str:
    if cell is None:
        return "-"
    return cell if isinstance(cell, str) else format(cell, form or ".3g")

"""What a run says to a person: the summary, beside the paper's figures where it drives the paper's platoon."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, Group, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from robofleet.config.tree import Config
from robofleet.recording.run_clock import time_words
from robofleet.reports.own_figures import as_asked, heading, own_figures
from robofleet.reports.paper import is_papers, papers_mean
from robofleet.reports.stops import fleet_stops, how_many

Make = Callable[[Sequence[str]], Table]  # is given the columns that are left out


class Fitting:
    """A table that leaves columns out until no cell has to be cut or broken.

    ``make`` returns the table without some columns; ``least_first`` are those that may be left out, in this order. A
    column that may be broken into lines says in ``min_width`` how far; the others are ``no_wrap``.
    """

    def __init__(self, make: Make, least_first: Sequence[str]) -> None:
        self._make, self._least_first = make, least_first

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table, and a line about what is left out."""
        for many in range(len(self._least_first) + 1):
            out = self._least_first[:many]
            if self._needs(out, console, options) <= options.max_width:
                break
        yield self._make(out)
        if out:
            yield Text(f"{', '.join(out)}: not shown, the terminal has {options.max_width} columns", "italic dim")

    def _needs(self, out: Sequence[str], console: Console, options: ConsoleOptions) -> int:
        """Return the columns of a terminal that the table needs."""
        table = self._make(out)
        for column in table.columns:
            if not column.no_wrap:
                column.max_width = column.min_width
        return Measurement.get(console, options.update(width=_ANY_COLUMNS, max_width=_ANY_COLUMNS), table).maximum


_ANY_COLUMNS = 10_000  # a table that is measured has the room that it wants


Summary = dict[str, Any]

_SHOWN_STOPS = 4
_PAPER, _EACH = "the paper", "each robot"
_PROOF_WIDTH = 16  # columns, at least, for what was proved
_FIGURE_WIDTH = 5  # columns of a robot's figure, at least
_ENDS = {"fault": "ended by a fault", "stopped": "stopped"}


class _Row(NamedTuple):
    """A figure of the run."""

    label: str
    value: str
    paper: str = "-"
    each: str | Sequence[str] = ""  # a cell a robot, or words


def summary_table(summary: Summary, config: Config) -> Group:
    """Return what ends a run: the table, and the stops."""
    rows = [*_errors(summary, config), *_health(summary)]
    papers = is_papers(config)

    def make(left_out: Sequence[str]) -> Table:
        columns = ["figure", "this run", *([_PAPER] if papers else []), _EACH]
        return _summary_table(summary, rows, [column for column in columns if column not in left_out])

    lines = [Text(line) for line in (*_caption(summary), *_stops(summary["stops"]))]
    return Group(Fitting(make, (_PAPER, _EACH) if papers else (_EACH,)), *lines)


def _summary_table(summary: Summary, rows: Sequence[_Row], columns: Sequence[str]) -> Table:
    ended = _ENDS.get(summary["outcome"], summary["outcome"])
    columns_of = [summary["robots"], *(row.each for row in rows if not isinstance(row.each, str))]
    width = max(_FIGURE_WIDTH, *(len(cell) for cells in columns_of for cell in cells))
    title = f"{summary['config']}: {ended} after {time_words(summary['duration_s'], summary['clock_duration_s'])}"
    table = Table(title=Text(title, "bold"), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    heads = {
        "figure": "\nfigure",
        "this run": f"this run\n({_mode(summary)})",
        _PAPER: f"{_PAPER}\n(hardware)",
        _EACH: f"{_EACH}\n" + (_in_columns(summary["robots"], width) if len(summary["groups"]) == 1 else ""),
    }
    for column in columns:
        table.add_column(heads[column], justify="right" if column in ("this run", _PAPER) else "left", no_wrap=True)
    for row in rows:
        cells = dict(zip(heads, (*row[:-1], _in_columns(row.each, width)), strict=True))
        table.add_row(*(Text(cells[column]) for column in columns))  # no text of a run is markup
    return table


def _mode(s: Summary) -> str:
    """Return whether what was measured exists: the truth is known of simulated robots alone."""
    return "simulation" if not s["estimated"] else "real" if len(s["estimated"]) == len(s["robots"]) else "mixed"


def _caption(s: Summary) -> Iterator[str]:
    yield "Figures: mean (largest magnitude). Times: median, 99th percentile."
    if s["control_error_mm"] is not None:
        yield "Control error: from the reference to the predicted point x + T u; with a disturbance w, x + T (u + w)."
    if s["estimated"]:
        yield f"No true poses are known of {', '.join(s['estimated'])}: their figures use measured poses."
    else:
        yield "'Estimated' figures use measured poses, the others true poses."
    if s["busy_machine"] is not None:
        yield s["busy_machine"]["words"]
    yield from s.get("remarks", ())


def _errors(s: Summary, config: Config) -> Iterator[_Row]:
    for name, group in s["groups"].items():
        if len(s["groups"]) > 1:
            yield _Row(heading(name, group["behaviour"]), "", "", group["robots"])
        for figure in own_figures(group):
            mean = papers_mean(config, figure.key)
            paper = "-" if mean is None else f"about {mean:g}"
            shown = as_asked(group, figure)
            digits = 2 if shown.target is None else 1
            if shown.mean is None:
                yield _Row(figure.title, "not measured", paper)
            else:
                largest = "" if shown.largest is None else f" ({shown.largest:.1f})"
                yield _Row(shown.title, f"{shown.mean:.{digits}f}{largest}", paper, _each(shown.each, digits))
            if figure.deviation is not None:
                off, unit = figure.deviation
                yield _Row(f"{figure.label} deviation, {unit}", f"({off:.1f})")


def _each(values: Sequence[float | None], digits: int) -> list[str]:
    return ["-" if value is None else f"{value:.{digits}f}" for value in values]


def _in_columns(cells: str | Sequence[str], width: int) -> str:
    """Return robots' cells in columns of their own; words as they are."""
    return cells if isinstance(cells, str) else " ".join(f"{cell:>{width}}" for cell in cells)


def _health(s: Summary) -> Iterator[_Row]:
    if s["min_gap_mm"] is not None:
        yield _Row("smallest body gap, mm", f"{s['min_gap_mm']:.0f}")
    if s.get("min_obstacle_gap_mm") is not None:
        yield _Row("smallest gap to an obstacle, mm", f"{s['min_obstacle_gap_mm']:.0f}")
    if s["pose_error"] is not None:
        p = s["pose_error"]
        yield _Row("pose error, rms mm, deg", f"{p['rms_mm']:.2f}, {p['heading_rms_deg']:.2f}")
    tracker, tick = s["tracker"], s["tick"]
    if tracker["frames"]:
        note = f"{tracker['frames']} images, {tracker['frame_ms']['p50']:.1f} ms each"
        yield _Row("tags found, %", f"{100 * tracker['measured_fraction']:.1f}", each=note)
    if tick["compute_us"] is not None:
        value = f"{tick['compute_us']['p50']:.0f}, {tick['compute_us']['p99']:.0f}"
        yield _Row("computing a tick, us", value, each=f"of {tick['period_ms'] * 1e3:g}")
    if tick["overruns"] is not None:
        yield _Row("overruns", str(tick["overruns"]), each=f"of {s['ticks']} ticks")
    if s["latency_ms"] is not None:
        latency = s["latency_ms"]["exposure_to_wheel"]
        yield _Row("exposure to wheel, ms", f"{latency['p50']:.1f}, {latency['p99']:.1f}")


def _stops(stops: Sequence[dict[str, Any]]) -> Iterator[str]:
    every = fleet_stops(stops)
    own = [stop for stop in every if not stop.by_operator]
    if own:
        yield f"{how_many(own)}:"
        yield from (f"    {stop}" for stop in own[:_SHOWN_STOPS])
        if len(own) > _SHOWN_STOPS:
            yield f"    and {len(own) - _SHOWN_STOPS} more: the report lists all of them"
    yield from (f"The operator stopped {stop}" for stop in every if stop.by_operator)


def proofs_table(title: str, rows: Sequence[tuple[str, ...]]) -> Fitting:
    """Return what was proved before a run: (what, value, limit, how much of it is used)."""
    columns = ("", "value", "limit", "used")

    def make(left_out: Sequence[str]) -> Table:
        table = Table(title=Text(title, "italic"), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
        kept = [column for column in columns if column not in left_out]
        for column in kept:
            table.add_column(column, justify="right" if column else "left", no_wrap=bool(column))
        table.columns[0].min_width = min(_PROOF_WIDTH, max(len(row[0]) for row in rows))
        for row in rows:
            table.add_row(*(Text(cell) for name, cell in zip(columns, row, strict=True) if name in kept))
        return table

    return Fitting(make, ("used",))


def status_table(status: dict[str, Any]) -> Group:
    """Return what a running arena says of itself: ``processes.operator.status``."""
    phase, cause = status["phase"] or "the supervisor is silent", status["cause"]
    title = Text(f"{status['arena']}: {phase}" + (f" ({cause})" if cause else ""), "bold")  # wider than its table
    caption = Text(f"{status['folder']}, since {status['started']}, process {status['pid']}", "dim")
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in ("robot", "gate", "latch", "battery", "heard", "halted"):
        table.add_column(column)
    for robot in status["robots"]:
        if robot["gate"] is None:
            table.add_row(robot["id"], Text("silent", "bold red"), "", "", "", Text(robot["halted"] or ""))
            continue
        battery = "unknown" if robot["battery"] is None else f"{100 * robot['battery']:.0f} %"
        gate = Text(robot["gate"], "green" if robot["gate"] == "open" else "yellow")
        latch = Text(robot["latch"], "" if robot["latch"] == "none" else "bold red")
        table.add_row(robot["id"], gate, latch, battery, f"{robot['age_ms']:.0f} ms ago", Text(robot["halted"] or ""))
    return Group(title, table, caption)

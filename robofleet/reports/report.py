"""What a run says to a person: ``report.html`` and ``metrics.csv`` in its folder."""

import io
import os
import shlex
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import matplotlib as mpl
from matplotlib.figure import Figure

from robofleet.behaviours.described import JUDGED_FIGURES
from robofleet.config import groups
from robofleet.config.load import resolved_yaml
from robofleet.core.figures import STYLE
from robofleet.core.files import write_bytes
from robofleet.recording import sensors
from robofleet.recording.columns import CSV
from robofleet.recording.run import Recording, Run
from robofleet.recording.run_clock import time_words
from robofleet.reports import predicted
from robofleet.reports.bounds import JUDGED, JUDGED_KEYS, failures, is_judged, limit, unjudged
from robofleet.reports.canvas import Legend, Plot, RunView, add_legend
from robofleet.reports.own_figures import as_asked, heading, own_figures
from robofleet.reports.pages import Marked, Page, Tile
from robofleet.reports.plots import HAPPENED, sections
from robofleet.reports.stops import fleet_stops, how_many
from robofleet.reports.timeline import Timeline

Summary = dict[str, Any]

PAGE = "report.html"
_ENDS = {"fault": "Ended by a fault", "stopped": "Stopped"}
_WHO = {True: "the operator", False: "nobody"}
_TILES_A_GROUP = 6
_SHOWN_ENTRIES = 80  # of a table; a run that is worse shows its first ones


_METADATA: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same every time
_FILE_STYLE: Any = {**STYLE, "pdf.fonttype": 42}  # publishers refuse Type 3 fonts
_PAD_INCH = 0.03


def _figure_files(folder: Path, page: Path, plot: Plot, figure: Figure, legend: Legend) -> list[tuple[str, str]]:
    """Write a plot, which is given its legend, into a folder; returns (kind, address) of each file for a page.

    OSError if it cannot be.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if legend:
        add_legend(figure, legend)
    written = []
    for kind, metadata in _METADATA.items():
        buffer, file = io.BytesIO(), folder / f"{plot.file_name}.{kind}"
        with mpl.rc_context(_FILE_STYLE):
            figure.savefig(buffer, format=kind, metadata=metadata, bbox_inches="tight", pad_inches=_PAD_INCH, dpi=300)
        write_bytes(file, buffer.getvalue())
        written.append((kind.upper(), quote(os.path.relpath(file.resolve(), page.parent.resolve()))))
    return written


def write(run: Run, summary: Summary, folder: Path, figures: Path | None = None) -> Path:
    """Write the page into the run's folder, with what its sensors measured; returns the page's file.

    OSError if it cannot be. ``figures``: a folder for every plot as a file of its own, which the page links.
    """
    view, recording = RunView(run, summary), run.recording
    page = Page(summary["config"], _subtitle(summary))
    _verdict(page, recording, summary)
    if summary["ticks"]:
        page.tiles(tiles(summary))
        if summary["estimated"]:
            page.note(
                f"No true poses are known of {', '.join(summary['estimated'])}: their figures use measured poses."
            )
        _bounds(page, summary)
    if (every := run.every) > 1:
        page.note(
            f"This run is long. Curves, and the means of the groups' own figures, use every {every}th tick. "
            "All other figures, and the largest values, use every tick."
        )
    if (gap := predicted.load(folder)) is not None:
        predicted.section(page, gap)
    with mpl.rc_context(STYLE):
        _plots(page, view, None if figures is None else partial(_figure_files, figures, folder / PAGE))
    _stops(page, summary)
    _entries(page, view.timeline, summary)
    _robots(page, summary)
    _origin(page, recording, folder, linked=figures is not None)
    if recording.config.sensing:
        sensors.write_csv(recording, folder / sensors.CSV)
    page.write(folder / PAGE)
    return folder / PAGE


def _subtitle(summary: Summary) -> str:
    mode = {"lockstep": "lockstep, on a simulated clock", "realtime": "real time"}.get(summary["mode"], summary["mode"])
    robots = f"{len(summary['robots'])} robot{'s' * (len(summary['robots']) > 1)}"
    times = time_words(summary["duration_s"], summary["clock_duration_s"])
    text = f"{robots}, {times}, {summary['ticks']:,} ticks; {mode}; seed {summary['seed']}"
    began = summary["began"]
    return text if began is None else f"{began.removesuffix('Z').replace('T', ' ')} UTC; {text}"


def _verdict(page: Page, recording: Recording, summary: Summary) -> None:
    missed = failures(summary)
    good: bool | None = not missed and summary["outcome"] == "completed"
    if summary["outcome"] == "completed":
        count = len(summary["bounds"])
        sentence = f"Completed, {len(missed)} of {count} bounds not met" if missed else "Completed"
        sentence += ", every bound met" if count and not missed else ""
    else:
        ended = _ENDS.get(summary["outcome"], "How it ended was not recorded")
        sentence = ended if summary["ticks"] else "Did not start"
        sentence += f": {summary['cause']}" if summary["cause"] else ""
    lines = list(_stopped(summary)) if summary["ticks"] else ["The robots never drove: nothing was measured."]
    lines += missed
    if summary["ticks"] and (rest := unjudged(summary)):
        lines.append(rest)
    if not summary["bounds"]:
        lines.append("The configuration has no bounds: no figure was checked.")
    if (busy := summary["busy_machine"]) is not None:
        lines.append(busy["words"])
    lines += summary.get("remarks", [])
    if recording.trouble:
        lines.append(f"The recording is incomplete: the file {recording.trouble}.")
    if recording.dropped:
        lines.append(f"The recorder missed {recording.dropped:,} messages. They are missing in the figures, too.")
    page.verdict(sentence, good=good, detail="\n".join(lines))


def _stopped(summary: Summary) -> Iterator[str]:
    every = fleet_stops(summary["stops"])
    own = [stop for stop in every if not stop.by_operator]
    yield f"{how_many(own)}." if own else "No unrequested stop."
    yield from (f"The operator stopped {stop}." for stop in every if stop.by_operator)


def tiles(summary: Summary) -> list[Tile]:
    """Return the figures that are to be seen at a glance."""
    verdicts = {bound["figure"]: bound for bound in summary["bounds"]}
    found = []
    for name, figure in JUDGED.items():
        value, bound = figure.value_of(summary), verdicts.get(name)
        if (figure.own or figure.later) and value is None and bound is None:
            continue
        note = Marked("no bound", None)
        if bound is not None:
            limit = f"{'at least' if figure.at_least else 'at most'} {bound['limit']:g}"
            good = bound["pass"] if is_judged(summary, bound) else None
            note = Marked({True: "✓ ", False: "✗ ", None: ""}[good] + limit, good)
        shown = "–" if value is None else _short(value)
        found.append(Tile(figure.label, shown, figure.unit if value is not None else "not measured", note))
    return [*found, *_own_tiles(summary)]


def _own_tiles(summary: Summary) -> Iterator[Tile]:
    """Yield the groups' own figures that no bound judges."""
    for name, group in summary["groups"].items():
        suffix = f" of {name}" if len(summary["groups"]) > 1 else ""
        shown = [own for own in own_figures(group) if own.mean is not None and own.key not in JUDGED_KEYS]
        for own in shown[:_TILES_A_GROUP]:
            words = f"{own.label}, mean{suffix}" if own.each else f"{own.label}{suffix}"
            yield Tile(words, _short(own.mean or 0), own.unit, Marked("no bound", None))


def _short(value: float) -> str:
    """Return a number as it is read at a glance."""
    digits = 0 if isinstance(value, int) or abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def _bounds(page: Page, summary: Summary) -> None:
    if not summary["bounds"]:
        page.note("To have runs judged, add bounds to the configuration, for example:")
        has = {key for group in summary["groups"].values() for key in group}
        own = next((f"{figure.bound}: 1.0, " for figure in JUDGED_FIGURES if figure.key in has), "")
        page.listing(f"run:\n  bounds: {{{own}min_gap_mm: 10, stops: 0}}")
        return
    completed = summary["outcome"] == "completed"
    rest = "does not meet its bound" if completed else "was not checked: the run ended too early"
    gaps = any(bound["value"] is None for bound in summary["bounds"])
    page.section("Bounds", "The limits in run.bounds." + f" A figure that was not measured {rest}." * gaps)
    rows = []
    for bound in summary["bounds"]:
        verdict = Marked("✓ met", True) if bound["pass"] else Marked("✗ not met", False)
        verdict = verdict if is_judged(summary, bound) else Marked("not checked", None)
        label = JUDGED[bound["figure"]].label
        rows.append((label, verdict, bound["value"], limit(bound), f"run.bounds.{bound['figure']}"))
    page.table(("figure", "verdict", "value", "bound", "key"), rows)


def _plots(page: Page, view: RunView, files: Callable[[Plot, Figure, Legend], list[tuple[str, str]]] | None) -> None:
    ran = len(view.run.ticks) > 0
    for section, plots in (sections(view) if ran else HAPPENED).items():
        page.section(section)
        for plot in plots if ran else plots[:1]:
            figure = plot.draw(view)
            if figure is None:
                page.note(f"{plot.title}. {plot.missing}")
            else:
                legend = plot.legend(view)
                kept = tuple if files is None else partial(files, plot, figure, legend)
                page.figure(figure, plot.caption, title=plot.title, legend=legend, long=plot.long, files=kept)
        if not ran:
            page.note("The robots never drove: there is nothing more to show.")
            return


def _stops(page: Page, summary: Summary) -> None:
    every = fleet_stops(summary["stops"])
    if every:
        page.section(
            "Stops",
            "Robots that stopped together for one cause are one row. The last times are the longest of them, from the "
            "newest message that a driver received: until its target was zero, and until its output was zero.",
        )
        head = ("run time, s", "clock time, s", "robots", "cause", "requested by", "target zero, ms", "output zero, ms")
        rows = [
            (
                f"{stop.run_s:.2f}", f"{stop.clock_s:.2f}", ", ".join(stop.robots), stop.cause,
                _WHO[stop.by_operator], stop.target_ms, stop.output_ms,
            )
            for stop in every[:_SHOWN_ENTRIES]
        ]  # fmt: skip
        page.table(head, rows)


def _entries(page: Page, timeline: Timeline, summary: Summary) -> None:
    page.section("Events", "In order. Before the start the clock time is negative.")
    others = [entry for entry in timeline.entries if not entry.stop]
    rows = [(e.t_s, timeline.run_time_s(e), e.who, e.what) for e in others]
    rows += [(s.clock_s, s.run_s, ", ".join(s.robots), s.cause) for s in fleet_stops(summary["stops"])]
    rows.sort(key=lambda row: row[0])
    page.table(
        ("run time, s", "clock time, s", "who", "what"),
        [
            (None if run_s is None else f"{run_s:.2f}", f"{clock_s:.2f}", who, what)
            for clock_s, run_s, who, what in rows[:_SHOWN_ENTRIES]
        ],
    )
    if (more := len(rows) - _SHOWN_ENTRIES) > 0:
        page.note(f"And {more} more.")


def _robots(page: Page, summary: Summary) -> None:
    page.section("Robots", f"Means over the ticks that count: column counts of {CSV}.")
    own = [stop["robot"] for stop in summary["stops"] if not stop["by_operator"]]
    for name, group in summary["groups"].items():
        shown = [as_asked(group, figure) for figure in own_figures(group) if figure.each]
        columns = {figure.title: figure.each for figure in shown}
        rows = [
            (robot, *(values[k] for values in columns.values()), own.count(robot), summary["rejected"][robot])
            for k, robot in enumerate(group["robots"])
        ]
        if len(summary["groups"]) > 1:
            page.note(heading(name, group["behaviour"]))
        page.table(("robot", *columns, "unrequested stops", "messages refused"), rows)


def _origin(page: Page, recording: Recording, folder: Path, *, linked: bool) -> None:
    page.section("This run", f"{CSV} has every value of every tick. Replay the recording with today's code:")
    modules = " --behaviours DIR" if any(":" in name for name in groups.own(recording.config)) else ""
    page.listing(f"robofleet replay {shlex.quote(str(folder))}{modules}")
    if not linked:
        page.note("Write every plot as SVG and as PDF:")
        page.listing(f"robofleet report {shlex.quote(str(folder))} --figures figures")
    made = recording.provenance
    if made is not None:
        rows = [("processor", made.processor), ("architecture", made.architecture), *made.versions.items()]
        page.table(("made with", ""), [*rows, *((f"sha256 of {name}", value) for name, value in made.hashes.items())])
    page.listing(resolved_yaml(recording.config), folded="The whole configuration")

"""What a run says to a person: ``report.html`` and ``metrics.csv`` in its folder."""

import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl

from robofleet.clock import S
from robofleet.config.load import resolved_yaml
from robofleet.figures import STYLE
from robofleet.pages import Marked, Page, Tile
from robofleet.recording.bounds import JUDGED, failures
from robofleet.recording.canvas import View
from robofleet.recording.plots import SECTIONS
from robofleet.recording.run import Recording, Run
from robofleet.recording.series import CSV, series, write_csv
from robofleet.recording.timeline import Timeline

Summary = dict[str, Any]

PAGE = "report.html"
_ENDS = {"fault": "Ended by a fault", "stopped": "Stopped"}
_SHOWN = 80  # entries of a table; a run that is worse shows its first ones


def write(recording: Recording, summary: Summary, folder: Path) -> Path:
    """Write the page and the columns into the run's folder; returns the page's file. OSError if it cannot be."""
    view = view_of(recording, summary)
    page = Page(summary["config"], _subtitle(recording, summary))
    _verdict(page, recording, summary)
    if summary["ticks"]:
        page.tiles(_tiles(summary))
        if summary["estimated"]:
            page.note(
                f"No truth is known of {', '.join(summary['estimated'])}: their places are the filter's estimates."
            )
        _bounds(page, summary)
    with mpl.rc_context(STYLE):
        _plots(page, view)
    _stops(page, summary)
    _entries(page, view.timeline)
    _robots(page, summary)
    _origin(page, recording, folder)
    write_csv(view.series, folder / CSV)
    page.write(folder / PAGE)
    return folder / PAGE


def view_of(recording: Recording, summary: Summary) -> View:
    """Return what there is to draw of a run."""
    run = Run(recording)
    return View(recording, series(run), Timeline(run, summary["stops"]))


def _subtitle(recording: Recording, summary: Summary) -> str:
    mode = {"lockstep": "lockstep, on a simulated clock", "realtime": "real time"}.get(summary["mode"], summary["mode"])
    robots = f"{len(summary['robots'])} robot{'s' * (len(summary['robots']) > 1)}"
    said = f"{robots}, {summary['duration_s']:.1f} s, {summary['ticks']:,} ticks; {mode}; seed {summary['seed']}"
    made, ticks = recording.provenance, Run(recording).all_ticks
    if made is None or not made.epoch_ns or not len(ticks):
        return said
    began = datetime.fromtimestamp((made.epoch_ns + int(ticks["stamp_ns"][0])) // S, UTC)
    return f"{began:%Y-%m-%d %H:%M:%S} UTC; {said}"


def _verdict(page: Page, recording: Recording, summary: Summary) -> None:
    """Say what became of the run, and why."""
    missed, cause, stops = failures(summary), summary["cause"], len(summary["stops"])
    good: bool | None = not missed and summary["outcome"] == "completed"
    if summary["outcome"] == "completed":
        of = len(summary["bounds"])
        said = f"Completed, {len(missed)} of {of} bounds not met" if missed else "Completed"
        said += ", every bound met" if of and not missed else ""
    else:
        ended = _ENDS.get(summary["outcome"], "Nobody came to say how it ended")
        said = ended if summary["ticks"] else "Did not start"
        said += f": {cause}" if cause else ""
    if missed and not summary["ticks"]:
        missed = ["Nothing was measured."]
    lines = missed or ([] if summary["bounds"] else ["No bounds are configured: nothing was judged."])
    lines = [f"{stops} stop{'s' * (stops > 1)} of a robot on the way.", *lines] if stops else lines
    if recording.trouble:
        lines.append(f"The recording is not whole: the file {recording.trouble}.")
    if recording.dropped:
        lines.append(f"The recorder did not get {recording.dropped:,} messages: figures lack what they said.")
    page.verdict(said, good=good, detail="\n".join(lines) or "No robot was stopped on the way.")


def _tiles(summary: Summary) -> list[Tile]:
    verdicts = {bound["figure"]: bound for bound in summary["bounds"]}
    tiles = []
    for name, figure in JUDGED.items():
        value, bound = figure.of(summary), verdicts.get(name)
        note = Marked("no bound", None)
        if bound is not None:
            limit = f"{'at least' if figure.at_least else 'at most'} {bound['limit']:g}"
            note = Marked(f"✓ {limit}" if bound["pass"] else f"✗ {limit}", bound["pass"])
        shown = "–" if value is None else _short(value)
        tiles.append(Tile(figure.label, shown, figure.unit if value is not None else "not measured", note))
    return tiles


def _short(value: float) -> str:
    """Return a number as it is read at a glance."""
    digits = 0 if isinstance(value, int) or abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def _bounds(page: Page, summary: Summary) -> None:
    if not summary["bounds"]:
        page.note("To have runs judged, write bounds into the configuration, e.g.")
        page.listing("run:\n  bounds: {control_error_mean_mm: 1.0, spacing_max_deviation_mm: 12, stops: 0}")
        return
    page.section("Bounds", "What run.bounds asks for. A figure that was not measured has not met its bound.")
    rows = []
    for bound in summary["bounds"]:
        figure = JUDGED[bound["figure"]]
        limit = f"{'at least' if figure.at_least else 'at most'} {bound['limit']:g} {figure.unit}"
        verdict = Marked("✓ met", True) if bound["pass"] else Marked("✗ not met", False)
        rows.append((figure.label, verdict, bound["value"], limit, f"run.bounds.{bound['figure']}"))
    page.table(("figure", "", "value", "bound", "key"), rows)


def _plots(page: Page, view: View) -> None:
    ran = len(view.series.t) > 0
    for section, plots in SECTIONS.items():
        page.section(section)
        for plot in plots if ran else plots[:1]:
            figure = plot.draw(view)
            if figure is None:
                page.note(f"{plot.title}. {plot.missing}")
            else:
                page.figure(figure, plot.caption, title=plot.title, legend=plot.legend(view), long=plot.long)
        if not ran:
            page.note("The fleet was never running: there is nothing more to show.")
            return


def _stops(page: Page, summary: Summary) -> None:
    if summary["stops"]:
        page.section("Stops", "Times after the stop: from the newest word heard to a target, and to an output of zero.")
        rows = [
            (f"{s['t_s']:.2f}", s["robot"], s["cause"], s["target_ms"], s["output_ms"])
            for s in summary["stops"][:_SHOWN]
        ]
        page.table(("t, s", "robot", "cause", "target zero after, ms", "output zero after, ms"), rows)


def _entries(page: Page, timeline: Timeline) -> None:
    page.section("Events", "Everything that happened, in order; before the start at times below 0.")
    rows = [(f"{entry.t_s:.2f}", entry.who, entry.what) for entry in timeline.entries[:_SHOWN]]
    page.table(("t, s", "who", "what"), rows)
    if (more := len(timeline.entries) - _SHOWN) > 0:
        page.note(f"And {more} more.")


def _robots(page: Page, summary: Summary) -> None:
    page.section("Robots", "Means over the time that counts; spacing from the robot before.")
    errors = [
        summary[name]["per_robot_mean"] if summary[name] else [None] * len(summary["robots"])
        for name in ("control_error_mm", "timed_error_mm", "path_error_mm", "centre_error_mm")
    ]
    gaps = [None, *(summary["spacing_m"]["mean"] if summary["spacing_m"] else [None] * (len(summary["robots"]) - 1))]
    stops = [sum(stop["robot"] == robot for stop in summary["stops"]) for robot in summary["robots"]]
    rows = [
        (robot, *(error[k] for error in errors), gaps[k], stops[k], summary["rejected"][robot])
        for k, robot in enumerate(summary["robots"])
    ]
    units = "control error, mm", "timed error, mm", "off the path, mm", "centre off, mm", "spacing, m"
    page.table(("robot", *units, "stops", "messages refused"), rows)


def _origin(page: Page, recording: Recording, folder: Path) -> None:
    page.section("This run", f"Every value of every tick: {CSV}. To have today's code decide it all again:")
    page.listing(f"robofleet replay {shlex.quote(str(folder))}")
    made = recording.provenance
    if made is not None:
        rows = [("processor", made.processor), ("architecture", made.architecture), *made.versions.items()]
        page.table(("made with", ""), [*rows, *((f"sha256 of {name}", value) for name, value in made.hashes.items())])
    page.listing(resolved_yaml(recording.config), folded="The configuration, all of it")

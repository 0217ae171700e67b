"""The page of a sweep: which settings break, two settings together, one at a time, and how to replay what broke."""

from collections.abc import Sequence
from itertools import combinations, islice
from pathlib import Path

import matplotlib as mpl
import numpy as np

from robofleet.config.load import spelled
from robofleet.core.clock import utc_now
from robofleet.core.figures import STYLE
from robofleet.reports.pages import Marked, Page, Tile
from robofleet.studies.sweep import plots
from robofleet.studies.sweep.factors import Factor, Measure, factors, measures, unmeasured
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.table import TIMES, Ending, Ran

FILE = "sweep.html"
_DRAWN_PAIRS = 6  # of settings
_LISTED_RUNS = 50


def write(study: Study, runs: Sequence[Ran], folder: Path, files: Sequence[Path]) -> Path:
    endings = np.array([ran.ending for ran in runs])
    page = Page(study.name, _subtitle(study, runs))
    _verdict(page, runs, endings)
    known, varied = measures(runs), factors(study)
    page.tiles(_tile(measure, runs) for measure in [*known, *unmeasured(runs)])
    shown = [measure for measure in known if measure.varies][: plots.MOST]
    with mpl.rc_context(STYLE):
        _breaking(page, varied, endings)
        _plots(page, varied, shown, endings)
    _broken(page, runs, endings)
    _origin(page, study, runs, files)
    page.write(folder / FILE)
    return folder / FILE


def _subtitle(study: Study, runs: Sequence[Ran]) -> str:
    seeds = len({run.plan.seed for run in runs})
    parts = [f"{len(runs):,} runs of {study.config}", f"{seeds} seed{'s' * (seeds > 1)}", _modes(study)]
    return f"{utc_now():%Y-%m-%d %H:%M:%S} UTC; {', '.join(parts)}"


def _modes(study: Study) -> str:
    modes = dict.fromkeys(run.mode.replace("_", " ") for run in study.runs)
    return "in " + ", ".join("an environment" if mode == "environment" else mode for mode in modes)


def _verdict(page: Page, runs: Sequence[Ran], endings: plots.Endings) -> None:
    met, not_judged, missed, fault = (int((endings == ending).sum()) for ending in Ending)
    completed = f"{len(runs) - fault:,} of {len(runs):,}" if fault else f"All {len(runs):,}"
    lines = [f"{fault:,} did not: the commands that replay them are below."] if fault else []
    if missed:
        lines.append(f"{missed:,} completed and missed a bound.")
    if not_judged:
        lines.append(f"{not_judged:,} completed and missed no bound, but not every bound was checked: see below.")
    if met and not missed and not not_judged and any(ran.played and ran.played.summary["bounds"] for ran in runs):
        lines.append("Every run that completed met its bounds.")
    page.verdict(
        f"{completed} runs completed", good=not fault and not missed and not not_judged, detail="\n".join(lines)
    )


def _tile(measure: Measure, runs: Sequence[Ran]) -> Tile:
    lacking = int(np.isnan(measure.values).sum())
    if lacking == len(runs):
        lacks = f"not measured in any run, not checked; bound {measure.limit:g}"
        return Tile(measure.label, "–", "", Marked(lacks, None))
    worst = measure.values[measure.worst]
    good = None
    if measure.limit is not None:
        good = bool(worst >= measure.limit if measure.at_least else worst <= measure.limit)
    word = "smallest" if measure.at_least else "largest"
    note = f"{word} {_short(worst)}, run {runs[measure.worst].plan.number}"
    if measure.limit is not None:
        note = f"{'✓' if good else '✗'} {note}; bound {measure.limit:g}"
        note += f"; not measured in {lacking:,} of {len(runs):,} runs" if lacking else ""
    median = _short(float(np.nanmedian(measure.values)))
    return Tile(f"{measure.label}, median", median, measure.unit, Marked(note, good))


def _short(value: float) -> str:
    digits = 0 if abs(value) >= 100 or value == int(value) else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def _breaking(page: Page, varied: Sequence[Factor], endings: plots.Endings) -> None:
    page.section("Which settings break")
    if not (endings != Ending.MET).any():
        page.note("None: every run completed and met its bounds.")
        return
    caption = "How the runs with each value ended, whatever their other settings were."
    page.figure(plots.breaking(varied, endings), caption, legend=plots.ENDINGS, long=True)


def _plots(page: Page, varied: Sequence[Factor], shown: Sequence[Measure], endings: plots.Endings) -> None:
    if not shown:
        page.note("No figure differs between the runs: there is nothing to plot.")
        return
    if len(varied) > 1:
        page.section("Two settings together", "Each cell is the median of its runs.")
        for left, other in islice(combinations(varied, 2), _DRAWN_PAIRS):
            across, up = (left, other) if len(left) >= len(other) else (other, left)
            figure = plots.together(across, up, shown, endings)
            page.figure(figure, f"{up.key} over {across.key}.", title=f"{across.name} and {up.name}")
    page.section("One setting at a time", "A box holds half of the runs, its line is the median; a point is a run.")
    legend = [plots.ENDINGS[ending] for ending in Ending if ending and (endings == ending).any()]
    for factor in varied:
        figure = plots.alone(factor, shown, endings)
        page.figure(figure, f"Every figure over {factor.key}.", title=factor.name, legend=legend)


def _broken(page: Page, runs: Sequence[Ran], endings: plots.Endings) -> None:
    for ending, title, text in (
        (Ending.BROKEN, "Runs that did not complete", "Each with the command that replays it, bit for bit here."),
        (Ending.MISSED, "Runs that missed a bound", "They completed. The commands replay them."),
        (Ending.NOT_JUDGED, "Runs that were not checked by every bound", "They completed and missed no bound."),
    ):
        found = [ran for ran, own in zip(runs, endings, strict=True) if own == ending]
        if not found:
            continue
        page.section(title, text)
        rows = [
            (ran.plan.number, _settings(ran), ran.plan.seed, ran.cause or "; ".join([*ran.missed, *ran.not_judged]))
            for ran in found[:_LISTED_RUNS]
        ]
        page.table(("run", "settings", "seed", "what happened"), rows)
        page.listing("\n".join(f"# run {ran.plan.number}\n{ran.plan.replay}" for ran in found[:_LISTED_RUNS]))
        if (more := len(found) - _LISTED_RUNS) > 0:
            page.note(f"And {more:,} more: the table of all runs has them.")


def _settings(ran: Ran) -> str:
    settings = [f"{key}={spelled(value)}" for key, value in ran.plan.values.items()]
    return ", ".join([*settings, *([f"faults {ran.plan.faults}"] if ran.plan.faults else [])])


def _origin(page: Page, study: Study, runs: Sequence[Ran], files: Sequence[Path]) -> None:
    page.section("This sweep", f"All figures of all runs: {', '.join(file.name for file in files)}.")
    played = [ran.played for ran in runs if ran.played is not None]
    if played:
        cpu, lockstep = (np.array([getattr(result, name) for result in played]) for name in ("cpu_s", "lockstep_s"))
        page.note(
            f"A run took {np.median(cpu):.2f} s of CPU time (median), {100 * lockstep.sum() / cpu.sum():.0f} % of all "
            f"was in lockstep's steps. All runs took {cpu.sum():.0f} s. {TIMES} has the time of each run."
        )
    try:
        page.listing(study.file.read_text(), folded=f"The sweep, {study.file}")
    except OSError:  # it is gone: the table has what matters
        page.note(f"The sweep's file, {study.file}, cannot be read any more.")
    commands = (f"{run.plan.replay}  # run {run.plan.number}" for run in runs)
    page.listing("\n".join(commands), folded="The command of every run")

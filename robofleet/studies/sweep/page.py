"""The page of a sweep: which settings break, two settings together, one at a time, and how to replay what broke."""

from collections.abc import Sequence
from itertools import combinations, islice
from pathlib import Path

import matplotlib as mpl
import numpy as np

from robofleet.clock import utc_now
from robofleet.config.load import spelled
from robofleet.figures import STYLE
from robofleet.pages import Marked, Page, Tile
from robofleet.studies.sweep import plots
from robofleet.studies.sweep.factors import Factor, Measure, factors, measures
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.table import TIMES, Ran

FILE = "sweep.html"
_PAIRS = 6  # of settings that are drawn
_SHOWN = 50  # runs of a list


def write(study: Study, runs: Sequence[Ran], folder: Path, files: Sequence[Path]) -> Path:
    """Write the page; returns its file. OSError if it cannot be."""
    kinds = np.array([_kind(ran) for ran in runs])
    page = Page(study.name, _subtitle(study, runs))
    _verdict(page, runs, kinds)
    known, varied = measures(runs), factors(study)
    page.tiles(_tile(measure, runs) for measure in known)
    shown = [measure for measure in known if measure.varies][: plots.MOST]
    with mpl.rc_context(STYLE):
        _breaking(page, varied, kinds)
        _plots(page, varied, shown, kinds)
    _broken(page, runs, kinds)
    _origin(page, study, runs, files)
    page.write(folder / FILE)
    return folder / FILE


def _kind(ran: Ran) -> int:
    """Return which of plots.KINDS a run is of."""
    return 2 if ran.outcome != "completed" else 1 if ran.missed else 0


def _subtitle(study: Study, runs: Sequence[Ran]) -> str:
    seeds = len({run.plan.seed for run in runs})
    said = [f"{len(runs):,} runs of {study.config}", f"{seeds} seed{'s' * (seeds > 1)}", "in lockstep"]
    return f"{utc_now():%Y-%m-%d %H:%M:%S} UTC; {', '.join(said)}"


def _verdict(page: Page, runs: Sequence[Ran], kinds: plots.Kinds) -> None:
    fine, missed, fault = (int((kinds == kind).sum()) for kind in range(3))
    said = f"{len(runs) - fault:,} of {len(runs):,} runs completed" if fault else f"All {len(runs):,} runs completed"
    lines = [f"{fault:,} did not: the commands that replay them are below."] if fault else []
    if missed:
        lines.append(f"{missed:,} completed and did not meet a bound.")
    if not missed and any(ran.played is not None and ran.played.summary["bounds"] for ran in runs) and fine:
        lines.append("Every run that completed met its bounds.")
    page.verdict(said, good=not fault and not missed, detail="\n".join(lines))


def _tile(measure: Measure, runs: Sequence[Ran]) -> Tile:
    worst = measure.values[measure.worst]
    good = None
    if measure.limit is not None:
        good = bool(worst >= measure.limit if measure.at_least else worst <= measure.limit)
    word = "smallest" if measure.at_least else "largest"
    note = f"{word} {_short(worst)}, run {runs[measure.worst].plan.number}"
    if measure.limit is not None:
        note = f"{'✓' if good else '✗'} {note}; bound {measure.limit:g}"
    return Tile(
        f"{measure.label}, median", _short(float(np.nanmedian(measure.values))), measure.unit, Marked(note, good)
    )


def _short(value: float) -> str:
    digits = 0 if abs(value) >= 100 or value == int(value) else 1 if abs(value) >= 10 else 2
    return f"{value:,.{digits}f}"


def _breaking(page: Page, varied: Sequence[Factor], kinds: plots.Kinds) -> None:
    page.section("Which settings break")
    if not kinds.any():
        page.note("None: every run completed and met its bounds.")
        return
    caption = "How the runs with each value ended, whatever their other settings were."
    page.figure(plots.breaking(varied, kinds), caption, legend=plots.KINDS, long=True)


def _plots(page: Page, varied: Sequence[Factor], shown: Sequence[Measure], kinds: plots.Kinds) -> None:
    if not shown:
        page.note("No figure differs between the runs: there is nothing to plot.")
        return
    if len(varied) > 1:
        page.section("Two settings together", "Each cell is the median of its runs.")
        for one, other in islice(combinations(varied, 2), _PAIRS):
            across, up = (one, other) if len(one) >= len(other) else (other, one)
            figure = plots.together(across, up, shown, kinds)
            page.figure(figure, f"{up.key} over {across.key}.", title=f"{across.name} and {up.name}")
    page.section("One setting at a time", "A box holds half of the runs, its line is the median; a point is a run.")
    legend = [(label, colour) for kind, (label, colour) in enumerate(plots.KINDS) if kind and (kinds == kind).any()]
    for factor in varied:
        page.figure(
            plots.alone(factor, shown, kinds), f"Every figure over {factor.key}.", title=factor.name, legend=legend
        )


def _broken(page: Page, runs: Sequence[Ran], kinds: plots.Kinds) -> None:
    for kind, title, text in (
        (2, "Runs that did not complete", "Each with the command that replays it, bit for bit on this machine."),
        (1, "Runs that did not meet a bound", "They completed. The commands replay them."),
    ):
        found = [ran for ran, own in zip(runs, kinds, strict=True) if own == kind]
        if not found:
            continue
        page.section(title, text)
        rows = [
            (ran.plan.number, _settings(ran), ran.plan.seed, ran.cause or "; ".join(ran.missed))
            for ran in found[:_SHOWN]
        ]
        page.table(("run", "settings", "seed", "what happened"), rows)
        page.listing("\n".join(f"# run {ran.plan.number}\n{ran.plan.replay}" for ran in found[:_SHOWN]))
        if (more := len(found) - _SHOWN) > 0:
            page.note(f"And {more:,} more: the table of all runs has them.")


def _settings(ran: Ran) -> str:
    settings = [f"{key}={spelled(value)}" for key, value in ran.plan.values.items()]
    return ", ".join([*settings, *([f"faults {ran.plan.faults}"] if ran.plan.faults else [])])


def _origin(page: Page, study: Study, runs: Sequence[Ran], files: Sequence[Path]) -> None:
    page.section("This sweep", f"All figures of all runs: {', '.join(file.name for file in files)}.")
    played = [ran.played for ran in runs if ran.played is not None]
    if played:
        cpu, lockstep = (np.array([getattr(one, name) for one in played]) for name in ("cpu_s", "lockstep_s"))
        page.note(
            f"A run took {np.median(cpu):.2f} s of a processor (median), {100 * np.median(lockstep / cpu):.0f} % of it "
            f"in lockstep's steps, and all of them {cpu.sum():.0f} s; {TIMES} has each run's."
        )
    try:
        page.listing(study.file.read_text(), folded=f"The sweep, {study.file}")
    except OSError:  # it is gone: the table has what matters
        page.note(f"The sweep's file, {study.file}, cannot be read any more.")
    page.listing(
        "\n".join(f"{run.plan.replay}  # run {run.plan.number}" for run in runs), folded="The command of every run"
    )

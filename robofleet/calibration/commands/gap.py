"""``robofleet gap``: how far the simulation is from recorded runs."""

import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration.commands.shared import ConfigsRobots, ReportFile, report_file, show
from robofleet.calibration.robots import gap as gaps
from robofleet.calibration.robots import gap_curve
from robofleet.calibration.robots import results as robot_files
from robofleet.calibration.robots.gap_curve import Day
from robofleet.calibration.store import CalibrationError
from robofleet.config.tree import Config
from robofleet.core.files import write_text
from robofleet.recording.reading import about, file_of, read
from robofleet.recording.run import Run
from robofleet.reports import after, predicted
from robofleet.reports.commands import ReplayedModules, load_behaviours, needed, readable
from robofleet.reports.predicted import Gap
from robofleet.runs.folder import chosen
from robofleet.runs.lockstep import Lockstep

Runs = Annotated[
    list[Path] | None,
    typer.Argument(metavar="RUN...", help="Runs' folders, or their run.mcap. Default: the newest in runs/."),
]


def gap(
    runs: Runs = None,
    configs: ConfigsRobots = Path("configs"),
    behaviours: ReplayedModules = None,
    report: ReportFile = None,
) -> None:
    """Compare recorded runs with their simulation.

    The simulation uses the same configuration and seed, and the robots that `robofleet identify` found. It compares
    predictions from the same commands, and the figures of both runs. The gap is the worst ratio; the bound
    run.bounds.gap limits it. The run's report gets a section. Several runs give a curve over days, with a page that
    names robots whose predictions became worse. Runs that were compared with the same files before are not simulated
    again. Exit code 1: a gap is above its bound. Your own behaviours are imported only from the folder that you name.

    $ robofleet gap runs/20260102T030405Z-platoon --configs configs

    $ robofleet gap runs/*-platoon --configs configs
    """
    several = list(runs or ()) or [chosen(None)]
    if len(several) == 1:
        missed = _one(several[0], configs, behaviours)
    else:
        missed = _curve(several, configs, behaviours, report_file(report, "gap"))
    if missed:
        raise typer.Exit(1)


def _one(run: Path, configs: Path, behaviours: Path | None) -> bool:
    """Show a run's gap; return whether its bound is not met."""
    found, config = _measured(run, configs, behaviours)
    rows: list[tuple[str, ...]] = [
        (each.name, each.unit, f"{each.recorded:.3g}", f"{each.simulated:.3g}", f"{each.ratio:.2f}",
         f"{each.low:.2f} to {each.high:.2f}")
        for each in sorted(found.figures, key=lambda each: -each.ratio)
    ]  # fmt: skip
    show((("figure", "unit", "observed", "predicted", "ratio", "95 %"), rows))
    for robot in found.not_identified:
        file = _file(configs, robot)
        print(f"{robot}: {file} has no `simulated`: it was simulated as its vehicle: robofleet identify {run}")
    print(f"gap: {found.worst.ratio:.2f} ({found.worst.name})")
    print(after.report(run).page)
    return _missed(found, config)


def _curve(runs: Sequence[Path], configs: Path, behaviours: Path | None, page: Path) -> bool:
    """Show the gap of several runs; return whether a bound is not met."""
    days, missed = [], False
    for run in runs:
        with readable():
            config = about(run).config
        found = predicted.load(file_of(run).parent)
        if found is None or found.reference != _reference(config, configs):
            found, _ = _measured(run, configs, behaviours)
            after.report(run)
        summary = after.stored(run) or {}
        days.append(Day(file_of(run).parent.name, str(summary.get("began") or "-"), found))
        missed |= _missed(found, config)
    show(gap_curve.table(days))
    for line in gap_curve.worn(days) or ["no robot's predictions grew worse"]:
        print(line)
    gap_curve.page(days).write(page)
    print(page)
    return missed


def _measured(run: Path, configs: Path, behaviours: Path | None) -> tuple[Gap, Config]:
    """Simulate a run, compare, and keep the gap beside it."""
    with readable():
        recorded = read(run, partial(needed, run, behaviours))
        recorded.config = load_behaviours(run, recorded.config, behaviours)
    too_short = CalibrationError(f"{run}: it is too short to compare: record some seconds of driving")
    if not len(Run(recorded).ticks):
        raise too_short
    known = [robot_files.earlier(_file(configs, robot.id), robot.id) for robot in recorded.config.members]
    simulation = Lockstep(gaps.simulated(recorded.config, recorded, known))
    outcome, cause = simulation.run()
    if outcome != "completed":
        raise CalibrationError(f"{run}: its simulation did not come to its end: {cause}")
    figures, robots = gaps.figures(recorded, simulation.recording)
    if not figures:
        raise too_short
    found = Gap(
        figures=figures, robots=robots, reference=_reference(recorded.config, configs),
        not_identified=tuple(each.robot for each in known if each.simulated is None),
    )  # fmt: skip
    write_text(file_of(run).parent / predicted.FILE, found.model_dump_json(indent=1) + "\n")
    return found, recorded.config


def _missed(found: Gap, config: Config) -> bool:
    limit = config.run.bounds.gap
    return limit is not None and found.worst.ratio > limit


def _file(configs: Path, robot: str) -> Path:
    return configs / "robots" / f"{robot}.yaml"


def _reference(config: Config, configs: Path) -> dict[str, str]:
    """Return the hash of each robot's file, where there is one."""
    files = {robot.id: _file(configs, robot.id) for robot in config.members}
    return {
        robot: hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest()
        for robot, file in files.items()
        if file.is_file()
    }

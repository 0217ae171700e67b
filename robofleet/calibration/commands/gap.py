"""``robofleet gap``: how far the simulation is from a recorded run."""

from functools import partial
from pathlib import Path

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robofleet.calibration.commands.shared import ConfigsRobots
from robofleet.calibration.robots import gap as gaps
from robofleet.calibration.robots import results as robot_files
from robofleet.calibration.store import CalibrationError
from robofleet.core.files import write_text
from robofleet.recording.reading import file_of, read
from robofleet.reports import after, predicted
from robofleet.reports.commands import ReplayedModules, RunFolder, load_behaviours, needed, readable
from robofleet.reports.predicted import Gap
from robofleet.runs.folder import chosen
from robofleet.runs.lockstep import Lockstep


def gap(run: RunFolder = None, configs: ConfigsRobots = Path("configs"), behaviours: ReplayedModules = None) -> None:
    """Compare a recorded run with its simulation.

    The simulation has the same configuration and seed, and the robots that `robofleet identify` found. Compared are
    predictions by the same commands, and the figures of both runs. The gap is the worst ratio; ``run.bounds.gap``
    limits it. The run's report gets a section. Exit code 1: the gap is above its bound. Your own behaviours are
    imported only from the folder that you name.

    $ robofleet gap runs/20260102T030405Z-platoon --configs configs
    """
    run = chosen(run)
    with readable():
        recorded = read(run, partial(needed, run, behaviours))
        recorded.config = load_behaviours(run, recorded.config, behaviours)
    files = {robot.id: configs / "robots" / f"{robot.id}.yaml" for robot in recorded.config.members}
    known = [robot_files.earlier(file, robot) for robot, file in files.items()]
    not_identified = tuple(each.robot for each in known if each.simulated is None)
    simulation = Lockstep(gaps.simulated(recorded.config, recorded, known))
    outcome, cause = simulation.run()
    if outcome != "completed":
        raise CalibrationError(f"{run}: its simulation did not come to its end: {cause}")
    figures = tuple(gaps.figures(recorded, simulation.recording))
    if not figures:
        raise CalibrationError(f"{run}: it is too short to compare: record some seconds of driving")
    found = Gap(figures=figures, not_identified=not_identified)
    folder = file_of(run).parent
    write_text(folder / predicted.FILE, found.model_dump_json(indent=1) + "\n")
    shown = Table("figure", "unit", "observed", "predicted", "ratio", "95 %")
    for each in sorted(found.figures, key=lambda each: -each.ratio):
        cells = each.name, each.unit, f"{each.recorded:.3g}", f"{each.simulated:.3g}", f"{each.ratio:.2f}"
        shown.add_row(*map(Text, (*cells, f"{each.low:.2f} to {each.high:.2f}")))
    Console().print(shown)
    for robot in not_identified:
        print(f"{robot}: {files[robot]} has no `simulated`: it was simulated as its vehicle: robofleet identify {run}")
    print(f"gap: {found.worst.ratio:.2f} ({found.worst.name})")
    page = after.report(run)
    print(page.page)
    missed = [bound for bound in page.summary["bounds"] if bound["figure"] == "gap" and not bound["pass"]]
    if missed:
        raise typer.Exit(1)

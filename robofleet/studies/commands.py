"""The commands of many runs: ``storm`` and ``sweep``."""

import shlex
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from robofleet.core.clock import S, WallClock
from robofleet.core.refusal import how_to_install
from robofleet.core.valid_json import dumps
from robofleet.nodes.controller import compile_kernels
from robofleet.operator.terminal.terminal import hangup_interrupts
from robofleet.runs import folder as folders
from robofleet.runs.check import load_checked
from robofleet.runs.folder import DEFAULT_FOLDER
from robofleet.studies import cluster
from robofleet.studies.engine import Engine, Local
from robofleet.studies.progress import bar
from robofleet.studies.storm import report as storm_report
from robofleet.studies.storm import tally as storms
from robofleet.studies.storm.episode import Episode
from robofleet.studies.sweep import journal, page, table
from robofleet.studies.sweep import report as sweep_report
from robofleet.studies.sweep.journal import Journal
from robofleet.studies.sweep.load import Study, load
from robofleet.studies.sweep.table import Ran
from robofleet.studies.sweep.unit import play

Watch = Callable[[Ran], None]  # called after every run


def run(study: Study, engine: Engine, journal: Journal, watch: Watch) -> list[Ran]:
    """Play them, keep each in the journal, and return all runs by their numbers."""
    left = [run for run in study.runs if run.number not in journal.played]
    failures: dict[int, str] = {}
    if left:
        compile_kernels(left[0].config)  # once, on disk, before every worker wants the same
    in_real_time = [run for run in left if run.mode == "real_time"]  # by itself each: else it would miss ticks
    others = [run for run in left if run.mode != "real_time"]
    for runs, where in ((others, engine), (in_real_time, Local(1))):
        with closing(where.each(partial(play, study.config.stem), runs)) as results:
            for index, played, failure in results:
                plan = runs[index]
                if played is None:
                    failures[plan.number] = failure
                else:
                    journal.add(plan.number, played)
                watch(Ran(plan, played, failure))
    return [Ran(plan, journal.played.get(plan.number), failures.get(plan.number, "")) for plan in study.runs]


On = Annotated[
    str,
    typer.Option(
        "--on", metavar="ENGINE", help="Where the runs are computed: local, ray (this computer), or ray://HOST:PORT."
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Number of runs at the same time. Default: one for each processor."),
]


def storm(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A configuration (YAML) of simulated robots.")],
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="Number of runs with random faults.")],
    first: Annotated[int, typer.Option(metavar="K", min=0, help="First seed; the others follow.")] = 1,
    pixels: Annotated[
        bool, typer.Option("--pixels", help="Draw the camera's images and find tags in them: slower.")
    ] = False,
    on: On = "local",
    jobs: Jobs = None,
) -> None:
    """Test a configuration with random faults, in simulation.

    Every run is checked against rules that must always hold, for example that no two robots touch.

    $ robofleet storm configs/platoon.yaml --seeds 50

    A failure is printed with the command that repeats it.
    """
    source = "camera" if pixels else "truth"
    tree = load_checked(config, [f"tracker.source={source}"], None, lockstep=True)
    replay = f"robofleet storm {config}{' --pixels' if pixels else ''}"
    with hangup_interrupts(), cluster.opened(on, jobs) as where:
        started_ns = WallClock().now_ns()
        with bar("storm", seeds) as shown:

            def watch(_tally: storms.Tally, episode: Episode) -> None:
                shown.say(*storm_report.lines(episode, replay))
                shown.add(failed=bool(episode.violations))

            tally = storms.storm(tree, range(first, first + seeds), where, watch)
    if not storm_report.summarise(tally, (WallClock().now_ns() - started_ns) / S):
        raise typer.Exit(1)


def sweep(
    sweep: Annotated[
        Path,
        typer.Argument(
            metavar="SWEEP", help="File (YAML) with a configuration and what varies; configs/sweeps has examples."
        ),
    ],
    on: On = "local",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help=f"Folder for the results. {DEFAULT_FOLDER}")] = None,
    jobs: Jobs = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Run a configuration many times, with settings varied.

    Runs are simulated. It varies keys, seeds and faults, and writes a table and a page into a folder.

    $ robofleet sweep configs/sweeps/gains.yaml --out gains

    All runs are checked before the first one starts. After Ctrl-C the same command with the same --out continues. Exit
    code 1: a run did not complete; it is printed with the command that repeats it.
    """
    folder = out or folders.new(sweep.stem)
    with hangup_interrupts():
        study = load(sweep, lambda total: bar("checks", total))
        with cluster.opened(on, jobs) as where, journal.opened(folder, study) as kept:
            try:
                with bar("sweep", len(study.runs), len(kept.played)) as shown:

                    def watch(ran: table.Ran) -> None:
                        shown.say(*sweep_report.lines(ran, shown.failed))
                        shown.add(failed=ran.outcome != "completed")

                    runs = run(study, where, kept, watch)
            except KeyboardInterrupt:
                again = shlex.join(["robofleet", "sweep", str(sweep), "--on", on, "--out", str(folder)])
                done = f"{len(kept.played):,} of {len(study.runs):,} runs are kept"
                print(f"interrupted: {done}; to go on: {again}", file=sys.stderr)
                raise typer.Exit(1) from None
    files = table.write(study, runs, folder)
    if not any(file.name == table.PARQUET for file in files):
        print(f"there is no {table.PARQUET}, it needs pyarrow: {how_to_install('sweep')}", file=sys.stderr)
    files.append(page.write(study, runs, folder, files))
    if as_json:
        print(dumps(sweep_report.as_json(study, runs, folder)))
    else:
        sweep_report.summarise(study, runs, files)
    if any(ran.outcome != "completed" for ran in runs):
        raise typer.Exit(1)

"""The commands of many runs: ``storm`` and ``sweep``."""

import shlex
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from robofleet.core.clock import S, WallClock, utc_now
from robofleet.core.refusal import how_to_install
from robofleet.core.valid_json import dumps
from robofleet.nodes.controller import compile_kernels
from robofleet.operator.terminal.terminal import hangup_interrupts
from robofleet.runs.check import load_checked
from robofleet.studies import cluster
from robofleet.studies.engine import Engine
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
    with closing(engine.each(partial(play, study.config.stem), [run.config for run in left])) as results:
        for index, played, failure in results:
            plan = left[index]
            if played is None:
                failures[plan.number] = failure
            else:
                journal.add(plan.number, played)
            watch(Ran(plan, played, failure))
    return [Ran(plan, journal.played.get(plan.number), failures.get(plan.number, "")) for plan in study.runs]


On = Annotated[
    str,
    typer.Option(
        "--on", metavar="ENGINE", help="Where the runs are played: local, ray (this machine), or ray://HOST:PORT."
    ),
]
Jobs = Annotated[int | None, typer.Option(metavar="N", min=1, help="How many at once; default: one a processor.")]


def storm(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A configuration of simulated robots.")],
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="How many random storms.")],
    first: Annotated[int, typer.Option(metavar="K", min=0, help="The first seed.")] = 1,
    pixels: Annotated[bool, typer.Option("--pixels", help="Render the camera's images: slower.")] = False,
    on: On = "local",
    jobs: Jobs = None,
) -> None:
    """Fuzz a simulated fleet with random faults, in lockstep, and check what must always hold.

    $ robofleet storm configs/platoon.yaml --seeds 50

    A failure is printed with the command that plays its seed again.
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
    sweep: Annotated[Path, typer.Argument(metavar="SWEEP", help="What varies: robofleet/studies describes the file.")],
    on: On = "local",
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-<sweep name>. The same again goes on.")
    ] = None,
    jobs: Jobs = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Run a configuration many times in lockstep, with keys, seeds and faults varied: a table and a page in DIR.

    $ robofleet sweep configs/sweeps/gains.yaml --out gains

    Every run is checked before the first one starts. Ctrl-C keeps what is finished; the same command with the same
    --out goes on from there. Exit 1: some run did not complete, and is named with the command that replays it.
    """
    folder = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{sweep.stem}"
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

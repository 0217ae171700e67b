"""The commands that need no laboratory: the paper's experiments, and storms of faults in simulation."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.clock import S, WallClock, utc_now
from robofleet.processes.refusal import RefusedError, bad_input, new_folder
from robofleet.valid_json import dumps

app = typer.Typer()


@app.command()
def paper(
    experiment: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="memoryless, stability, closed-curve, lane-change, platoon, comparison, or all.",
        ),
    ] = "all",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-paper.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as one JSON object.")] = False,
) -> None:
    """Reproduce the paper's experiments: tables beside the paper's, figures and numbers in DIR.

    $ robofleet paper lane-change
    """
    from robofleet.experiments import paper as experiments  # noqa: PLC0415

    with bad_input():
        try:
            names = experiments.chosen(experiment)
        except ValueError as error:
            raise RefusedError(str(error)) from error
        parameters = {name: experiments.parameters_of(name) for name in names}
        folder = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-paper"
        new_folder(folder)
    try:
        contents = {name: experiments.report(name, parameters[name], folder, quiet=as_json) for name in names}
    except experiments.ExperimentError as error:
        print(error, file=sys.stderr)
        raise typer.Exit(1) from error
    if as_json:
        print(dumps({"folder": str(folder), "experiments": contents}))
    else:
        print(folder)


@app.command()
def storm(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A configuration of simulated robots.")],
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="How many random storms.")],
    first: Annotated[int, typer.Option(metavar="K", min=0, help="The first seed.")] = 1,
    pixels: Annotated[bool, typer.Option("--pixels", help="Render the camera's images: slower.")] = False,
) -> None:
    """Fuzz a simulated fleet with random faults, in lockstep, and check what must always hold.

    $ robofleet storm configs/platoon.yaml --seeds 50

    A failure is printed with the command that plays its seed again.
    """
    from robofleet.processes.check import load_checked  # noqa: PLC0415

    source = "camera" if pixels else "truth"
    with bad_input():
        tree = load_checked(config, [f"tracker.source={source}"], None, lockstep=True)
    from robofleet.processes.storm import report, workers  # noqa: PLC0415

    replay = f"robofleet storm {config}{' --pixels' if pixels else ''}"
    started_ns = WallClock().now_ns()
    with report.progress(seeds, replay) as watch:
        tally = workers.storm(tree, range(first, first + seeds), watch)
    if not report.summarise(tally, (WallClock().now_ns() - started_ns) / S):
        raise typer.Exit(1)

"""The commands of many runs."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.clock import S, WallClock
from robofleet.processes.refusal import bad_input

app = typer.Typer()


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
    from robofleet.studies.storm import report, workers  # noqa: PLC0415

    replay = f"robofleet storm {config}{' --pixels' if pixels else ''}"
    started_ns = WallClock().now_ns()
    with report.progress(seeds, replay) as watch:
        tally = workers.storm(tree, range(first, first + seeds), watch)
    if not report.summarise(tally, (WallClock().now_ns() - started_ns) / S):
        raise typer.Exit(1)

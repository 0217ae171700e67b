"""The command of the paper's experiments."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.core.clock import utc_now
from robofleet.core.refusal import RefusedError, new_folder
from robofleet.core.valid_json import dumps


def paper(
    experiment: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="memoryless, stability, closed-curve, lane-change, platoon, comparison, or all."
        ),
    ] = "all",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: runs/<UTC time>-paper.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as one JSON object.")] = False,
) -> None:
    """Reproduce the paper's experiments: tables beside the paper's, figures and numbers in DIR.

    $ robofleet paper lane-change
    """
    from robofleet.experiments import paper as experiments  # noqa: PLC0415

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

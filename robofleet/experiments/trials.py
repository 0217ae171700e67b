"""The command of the paper's experiments."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.core.refusal import RefusedError, new_folder
from robofleet.core.valid_json import dumps
from robofleet.runs import folder as folders
from robofleet.runs.folder import DEFAULT_FOLDER


def paper(
    experiment: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            help="memoryless, stability, closed-curve, lane-change, platoon, model-free, comparison, or all.",
        ),
    ] = "all",
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help=f"Folder for tables and figures. {DEFAULT_FOLDER}")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as one JSON object.")] = False,
) -> None:
    """Repeat an experiment of the paper.

    It prints tables with the paper's numbers beside the new ones, and writes figures and numbers into a folder. More
    experiments can go into the same folder.

    $ robofleet paper lane-change

    $ robofleet paper platoon --out results
    """
    from robofleet.experiments import paper as experiments  # noqa: PLC0415

    try:
        names = experiments.chosen(experiment)
    except ValueError as error:
        raise RefusedError(str(error)) from error
    parameters = {name: experiments.parameters_of(name) for name in names}
    folder = out or folders.new("paper")
    present = [name for name in experiments.EXPERIMENTS if (folder / f"{name}.json").is_file()]
    if again := [name for name in names if name in present]:
        raise RefusedError(f"--out: {folder} has {again[0]} already: name another folder")
    if not present:
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

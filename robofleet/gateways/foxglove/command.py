"""The command ``foxglove``, which `robofleet run --foxglove` starts, too."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from robofleet.gateways.foxglove.address import DEFAULT, Address
from robofleet.gateways.place import Place, run_of
from robofleet.processes.commands import OPERATOR, ArenaName, LifelineFd
from robofleet.processes.refusal import LAB_MODULES, bad_input, need_extra

app = typer.Typer()
_JOINS_WITHIN_S = 3.0  # a run that is on


@app.command(rich_help_panel=OPERATOR)
def foxglove(
    arena: ArenaName = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The run's configuration, if the arena is another computer's.")
    ] = None,
    at: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where viewers find it; beyond this computer by TLS.")
    ] = DEFAULT,
    lifeline: LifelineFd = None,
) -> None:
    """Show a run that is on in Foxglove or Lichtblick: all that its recording has, and an operator's buttons.

    $ robofleet foxglove

    $ robofleet foxglove lab --at 127.0.0.1:9000

    The run does not need it: start and end it at any time. `robofleet run --foxglove` starts it with the run.
    """
    with bad_input():
        need()
        address = Address.read(at, "--at")
        if lifeline is not None:
            _of_run(Path(arena or ""), address, lifeline)
            return
        tree, place = run_of(arena or None, config)
        address.check(tree.arena.name, "--at")
        from robofleet.gateways.foxglove import live  # noqa: PLC0415
        from robofleet.processes.node import Lifeline  # noqa: PLC0415

        try:
            live.serve(tree, place, address, place.folder or Path.cwd(), Lifeline(None), _JOINS_WITHIN_S)
        except TimeoutError as error:
            print(f"the run of {tree.arena.name}: {error}", file=sys.stderr)
            raise typer.Exit(1) from error


def need() -> None:
    """Refuse where the library is missing."""
    need_extra("foxglove", "foxglove")
    need_extra("lab", *LAB_MODULES)


def _of_run(file: Path, at: Address, lifeline: int) -> None:
    """Serve the run that has started this process."""
    from robofleet.comms.permissions import OPERATOR as MAY_ALL  # noqa: PLC0415
    from robofleet.config.load import load_config  # noqa: PLC0415
    from robofleet.gateways.foxglove import live  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    tree, line = load_config(file), Lifeline(lifeline)
    with line.logged("foxglove", tree.arena.name):
        live.serve(tree, Place(tree.bus.endpoint, None, MAY_ALL), at, file.absolute().parent, line)

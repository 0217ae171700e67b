"""The commands ``foxglove`` and ``rerun``, which `robofleet run` starts with the options of these names, too."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.gateways.place import JOINED_WITHIN_S, ArenaAccess, ConfigCopy, answering, run_of
from robofleet.operator.commands import ArenaName
from robofleet.operator.node_commands import LifelineFd
from robofleet.operator.viewer_address import DEFAULTS, FOXGLOVE, RERUN, Address, need


def foxglove(
    arena: ArenaName = None,
    config: ConfigCopy = None,
    at: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Address for the viewer; encrypted (TLS) for other computers.")
    ] = DEFAULTS[FOXGLOVE],
    lifeline: LifelineFd = None,
) -> None:
    """Show a run in Foxglove or Lichtblick.

    The viewer shows everything that is recorded, and has an operator's buttons.

    $ robofleet foxglove

    $ robofleet foxglove lab --at 127.0.0.1:9000

    You can start and end it at any time; the run goes on. `robofleet run --foxglove` starts it with the run.
    """
    _serve(FOXGLOVE, arena, config, at, lifeline)


def rerun(
    arena: ArenaName = None,
    config: ConfigCopy = None,
    at: Annotated[str, typer.Option(metavar="HOST:PORT", help="Address for viewers on this computer.")] = DEFAULTS[
        RERUN
    ],
    lifeline: LifelineFd = None,
) -> None:
    """Show a run in rerun.

    The viewer shows arena, robots, images, plots and log.

    $ robofleet rerun

    $ robofleet rerun lab --at 127.0.0.1:9000

    You can start and end it at any time; the run goes on. `robofleet run --rerun` starts it with the run.
    """
    _serve(RERUN, arena, config, at, lifeline)


def _serve(viewer: str, arena: str | None, config: Path | None, text: str, lifeline: int | None) -> None:
    need(viewer)
    at = Address.read(viewer, text, "--at")
    if lifeline is not None:
        _of_run(viewer, Path(arena or ""), at, lifeline)
        return
    tree, access = run_of(arena or None, config)
    at.check(tree.arena.name, "--at")
    from robofleet.gateways.viewers import live  # noqa: PLC0415
    from robofleet.nodes.node import Lifeline  # noqa: PLC0415

    with answering(tree):
        live.serve(viewer, tree, access, at, access.folder or Path.cwd(), Lifeline(None), JOINED_WITHIN_S)


def _of_run(viewer: str, file: Path, at: Address, lifeline: int) -> None:
    """Serve the run that has started this process."""
    from robofleet.bus.permissions import OPERATOR as MAY_ALL  # noqa: PLC0415
    from robofleet.config.load import load_config  # noqa: PLC0415
    from robofleet.gateways.viewers import live  # noqa: PLC0415
    from robofleet.nodes.node import Lifeline  # noqa: PLC0415

    tree, line = load_config(file), Lifeline(lifeline)
    with line.logged(viewer, tree.arena.name):
        folder = file.absolute().parent
        live.serve(viewer, tree, ArenaAccess(tree.bus.endpoint, None, MAY_ALL, folder), at, folder, line)

"""The commands of an operator to a run that is on."""

from pathlib import Path
from typing import Annotated

import typer

from robofleet.core.refusal import WEB_PACKAGES, RefusedError, need_extra
from robofleet.core.valid_json import dumps
from robofleet.operator import direct
from robofleet.operator.node_commands import LifelineFd, for_one_process
from robofleet.operator.page.page_address import LOOPBACK, listening

def running_names() -> list[str]:
    """Return what a shell completes for ARENA."""
    from robofleet.bus.arena_file import running  # noqa: PLC0415

    return [run.arena for run in running()]


ArenaName = Annotated[
    str | None,
    typer.Argument(
        metavar="ARENA",
        help="arena.name of its configuration; leave it out if only one arena has a run.",
        autocompletion=running_names,
        show_default=False,
    ),
]


def stop(arena: ArenaName = None) -> None:
    """Emergency stop: every robot stands at once, and its gate stays latched, also through a restart.

    $ robofleet stop

    Without ARENA every run of yours is stopped; as root, everybody's. It says who has acknowledged, and when. Look at
    the robots; then robofleet reset, or robofleet run --reset.
    """
    raise typer.Exit(direct.stop(arena))


def arm(arena: ArenaName = None) -> None:
    """Check a fleet that waits for its operator, and try its wheels; `robofleet start` goes on.

    $ robofleet arm
    """
    raise typer.Exit(direct.request("arm", arena))


def start(arena: ArenaName = None) -> None:
    """Start a fleet that waits for its operator (run.start: operator).

    $ robofleet start
    """
    raise typer.Exit(direct.request("start", arena))


def hold(arena: ArenaName = None) -> None:
    """Let every robot stand; `robofleet resume` goes on.

    $ robofleet hold
    """
    raise typer.Exit(direct.request("hold", arena))


def resume(arena: ArenaName = None) -> None:
    """Continue after a hold.

    $ robofleet resume
    """
    raise typer.Exit(direct.request("resume", arena))


def park(arena: ArenaName = None) -> None:
    """Let every robot drive to its place to park; the run ends there.

    $ robofleet park
    """
    raise typer.Exit(direct.request("park", arena))


def reset(arena: ArenaName = None) -> None:
    """Clear the latches of an emergency stop or a fault, with every robot at rest. It moves nothing.

    $ robofleet reset
    """
    raise typer.Exit(direct.request("reset", arena))


def status(
    arena: ArenaName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as one JSON object.")] = False,
) -> None:
    """Show an arena's state: its phase and the cause, each robot's gate, latch and battery, and what can be done now.

    $ robofleet status --json
    """
    raise typer.Exit(direct.status(arena, as_json=as_json))


def hosts(
    arena: Annotated[
        str | None,
        typer.Argument(
            metavar="ARENA|CONFIG",
            help="Whose computers; leave it out if only one arena has a run. CONFIG: between runs, too.",
            autocompletion=running_names,
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as one JSON object.")] = False,
) -> None:
    """Show the computers of an arena's robots: where, version, certificate, round trip, loss, battery, since when.

    $ robofleet hosts

    $ robofleet hosts lab.yaml

    The second one needs no run, where the router stays between runs (bus.router: service). A computer that has joined
    as an operator or a viewer sees the robots that are linked.
    """
    from robofleet.operator import hosts as asking  # noqa: PLC0415
    from robofleet.operator.requests import UnreachableError, chosen, joined_arena  # noqa: PLC0415

    file = None if arena is None else Path(arena)
    named = file is None or not (file.exists() or file.suffix)  # as an arena
    joined = joined_arena(arena) if named else None
    try:
        if joined is not None:
            found = asking.hosts_elsewhere(joined)
        else:
            file = Path(chosen(arena, own=True).folder) / "config.yaml" if file is None or named else file
            found = asking.hosts(for_one_process(file))
    except UnreachableError as error:
        raise typer.Exit(direct.answered(False, str(error))) from error
    if as_json:
        print(dumps(found))
    else:
        from rich.console import Console  # noqa: PLC0415

        Console().print(asking.table(found))


def web(
    run: Annotated[
        str | None,
        typer.Argument(
            metavar="ARENA|CONFIG",
            help="Which run's page; leave it out if only one arena has a run.",
            autocompletion=running_names,
            show_default=False,
        ),
    ] = None,
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Default: any free one.")] = 0,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="This machine's address to listen at; for a phone, the one in its network: by TLS.",
        ),
    ] = LOOPBACK,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the page's address.")] = False,
    lifeline: LifelineFd = None,
) -> None:
    """The operator's page of a run that is on, in your browser: see it, hold it, stop it.

    $ robofleet web

    $ robofleet web --host 192.168.1.5 --port 8080

    When the run has ended the page shows how, with its report. It is served while somebody looks, ten minutes at most.
    """
    from robofleet.operator.page.certificate import page_keys  # noqa: PLC0415

    need_extra("lab", *WEB_PACKAGES)
    if lifeline is not None:
        from robofleet.operator.page.process import of_run  # noqa: PLC0415

        assert run is not None
        tree = for_one_process(Path(run))
        socket, keys = listening(host, port, "--host"), page_keys(tree.arena.name, host, "--host")
        of_run(tree, Path(run).absolute().parent, lifeline, socket, host, keys)
        return
    from robofleet.operator.page.command import there  # noqa: PLC0415

    page_run = there(run, for_one_process)
    with listening(host, port, "--host") as socket:
        keys = page_keys(page_run.config.arena.name, host, "--host")
        from robofleet.operator.page.process import by_hand  # noqa: PLC0415 - the server's packages take their time

        done, line = by_hand(page_run, socket, host, keys, browser=not no_browser)
    if line:
        raise typer.Exit(direct.answered(done, line))

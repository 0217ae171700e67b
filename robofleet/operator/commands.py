"""The commands of an operator to a run that is on."""

import sys
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from robofleet.core.refusal import WEB_PACKAGES, RefusedError, need_extra
from robofleet.core.valid_json import dumps
from robofleet.operator import direct
from robofleet.operator.node_commands import LifelineFd, for_one_process
from robofleet.operator.page.page_address import LOOPBACK, is_local, listening


def running_names() -> list[str]:
    """Return what a shell completes for ARENA."""
    from robofleet.bus.arena_file import running  # noqa: PLC0415

    return [run.arena for run in running()]


def run_argument(metavar: str, meaning: str) -> Any:
    """Return the argument that names a run, which a shell completes."""
    return typer.Argument(metavar=metavar, help=meaning, autocompletion=running_names, show_default=False)


ArenaName = Annotated[
    str | None, run_argument("ARENA", "The run's arena (arena.name). Not needed if only one run is on.")
]


def stop(arena: ArenaName = None) -> None:
    """Emergency stop: all robots stand at once.

    $ robofleet stop

    Without ARENA it stops all your runs; as root, those of all users. It prints which robots have confirmed, and when.
    Robots stay stopped, also after a restart, until `robofleet reset` or `robofleet run --reset`.
    """
    raise typer.Exit(direct.stop(arena))


def arm(arena: ArenaName = None) -> None:
    """Check the robots of a waiting run; each moves a little.

    It is for runs with `run.start: operator`. Then `robofleet start` starts the run.

    $ robofleet arm
    """
    raise typer.Exit(direct.request("arm", arena))


def start(arena: ArenaName = None) -> None:
    """Start a waiting run.

    It is for runs with `run.start: operator`, after `robofleet arm`.

    $ robofleet start
    """
    raise typer.Exit(direct.request("start", arena))


def hold(arena: ArenaName = None) -> None:
    """Make all robots stand; `resume` continues.

    Without `resume` the run ends after two minutes.

    $ robofleet hold
    """
    raise typer.Exit(direct.request("hold", arena))


def resume(arena: ArenaName = None) -> None:
    """Continue after a hold.

    $ robofleet resume
    """
    raise typer.Exit(direct.request("resume", arena))


def park(arena: ArenaName = None) -> None:
    """Drive all robots to their parking poses; end the run.

    The poses are robots[].park of the configuration.

    $ robofleet park
    """
    raise typer.Exit(direct.request("park", arena))


def reset(
    arena: Annotated[
        str | None, run_argument("ARENA", "arena.name of its configuration, or a configuration (.yaml).")
    ] = None,
    overrides: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the configuration. Repeatable."),
    ] = [],  # noqa: B006 - typer copies it
    yes: Annotated[
        bool, typer.Option("--yes", help="The robots are at rest, and may drive again: do not ask.")
    ] = False,
) -> None:
    """Clear an emergency stop or a fault; nothing moves.

    All robots must be at rest.

    $ robofleet reset

    If a run is on, its supervisor clears the latches. If none is on, this command clears the latches that the drivers
    of this computer have stored; for real robots it first asks you whether they are at rest.
    """
    raise typer.Exit(direct.reset(arena, overrides, confirmed=yes))


def status(
    arena: ArenaName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Show the state of a run and of its robots.

    It also prints the cause of a stop, and what you can do now.

    $ robofleet status --json
    """
    raise typer.Exit(direct.status(arena, as_json=as_json))


def hosts(
    arena: Annotated[
        str | None,
        run_argument(
            "ARENA|CONFIG", "The run's arena; not needed if only one run is on. CONFIG works between runs, too."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Show the computers of the robots.

    It prints address, version, certificate, round trip, loss, battery, and since when each is connected.

    $ robofleet hosts

    $ robofleet hosts lab.yaml

    With CONFIG no run is needed, if the router stays between runs (bus.router: service). A computer that has joined as
    an operator or a viewer sees the robots that are connected.
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


PageRun = Annotated[str | None, run_argument("ARENA|CONFIG", "The run's arena; not needed if only one run is on.")]
PagePort = Annotated[
    int,
    typer.Option(metavar="N", min=0, max=65535, show_default=False, help="Port of the page. Default: any free port."),
]
PageHost = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="Serve the page at this address of the computer; for a phone, its address in the phone's network.",
    ),
]


def web(
    run: PageRun = None,
    port: PagePort = 0,
    host: PageHost = LOOPBACK,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the page's address; open no browser.")
    ] = False,
    lifeline: LifelineFd = None,
) -> None:
    """Open the operator's page of a run in a browser.

    The page shows the run, and has buttons to hold and to stop it.

    $ robofleet web

    $ robofleet web --host 192.168.1.5 --port 8080

    After the end the page shows the report, for ten minutes at most. A page for other computers is encrypted (TLS).
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
        from robofleet.operator.page.process import announced, by_hand  # noqa: PLC0415 - the server's packages take time

        done, line = by_hand(page_run, socket, host, keys, partial(announced, browser=not no_browser))
    if line:
        raise typer.Exit(direct.answered(done, line))


def project(
    run: PageRun = None,
    name: Annotated[
        str, typer.Option("--projector", metavar="NAME", help="Which projector. Default: each, by its own address.")
    ] = "",
    kiosk: Annotated[
        bool, typer.Option("--kiosk", help="Open Chromium here, full-screen, where the projector is this computer's.")
    ] = False,
    port: PagePort = 0,
    host: PageHost = LOOPBACK,
) -> None:
    """Show a run on the floor, by projectors that are calibrated.

    It prints an address for each projector: open it in a browser on the projector's computer, and click the page once.

    $ robofleet project --kiosk

    $ robofleet project platoon --projector left

    It prints the address of the operator's page, too: there you switch what is shown.
    """
    need_extra("lab", *WEB_PACKAGES)
    from robofleet.operator.page.certificate import page_keys  # noqa: PLC0415
    from robofleet.operator.page.command import there  # noqa: PLC0415
    from robofleet.operator.page.known_page import page_for_others, page_of  # noqa: PLC0415
    from robofleet.operator.page.projectors import background, calibrated  # noqa: PLC0415

    page_run = there(run, for_one_process)
    chosen = calibrated(page_run.config, name)
    background(page_run.config)
    if kiosk and not is_local(host):
        raise RefusedError("--kiosk shows the page on this computer: leave --host out")
    if kiosk and chosen[1:]:
        raise RefusedError("--kiosk opens one projector's page: name it with --projector")
    arena, own_port = page_run.config.arena.name, port or not is_local(host)
    with ExitStack() as opened:
        from robofleet.operator.page.process import by_hand, projected, until_over  # noqa: PLC0415

        announce = partial(projected, chosen, opened if kiosk else None)
        if page_run.run is not None and not own_port and (at := page_of(arena)) is not None:  # of `run --web`
            print(announce(at), file=sys.stderr)
            if kiosk:
                until_over(page_run)
            return
        socket = opened.enter_context(listening(host, port, "--host"))
        if other := page_for_others(arena):
            print(f"the run's own page is {other}: what is switched there is shown here, too", file=sys.stderr)
        done, line = by_hand(page_run, socket, host, page_keys(arena, host, "--host"), announce)
    if line:
        raise typer.Exit(direct.answered(done, line))

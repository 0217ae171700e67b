"""The commands around a run: each of its processes by itself, and what an operator does to a running arena."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robofleet.processes.refusal import WEB_PACKAGES, RefusedError, bad_input, need_extra
from robofleet.valid_json import dumps

if TYPE_CHECKING:
    import socket

    from robofleet.config.tree import Config
    from robofleet.processes.arena_file import ArenaFile

_LOOPBACK = "127.0.0.1"

app = typer.Typer()
OPERATOR = "A running arena, from any terminal"
PROCESSES = "One process of a run, by itself"


def _running_names() -> list[str]:
    """Return what a shell completes for ARENA."""
    from robofleet.processes.arena_file import running  # noqa: PLC0415

    return [there.arena for there in running()]


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="The run's configuration.")]
ArenaName = Annotated[
    str | None,
    typer.Argument(
        metavar="ARENA",
        help="arena.name of its configuration; where only one has a run, it need not be said.",
        autocompletion=_running_names,
        show_default=False,
    ),
]
LifelineFd = Annotated[int | None, typer.Option("--lifeline", hidden=True)]


@app.command(rich_help_panel=OPERATOR)
def stop(arena: ArenaName = None) -> None:
    """Emergency stop: every robot stands at once, and its gate stays latched, also through a restart.

    $ robofleet stop

    Without ARENA every run of yours is stopped; as root, everybody's. It says who has acknowledged, and when. Look at
    the robots; then robofleet reset, or robofleet run --reset.
    """
    from robofleet.processes import operator  # noqa: PLC0415

    try:
        answers = operator.stop_all(arena)
    except operator.NoArenaError as error:
        print(error, file=sys.stderr)
        raise typer.Exit(2) from error
    for done, what in answers:
        print(what, file=sys.stdout if done else sys.stderr)
    if not all(done for done, _ in answers):
        raise typer.Exit(1)


def _asking(what: str, described: str) -> None:
    def command(arena: ArenaName = None) -> None:
        from robofleet.processes import operator  # noqa: PLC0415

        _told(*operator.ask(_running(arena), what))

    app.command(what, help=f"{described}\n\n$ robofleet {what}", rich_help_panel=OPERATOR)(command)


_asking("arm", "Check a fleet that waits for its operator, and try its wheels; `robofleet start` goes on.")
_asking("start", "Start a fleet that waits for its operator (run.start: operator).")
_asking("hold", "Let every robot stand; `robofleet resume` goes on.")
_asking("resume", "Go on after a hold.")
_asking("reset", "Clear the latches of an emergency stop or a fault, with every robot at rest. It moves nothing.")


@app.command(rich_help_panel=OPERATOR)
def status(
    arena: ArenaName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as one JSON object.")] = False,
) -> None:
    """How an arena stands: its phase and the cause, each robot's gate, latch and battery, and what can be done now.

    $ robofleet status --json
    """
    from robofleet.processes import operator  # noqa: PLC0415

    try:
        found = operator.status(_running(arena))
    except operator.UnreachableError as error:
        _told(False, str(error))
    if as_json:
        print(dumps(found))
    else:
        from rich.console import Console  # noqa: PLC0415

        from robofleet.recording.tables import status_table  # noqa: PLC0415

        Console().print(status_table(found))
        print(found["next"] or "")


def _running(arena: str | None) -> "ArenaFile":
    from robofleet.processes import operator  # noqa: PLC0415

    try:
        return operator.chosen(arena)
    except operator.NoArenaError as error:
        print(error, file=sys.stderr)
        raise typer.Exit(2) from error


def _told(done: bool, what: str) -> None:
    """Print what came of a command: exit code 1 where it did not do what was asked."""
    print(what, file=sys.stdout if done else sys.stderr)
    if not done:
        raise typer.Exit(1)


def _process(name: str) -> None:
    def command(config: ConfigPath, lifeline: LifelineFd = None) -> None:
        from robofleet.processes import child  # noqa: PLC0415
        from robofleet.processes.node import Lifeline  # noqa: PLC0415

        tree = _for_one_process(config, listen=name == "router")
        with bad_input():
            getattr(child, name)(tree, Lifeline(lifeline))

    app.command(name, help=f"The {name} of a run.\n\n$ robofleet {name} lab.yaml", rich_help_panel=PROCESSES)(command)


for _name in ("router", "tracker"):
    _process(_name)


@app.command(rich_help_panel=PROCESSES)
def supervisor(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The supervisor of a run.

    $ robofleet supervisor lab.yaml
    """
    from robofleet.processes import child  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    tree = _for_one_process(config)
    with bad_input():
        child.supervisor(tree, Lifeline(lifeline), config.parent)


@app.command(rich_help_panel=PROCESSES)
def recorder(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The recorder of a run: it writes run.mcap beside CONFIG.

    $ robofleet recorder lab/config.yaml
    """
    from robofleet.processes import child  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    tree = _for_one_process(config)
    with bad_input():
        child.recorder(tree, Lifeline(lifeline), config.parent)


@app.command(rich_help_panel=PROCESSES)
def twins(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The firmware twins of a run: what answers on the serial ports of robots that do not exist.

    $ robofleet twins lab.yaml
    """
    from robofleet.processes import child  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    tree = _for_one_process(config)
    with bad_input():
        child.twins(tree, Lifeline(lifeline))


@app.command(rich_help_panel=PROCESSES)
def controller(
    config: ConfigPath,
    takeover: Annotated[bool, typer.Option("--takeover", hidden=True)] = False,
    lifeline: LifelineFd = None,
) -> None:
    """The controller of a run.

    $ robofleet controller lab.yaml
    """
    from robofleet.processes import child  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    tree = _for_one_process(config)
    with bad_input():
        child.controller(tree, Lifeline(lifeline), take_over=takeover)


@app.command(rich_help_panel=PROCESSES)
def driver(
    config: ConfigPath,
    robots: Annotated[str, typer.Option(metavar="r1,r2", help="Which robots this process drives.")],
    lifeline: LifelineFd = None,
) -> None:
    """The drivers of some robots: what a robot's own computer runs.

    $ robofleet driver lab.yaml --robots r1,r2
    """
    from robofleet.processes import child  # noqa: PLC0415
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    names = tuple(dict.fromkeys(name.strip() for name in robots.split(",")))
    tree = _for_one_process(config, names)
    with bad_input():
        child.driver(tree, Lifeline(lifeline), names)


@app.command(rich_help_panel=OPERATOR)
def web(
    config: Annotated[
        Path | None, typer.Argument(metavar="CONFIG", help="A run's config.yaml; default: the running arena's.")
    ] = None,
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Default: any free one.")] = 0,
    host: Annotated[str, typer.Option(metavar="NAME", help="Which of this machine's addresses.")] = _LOOPBACK,
    lifeline: LifelineFd = None,
) -> None:
    """The operator's page of a run, in a browser: see it, hold it, stop it. It prints the page's address.

    $ robofleet web

    $ robofleet web --host 192.168.1.5 --port 8080
    """
    from robofleet.processes.node import Lifeline  # noqa: PLC0415

    with bad_input():
        need_extra("web", *WEB_PACKAGES)
        file = Path(_running(None).folder) / "config.yaml" if config is None else config
        tree = _for_one_process(file)
        listening = _listening(host, port)
    from robofleet.processes.web import server  # noqa: PLC0415

    if host not in (_LOOPBACK, "localhost", "::1"):
        print(f"--host {host}: whoever reads this network's traffic can take the token and drive", file=sys.stderr)
    server.web(tree, file.absolute().parent, Lifeline(lifeline), listening, host, of_run=lifeline is not None)


def _listening(host: str, port: int) -> "socket.socket":
    import socket  # noqa: PLC0415

    try:
        (family, _, _, _, address), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        if address[0] in ("0.0.0.0", "::"):
            raise RefusedError(
                f"--host {host}: name one of this machine's addresses: what a browser calls it is checked"
            )
        return socket.create_server(address[:2], family=family)
    except OSError as error:
        why = error.strerror if isinstance(error, socket.gaierror) else os.strerror(error.errno or 0)
        raise RefusedError(
            f"--host {host} --port {port}: {why}: name an address of this machine, and a port that is free"
        ) from error


def _for_one_process(config: Path, robots: tuple[str, ...] = (), *, listen: bool = False) -> "Config":
    """Return the configuration of a run's process: it finds the others at an endpoint that all of them know."""
    from robofleet.comms.endpoint import check_free, settled  # noqa: PLC0415
    from robofleet.comms.private_folder import PlaceError  # noqa: PLC0415
    from robofleet.config.load import ConfigFile  # noqa: PLC0415

    with bad_input():
        source = ConfigFile(config)
        tree = source.config
        known = [robot.id for robot in tree.robots]
        for unknown in (name for name in robots if name not in known):
            raise RefusedError(f"--robots: there is no robot {unknown!r} in {config} (it has {', '.join(known)})")
        if tree.bus.endpoint.endswith(":0"):
            raise RefusedError(
                f"{config}: bus.endpoint: {tree.bus.endpoint} is another port for each process: "
                "name one, for example tcp/127.0.0.1:7447, or leave it out"
            )
        for robot in robots:
            from robofleet.processes.check_drivers import of_robot  # noqa: PLC0415

            source.refuse(of_robot(tree, known.index(robot)))
        try:
            tree = settled(tree, listen=listen)
            if listen:
                check_free(tree)
        except PlaceError as error:
            raise RefusedError(f"{config}: {error}") from error
        return tree

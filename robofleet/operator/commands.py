"""The commands around a run: each of its processes by itself, and what an operator does to a running arena."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robofleet.core.refusal import WEB_PACKAGES, RefusedError, need_extra
from robofleet.core.valid_json import dumps
from robofleet.operator import direct
from robofleet.operator.page.page_address import LOOPBACK, listening
from robofleet.runs import table

if TYPE_CHECKING:
    from robofleet.config.tree import Config
    from robofleet.runs.table import Row


def running_names() -> list[str]:
    """Return what a shell completes for ARENA."""
    from robofleet.bus.arena_file import running  # noqa: PLC0415

    return [run.arena for run in running()]


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="The run's configuration.")]
ArenaName = Annotated[
    str | None,
    typer.Argument(
        metavar="ARENA",
        help="arena.name of its configuration; leave it out if only one arena has a run.",
        autocompletion=running_names,
        show_default=False,
    ),
]
LifelineFd = Annotated[int | None, typer.Option("--lifeline", hidden=True)]


def stop(arena: ArenaName = None) -> None:
    """Emergency stop: every robot stands at once, and its gate stays latched, also through a restart.

    $ robofleet stop

    Without ARENA every run of yours is stopped; as root, everybody's. It says who has acknowledged, and when. Look at
    the robots; then robofleet reset, or robofleet run CONFIG --reset.
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


def reset(
    arena: Annotated[
        str | None,
        typer.Argument(
            metavar="ARENA",
            help="arena.name of its configuration, or a configuration (.yaml).",
            autocompletion=running_names,
            show_default=False,
        ),
    ] = None,
    overrides: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key of the configuration. Repeatable."),
    ] = [],  # noqa: B006 - typer copies it
    yes: Annotated[
        bool, typer.Option("--yes", help="The robots are at rest, and may drive again: do not ask.")
    ] = False,
) -> None:
    """Clear the latches of an emergency stop or a fault, with every robot at rest. It moves nothing.

    $ robofleet reset

    It asks the run of ARENA. Where no run is on, it clears what the drivers of this computer have kept: for real robots
    it asks you first whether they are at rest.
    """
    raise typer.Exit(direct.reset(arena, overrides, confirmed=yes))


def status(
    arena: ArenaName = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as one JSON object.")] = False,
) -> None:
    """Show an arena's state: its phase and the cause, each robot's gate, latch and battery, and what can be done now.

    $ robofleet status --json
    """
    raise typer.Exit(direct.status(arena, as_json=as_json))


def tracker(
    config: ConfigPath,
    camera: Annotated[str, typer.Option(metavar="NAME", help="The tracker's camera, if CONFIG has several.")] = "",
    lifeline: LifelineFd = None,
) -> None:
    """The tracker of a run, and its camera.

    $ robofleet tracker lab.yaml
    """
    _be(table.TRACKER, config, lifeline, camera=camera)


def _be(
    row: "Row", file: Path, lifeline: int | None, robots: tuple[str, ...] = (), camera: str = "", *,
    take_over: bool = False,
) -> None:  # fmt: skip
    """Be one process of the run of a configuration, in whose folder it is recorded."""
    from robofleet.runs import child  # noqa: PLC0415

    config = _for_one_process(file, robots, listen=row is table.ROUTER)
    child.main(row, config, file.parent, lifeline, robots, camera, take_over=take_over)


def supervisor(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The supervisor of a run.

    $ robofleet supervisor lab.yaml
    """
    _be(table.SUPERVISOR, config, lifeline)


def recorder(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The recorder of a run: it writes run.mcap beside CONFIG.

    $ robofleet recorder lab.yaml
    """
    _be(table.RECORDER, config, lifeline)


def twins(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """The firmware twins of a run: they answer on serial ports in the place of robots.

    $ robofleet twins lab.yaml
    """
    _be(table.TWINS, config, lifeline)


def controller(
    config: ConfigPath,
    takeover: Annotated[bool, typer.Option("--takeover", hidden=True)] = False,
    lifeline: LifelineFd = None,
) -> None:
    """The controller of a run.

    $ robofleet controller lab.yaml
    """
    _be(table.CONTROLLER, config, lifeline, take_over=takeover)


def driver(
    config: Annotated[Path | None, typer.Argument(metavar="[CONFIG]", help="The run's configuration.")] = None,
    robots: Annotated[
        str | None, typer.Option(metavar="r1,r2", help="Which robots of CONFIG this process drives.")
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="On a robot's own computer, without CONFIG: each run brings its own."),
    ] = None,
    lifeline: LifelineFd = None,
) -> None:
    """The drivers of some robots: what a robot's own computer runs.

    $ robofleet driver lab.yaml --robots r1,r2
    """
    if unit is not None:
        if config is not None or robots is not None:
            raise RefusedError("--unit: each run brings its configuration: leave CONFIG and --robots out")
        _wait_for_runs(unit)
        return
    if config is None or robots is None:
        missing = "CONFIG" if config is None else "--robots"
        example = (
            "`robofleet driver lab.yaml --robots r1,r2`, or on a robot's own computer `robofleet driver --unit r1`"
        )
        raise RefusedError(f"{missing}: is missing: {example}")
    names = tuple(dict.fromkeys(name.strip() for name in robots.split(",")))
    _be(table.DRIVER, config, lifeline, names)


def _wait_for_runs(unit: str) -> None:
    """Be the driver of this computer's robots, whatever run comes: as a program without the command line's packages."""
    from robofleet.config.files.robot_file import load_robot_file, robot_file  # noqa: PLC0415

    file = robot_file()
    robot = load_robot_file(file)
    if robot.unit != unit:
        raise RefusedError(f"--unit {unit}: {file} says that this computer is {robot.unit}")
    os.execv(sys.executable, [sys.executable, "-P", "-X", "faulthandler", "-m", "robofleet.runs.daemon"])


def router(
    config: ConfigPath,
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print it as the configuration of a zenohd of your own: JSON5.")
    ] = False,
    lifeline: LifelineFd = None,
) -> None:
    """The router of a run's bus.

    $ robofleet router lab.yaml
    """
    if print_config:
        from robofleet.hosts.network import settings_of  # noqa: PLC0415

        print(dumps(settings_of(_for_one_process(config))))
        return
    _be(table.ROUTER, config, lifeline)


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
            found = asking.hosts(_for_one_process(file))
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
        tree = _for_one_process(Path(run))
        socket, keys = listening(host, port, "--host"), page_keys(tree.arena.name, host, "--host")
        of_run(tree, Path(run).absolute().parent, lifeline, socket, host, keys)
        return
    from robofleet.operator.page.command import there  # noqa: PLC0415

    page_run = there(run, _for_one_process)
    with listening(host, port, "--host") as socket:
        keys = page_keys(page_run.config.arena.name, host, "--host")
        from robofleet.operator.page.process import by_hand  # noqa: PLC0415 - the server's packages take their time

        done, line = by_hand(page_run, socket, host, keys, browser=not no_browser)
    if line:
        raise typer.Exit(direct.answered(done, line))


def _for_one_process(config: Path, robots: tuple[str, ...] = (), *, listen: bool = False) -> "Config":
    """Return the configuration of a run's process: it finds the others at an endpoint that all of them know."""
    from robofleet.bus.endpoint import check_free, settled  # noqa: PLC0415
    from robofleet.bus.private_folder import PlaceError  # noqa: PLC0415
    from robofleet.config.load import ConfigFile  # noqa: PLC0415

    source = ConfigFile(config)
    tree = source.config
    known = [robot.id for robot in tree.robots]
    for unknown in (name for name in robots if name not in known):
        raise RefusedError(f"--robots: there is no robot {unknown!r} in {config} (it has {', '.join(known)})")
    if robots and robots not in tree.units.values():
        unit = tree.unit_of[robots[0]]
        raise RefusedError(
            f"--robots: a process drives all robots of one unit: name {','.join(tree.units[unit])}, or give "
            f"robots[].unit or drivers.robots_per_process in {config}"
        )
    if tree.bus.endpoint.endswith(":0"):
        raise RefusedError(
            f"{config}: bus.endpoint: {tree.bus.endpoint} is another port for each process: "
            "name one, for example tcp/127.0.0.1:7447, or leave it out"
        )
    for robot in robots:
        from robofleet.runs.check_drivers import of_robot  # noqa: PLC0415

        source.refuse(of_robot(tree, known.index(robot)))
    try:
        tree = settled(tree, listen=listen)
        if listen:
            check_free(tree)
    except PlaceError as error:
        raise RefusedError(f"{config}: {error}") from error
    return tree

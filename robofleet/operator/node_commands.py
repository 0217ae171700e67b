"""Start one process of a run by itself.

`robofleet run` starts all of them.

$ robofleet node router lab.yaml

$ robofleet node driver --unit r1

All processes of a run read the same configuration, whose bus.endpoint names no port 0.
"""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robofleet.core.refusal import RefusedError
from robofleet.core.valid_json import dumps
from robofleet.runs import table

if TYPE_CHECKING:
    from robofleet.config.tree import Config
    from robofleet.runs.table import Row

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="The run's configuration (YAML).")]
LifelineFd = Annotated[int | None, typer.Option("--lifeline", hidden=True)]


def tracker(
    config: ConfigPath,
    camera: Annotated[str, typer.Option(metavar="NAME", help="Which camera, if CONFIG has several.")] = "",
    lifeline: LifelineFd = None,
) -> None:
    """Start a tracker: it measures poses in a camera's images.

    $ robofleet node tracker lab.yaml
    """
    _be(table.TRACKER, config, lifeline, camera=camera)


def _be(
    row: "Row", file: Path, lifeline: int | None, robots: tuple[str, ...] = (), camera: str = "", *,
    take_over: bool = False,
) -> None:  # fmt: skip
    """Be one process of the run of a configuration, in whose folder it is recorded."""
    from robofleet.runs import child  # noqa: PLC0415

    config = for_one_process(file, robots, listen=row is table.ROUTER)
    child.main(row, config, file.parent, lifeline, robots, camera, take_over=take_over)


def supervisor(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """Start the supervisor: it permits motion, and stops robots.

    $ robofleet node supervisor lab.yaml
    """
    _be(table.SUPERVISOR, config, lifeline)


def recorder(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """Start the recorder: it writes run.mcap beside CONFIG.

    $ robofleet node recorder lab.yaml
    """
    _be(table.RECORDER, config, lifeline)


def twins(config: ConfigPath, lifeline: LifelineFd = None) -> None:
    """Start the firmware twins: simulated robots on serial ports.

    $ robofleet node twins lab.yaml
    """
    _be(table.TWINS, config, lifeline)


def controller(
    config: ConfigPath,
    takeover: Annotated[bool, typer.Option("--takeover", hidden=True)] = False,
    lifeline: LifelineFd = None,
) -> None:
    """Start the controller: it commands the robots.

    $ robofleet node controller lab.yaml
    """
    _be(table.CONTROLLER, config, lifeline, take_over=takeover)


def driver(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG", help="The run's configuration (YAML).")] = None,
    robots: Annotated[
        str | None, typer.Option(metavar="r1,r2", help="The robots of CONFIG that this process drives.")
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="This robot computer's unit, in place of CONFIG: each run sends its configuration."
        ),
    ] = None,
    lifeline: LifelineFd = None,
) -> None:
    """Start a driver: it moves robots.

    On a robot's own computer, with --unit, it waits for runs.

    $ robofleet node driver lab.yaml --robots r1,r2

    $ robofleet node driver --unit r1
    """
    if unit is not None:
        if config is not None or robots is not None:
            raise RefusedError("--unit: each run sends its configuration: leave CONFIG and --robots out")
        _wait_for_runs(unit)
        return
    if config is None or robots is None:
        missing = "CONFIG" if config is None else "--robots"
        raise RefusedError(
            f"{missing}: is missing: `robofleet node driver lab.yaml --robots r1,r2`, or on a robot's own computer "
            "`robofleet node driver --unit r1`"
        )
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
        bool, typer.Option("--print-config", help="Only print the configuration for a zenohd of your own (JSON5).")
    ] = False,
    lifeline: LifelineFd = None,
) -> None:
    """Start the router: it passes the processes' messages on.

    $ robofleet node router lab.yaml
    """
    if print_config:
        from robofleet.hosts.network import settings_of  # noqa: PLC0415

        print(dumps(settings_of(for_one_process(config))))
        return
    _be(table.ROUTER, config, lifeline)


def for_one_process(config: Path, robots: tuple[str, ...] = (), *, listen: bool = False) -> "Config":
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

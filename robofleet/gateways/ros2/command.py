"""The command ``ros2``."""

import os
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.refusal import LAB_MODULES, RefusedError, how_to_install, need_extra, new_folder
from robofleet.gateways.place import ConfigCopy, answering, run_of
from robofleet.gateways.ros2 import topics
from robofleet.operator.commands import run_argument
from robofleet.runs import folder as folders
from robofleet.runs.folder import DEFAULT_FOLDER

if TYPE_CHECKING:
    from robofleet.config.tree import Config

SHARE = Path(__file__).parent / "share"  # the launch file

_TYPES = topics.SERVICE, *(kind for row in topics.TOPICS for kind in row.type.split(" or "))
_PACKAGES = sorted({"rclpy", *(kind.split("/")[0] for kind in _TYPES)})
_SLOWEST, _FASTEST = 0.01, 100.0  # simulated seconds a second
_IMPORT_FAILED = 1  # exit code of a Python that could not import
_OPTIONAL = "tf2_msgs"  # which PyPI does not have


def ros2(
    arena: Annotated[
        str | None,
        run_argument(
            "ARENA|CONFIG", "The run's arena; not needed if only one run is on. With --lockstep, a configuration."
        ),
    ] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Simulate CONFIG on a simulated clock, which is published as /clock.")
    ] = False,
    speed: Annotated[float, typer.Option(metavar="X", help="Simulated seconds per second, with --lockstep.")] = 1.0,
    overrides: Annotated[
        list[str],
        typer.Option("--set", metavar="KEY=VALUE", help="Change a key of CONFIG, with --lockstep. Repeatable."),
    ] = [],  # noqa: B006 - typer copies it
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help=f"Folder for the results, with --lockstep. {DEFAULT_FOLDER}")
    ] = None,
    config: ConfigCopy = None,
    namespace: Annotated[str, typer.Option(metavar="NS", help="ROS namespace of topics and frames.")] = "",
    rviz: Annotated[
        bool, typer.Option("--rviz", help="Print an RViz configuration for the run, or for CONFIG.")
    ] = False,
    urdf: Annotated[
        str | None, typer.Option("--urdf", metavar="ROBOT", help="Print the URDF of a robot of the run, or of CONFIG.")
    ] = None,
    share: Annotated[bool, typer.Option("--share", help="Print the folder of the launch file.")] = False,
) -> None:
    """Connect a run to ROS 2.

    It publishes poses, odometry, images and state, and takes cmd_vel for groups with the behaviour ros2.

    $ robofleet ros2

    $ robofleet ros2 lab --namespace lab

    $ robofleet ros2 configs/ros2.yaml --lockstep

    $ robofleet ros2 --rviz

    $ robofleet ros2 configs/ros2.yaml --urdf r1

    It needs ROS 2 Jazzy or newer. You can start and end it at any time; the run goes on.
    """
    if share:
        print(SHARE)
        return
    need_extra("lab", *LAB_MODULES)
    if rviz or urdf is not None:
        tree = _configuration(arena, overrides, config)
        print(_rviz(tree, namespace) if urdf is None else _urdf(tree, urdf), end="")
        return
    _need_ros()
    if lockstep:
        _simulate(arena, overrides, out, namespace, speed)
        return
    if overrides or out is not None or (arena and Path(arena).suffix in CONFIGURATIONS):
        run = f"`robofleet run {arena or 'CONFIG'}`"
        raise RefusedError(f"a run in real time is another process: start {run}, or write --lockstep")
    tree, access = run_of(arena or None, config)
    _check_names(tree)
    from robofleet.gateways.ros2 import live  # noqa: PLC0415

    with answering(tree):
        live.serve(tree, access, namespace)


def _need_ros() -> None:
    """Refuse where there is no rclpy, or one of another Python."""
    chosen = os.environ.get("RMW_IMPLEMENTATION")
    if chosen:  # rclpy ends the process that imports it and has no such one
        tried = subprocess.run([sys.executable, "-P", "-c", "import rclpy"], stderr=subprocess.DEVNULL, check=False)
        if tried.returncode not in (0, _IMPORT_FAILED):
            raise RefusedError(f"RMW_IMPLEMENTATION={chosen}: this rclpy does not start with it: unset it")
    missing = [package for package in _PACKAGES if package != _OPTIONAL and find_spec(package) is None]
    broken = ""
    if not missing:
        try:
            import_module("rclpy")
        except ImportError as error:
            missing, broken = ["rclpy"], f" ({error})"
    if missing:
        raise RefusedError(
            f"this needs {', '.join(missing)} of ROS 2{' '.join(broken.split())}: source your ROS 2 where robofleet is "
            f"installed for the same Python, or {how_to_install('ros2')}"
        )


def _configuration(arena: str | None, overrides: list[str], copy: Path | None) -> "Config":
    """Return the configuration of a run that is on, or the one that is named."""
    from robofleet.config.load import load_config  # noqa: PLC0415

    if arena is not None and Path(arena).suffix in CONFIGURATIONS:
        return load_config(Path(arena), overrides)
    return run_of(arena or None, copy)[0]


def _rviz(config: "Config", namespace: str) -> str:
    from robofleet.gateways.ros2 import rviz  # noqa: PLC0415

    _check_names(config)
    return rviz.configuration(config, namespace)


def _urdf(config: "Config", robot: str) -> str:
    from robofleet.config.faults import did_you_mean  # noqa: PLC0415
    from robofleet.gateways.urdf import urdf  # noqa: PLC0415

    if robot not in config.ids:
        raise RefusedError(f"--urdf {robot}: there is no such robot: {did_you_mean(robot, config.ids)}")
    return urdf(config.robot(robot))


def _check_names(config: "Config") -> None:
    try:
        topics.ros_names(robot.id for robot in config.robots)
    except topics.NamesError as error:
        raise RefusedError(str(error)) from error


def _simulate(file: str | None, overrides: list[str], out: Path | None, namespace: str, speed: float) -> None:
    """Be a run in lockstep, and its gateway."""
    if file is None or Path(file).suffix not in CONFIGURATIONS:
        raise RefusedError(f"--lockstep: {file or 'CONFIG'}: name a configuration, for example configs/ros2.yaml")
    if not _SLOWEST <= speed <= _FASTEST:
        raise RefusedError(f"--speed {speed:g}: must be {_SLOWEST:g} to {_FASTEST:g}")
    from robofleet.gateways.ros2 import simulated  # noqa: PLC0415
    from robofleet.gateways.ros2.live import node  # noqa: PLC0415
    from robofleet.runs.check import load_checked  # noqa: PLC0415
    from robofleet.scripts.script_link import FleetError  # noqa: PLC0415

    tree = load_checked(Path(file), overrides, lockstep=True)
    _check_names(tree)
    with node(namespace):
        pass  # what ROS refuses is refused before anything begins
    folder = out or folders.new(Path(file).stem)
    new_folder(folder)
    try:
        summary = simulated.serve(tree, Path(file).stem, folder, namespace, speed)
    except FleetError as error:
        print(error, file=sys.stderr)
        raise typer.Exit(1) from error
    print(folder / "report.html")
    if summary["outcome"] == "fault":
        print(summary["cause"], file=sys.stderr)
        raise typer.Exit(1)

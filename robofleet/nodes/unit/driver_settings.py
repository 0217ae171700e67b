"""What ``robots[].settings`` says, as the driver's own model, and what else a driver is made from."""

from collections.abc import Callable
from typing import Any

from pydantic import ValidationError

from robofleet.bus.arena_file import twin_port
from robofleet.bus.private_folder import PlaceError
from robofleet.config import slices
from robofleet.config.faults import Complaint, plain_words
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.plugins import load
from robofleet.drivers.udp_port import LOOPBACK
from robofleet.vehicles.interface import DriverContext, SimulatedDriver, World


def of(config: Config, robot: Robot) -> Any:
    """Return a robot's settings, with its twin's port where it has one; None where its driver takes none.

    Raises:
        PluginError: there is no such driver.
        ValidationError: the settings are wrong.
    """
    kind = getattr(load("robofleet.drivers", robot.driver), "Settings", None)
    if kind is None:
        return None
    port = {} if robot.twin is None else {"port": port_of_twin(config, robot)}
    return kind.model_validate(robot.settings | port)


def port_of_twin(config: Config, robot: Robot) -> str:
    """Return the port at which a robot's twin answers: a path, or the configured UDP port of this computer alone."""
    own = str(robot.settings.get("port", ""))
    return own if own.startswith(LOOPBACK) else str(twin_port(config.arena.name, robot.id))


def context(config: Config, robot: Robot, now_ns: Callable[[], int], world: World | None = None) -> DriverContext:
    """Return what a robot's driver is made from; raises as ``of`` does. ``world``: the configuration's, if at hand."""
    simulated = issubclass(load("robofleet.drivers", robot.driver), SimulatedDriver)
    return DriverContext(
        robot=robot.id,
        drive=slices.drive(robot),
        simulation=slices.simulation(config, robot, None) if simulated else None,
        now_ns=now_ns,
        settings=of(config, robot),
        sensors=slices.sensors(robot),
        world=world or slices.world(config),
    )


def port(config: Config, robot: Robot) -> str | None:
    """Return the port that a robot is connected to, its twin's or its own; None where its driver needs none."""
    named: str | None = getattr(of(config, robot), "port", None)
    return named


def place(config: Config, robot: Robot) -> str:
    """Return the dotted path at which it is said that a robot cannot be opened."""
    own_port = robot.twin is None and port(config, robot) is not None
    return f"robots.{config.robots.index(robot)}.{'settings.port' if own_port else 'driver'}"


def complaints(config: Config, index: int) -> list[Complaint]:
    """Return what is wrong with the settings of a robot whose driver can be loaded."""
    robot, path = config.robots[index], f"robots.{index}.settings"
    kind = getattr(load("robofleet.drivers", robot.driver), "Settings", None)
    if kind is None:
        without_port = f"{robot.driver!r} opens no serial port: name another driver, or remove the twin"
        twin = [(f"robots.{index}.twin", without_port)] if robot.twin is not None else []
        return twin + ([(path, f"{robot.driver!r} takes none: remove them")] if robot.settings else [])
    try:
        of(config, robot)
    except PlaceError as error:
        return [(f"robots.{index}.twin", str(error))]
    except ValidationError as invalid:
        errors = invalid.errors(include_url=False)
        return [(".".join([path, *map(str, error["loc"])]), plain_words(error, kind)) for error in errors]
    return []

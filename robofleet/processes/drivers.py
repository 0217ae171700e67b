"""Makes the drivers of a configuration's robots."""

from collections.abc import Callable
from functools import partial
from typing import Protocol

from robofleet.config.tree import Config
from robofleet.plugins import load
from robofleet.processes import driver_settings
from robofleet.processes.attached import Attached
from robofleet.vehicles.interface import Driver, DriverContext, SimulatedDriver


class Drivers(Protocol):
    """What a driver process asks for the drivers of its robots."""

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from."""

    def open(self, context: DriverContext) -> Driver:
        """Return a driver whose robot has answered and stands; DriverError where it does not."""


class ConfiguredDrivers:
    """Makes what the configuration names. The driver of a robot that exists is made again when it fails."""

    def __init__(self, config: Config, now_ns: Callable[[], int]) -> None:
        self._config, self._now_ns = config, now_ns

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from."""
        return driver_settings.context(self._config, self._config.robot(robot), self._now_ns)

    def open(self, context: DriverContext) -> Driver:
        """Return a driver whose robot has answered and stands; DriverError where it does not."""
        kind = load("robofleet.drivers", self._config.robot(context.robot).driver)
        made: Driver = (
            kind(context) if issubclass(kind, SimulatedDriver) else Attached(partial(kind, context), context.now_ns)
        )
        return made

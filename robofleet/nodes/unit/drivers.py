"""Makes the robots of a unit: each behind its driver, or all simulated ones at once."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Protocol

from robofleet.config import slices
from robofleet.config.tree import OWN_PLANT, Config
from robofleet.core.plugins import load
from robofleet.nodes.unit import driver_settings
from robofleet.nodes.unit.gated_robot import GatedRobots, Probe, Robots
from robofleet.nodes.unit.reconnecting_driver import ReconnectingDriver
from robofleet.nodes.unit.state_store import StateStore
from robofleet.vehicles.interface import Driver, DriverContext, DriverError, SimulatedDriver, is_concurrent
from robofleet.vehicles.plants import SharedPlant

if TYPE_CHECKING:
    from robofleet.simulation.bodies import Bodies

OWN_DRIVER = "simulated"  # whose robots share a plant; those of the own plant are simulated all at once


class Drivers(Protocol):
    """What a driver process makes its robots from."""

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from."""

    def driver(self, context: DriverContext) -> Driver:
        """Return a driver whose robot has answered and stands; DriverError where it does not."""

    def bodies(self, contexts: Sequence[DriverContext]) -> "Bodies | None":
        """Return the robots of a unit as bodies in arrays; None where each has a driver of its own."""


class ConfiguredDrivers:
    """Makes what the configuration names. The driver of a robot that exists is made again when it fails."""

    def __init__(self, config: Config, now_ns: Callable[[], int]) -> None:
        self._config, self._now_ns, self._world = config, now_ns, slices.world(config)
        self._constructing = threading.Lock()
        self._plants: dict[str, SharedPlant | None] = {}  # by units

    def context(self, robot: str) -> DriverContext:
        return driver_settings.context(self._config, self._config.robot(robot), self._now_ns, self._world)

    def driver(self, context: DriverContext) -> Driver:
        kind = load("robofleet.drivers", self._config.robot(context.robot).driver)
        if context.simulation is not None and self._config.robot(context.robot).driver == OWN_DRIVER:
            context = replace(context, simulation=replace(context.simulation, plant=self._plant(context.robot)))
        make: Callable[[], Driver] = partial(kind, context)
        if not is_concurrent(kind):
            make = partial(self._alone, make)
        return make() if issubclass(kind, SimulatedDriver) else ReconnectingDriver(make, context.now_ns)

    def _plant(self, robot: str) -> SharedPlant | None:
        """Return the plant that a robot shares with all simulated ones of its unit."""
        unit = self._config.unit_of[robot]
        if unit not in self._plants:
            robots = [name for name in self._config.units[unit] if self._config.robot(name).driver == OWN_DRIVER]
            self._plants[unit] = slices.shared_plant(self._config, robots, self._now_ns())
        return self._plants[unit]

    def _alone(self, make: Callable[[], Driver]) -> Driver:
        """Construct a driver while no other is: several that failed at once are made again one after the other."""
        with self._constructing:
            return make()

    def bodies(self, contexts: Sequence[DriverContext]) -> "Bodies | None":
        if not in_arrays(self._config, [context.robot for context in contexts]):
            return None
        from robofleet.simulation.bodies import Bodies  # noqa: PLC0415 - it needs numba

        return Bodies(contexts)


def in_arrays(config: Config, robots: Sequence[str]) -> bool:
    return config.plant.model == OWN_PLANT and all(config.robot(robot).driver == OWN_DRIVER for robot in robots)


def behind_gates(
    drivers: Drivers, config: Config, robots: Sequence[str], boot_id: int, state_store: StateStore, probe: Probe | None,
    now_ns: Callable[[], int],
) -> Robots:  # fmt: skip
    """Return a unit's robots, which have answered and stand, behind their gates; DriverError where one does not."""
    contexts = [drivers.context(robot) for robot in robots]
    if (bodies := drivers.bodies(contexts)) is not None:
        from robofleet.nodes.unit.simulated_robots import SimulatedRobots  # noqa: PLC0415 - it needs numba

        return SimulatedRobots(contexts, bodies, boot_id, state_store, probe, now_ns())
    opened: list[Driver] = []
    try:
        for context in contexts:
            try:
                opened.append(drivers.driver(context))
            except DriverError as error:
                raise DriverError(f"{driver_settings.place(config, config.robot(context.robot))}: {error}") from error
        return GatedRobots(contexts, opened, boot_id, state_store, probe, now_ns)
    except BaseException:
        for driver in opened:
            driver.close()
        raise

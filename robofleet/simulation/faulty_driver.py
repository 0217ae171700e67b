"""Drivers whose robots have faults: of their bodies, if they are simulated, and of what they report."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from robofleet.simulation.bodies import Bodies, Sensors
from robofleet.simulation.faults import Schedule, struck
from robofleet.vehicles.interface import (
    WIRED_STOP,
    Driver,
    DriverContext,
    DriverReading,
    SimulatedDriver,
    WheelSpeeds,
)

_LOW_CHARGE = 0.05


class _Drivers(Protocol):
    def context(self, robot: str) -> DriverContext: ...

    def driver(self, context: DriverContext) -> Driver: ...

    def bodies(self, contexts: Sequence[DriverContext]) -> Bodies | None: ...


class FaultyDrivers:
    """Makes drivers with their faults. A simulated robot outlives lockstep's process that drove it."""

    def __init__(self, drivers: _Drivers, schedule: Schedule) -> None:
        self._drivers, self._schedule = drivers, schedule

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from, with what is wrong with its body."""
        context = self._drivers.context(robot)
        simulation = context.simulation
        if simulation is not None:
            simulation = replace(simulation, trouble=self._schedule.body_trouble(robot))
        return replace(context, simulation=simulation, now_ns=self._schedule.now_ns)

    def driver(self, context: DriverContext) -> Driver:
        """Return the driver; raises what making it raises."""
        drivers, robot = self._schedule.drivers, context.robot
        if robot not in drivers:
            drivers[robot] = self._drivers.driver(context)
        return FaultyDriver(drivers[robot], self._schedule, robot)

    def bodies(self, contexts: Sequence[DriverContext]) -> Bodies | None:
        """Return the bodies of a unit; those that were made before, if there are some."""
        bodies, robots = self._schedule.bodies, tuple(context.robot for context in contexts)
        if robots not in bodies:
            made = self._drivers.bodies(contexts)
            if made is None:
                return None
            made.sensors = [(row, reading) for row, robot in enumerate(robots) if (reading := self._sensors(robot))]
            bodies[robots] = made
        return bodies[robots]

    def _sensors(self, robot: str) -> Callable[[], Sensors] | None:
        """Return what tells what a robot's sensors say wrongly; None if they never do."""
        schedule = self._schedule
        low, pressed = schedule.of("low_battery", robot=robot), schedule.of("wired_stop", robot=robot)

        def sensors() -> Sensors:
            now_ns = schedule.now_ns()
            charge = _LOW_CHARGE if struck(low, now_ns) else math.nan
            return Sensors(int(WIRED_STOP) if struck(pressed, now_ns) else 0, charge)

        return sensors if low or pressed else None


class FaultyDriver:
    """A driver whose robot reads wrongly."""

    def __init__(self, driver: Driver, schedule: Schedule, robot: str) -> None:
        self._driver, self._now_ns = driver, schedule.now_ns
        self._low, self._pressed = schedule.of("low_battery", robot=robot), schedule.of("wired_stop", robot=robot)
        if isinstance(driver, SimulatedDriver):
            self.truth = driver.truth

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels."""
        self._driver.write(wheels)

    def read(self) -> DriverReading:
        """Return the reading as it is now."""
        reading, now_ns = self._driver.read(), self._now_ns()
        if struck(self._low, now_ns):
            reading = reading._replace(battery=_LOW_CHARGE)
        if struck(self._pressed, now_ns):
            reading = reading._replace(faults=reading.faults | WIRED_STOP)
        return reading

    def close(self) -> None:
        """Motors off."""
        self._driver.close()

"""Drivers whose robots have faults: of their bodies, if they are simulated, and of what they report."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

from robofleet.simulation.bodies import Bodies, Sensors
from robofleet.simulation.faults import Schedule, struck
from robofleet.vehicles.interface import WIRED_STOP, Driver, DriverContext, DriverReading, SimulatedDriver

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
            wrong = ((row, wrong_sensors(self._schedule, robot)) for row, robot in enumerate(robots))
            made.sensors = [(row, sensors) for row, sensors in wrong if sensors is not None]
            bodies[robots] = made
        return bodies[robots]


class FaultyDriver:
    """A driver whose robot reads wrongly."""

    def __init__(self, driver: Driver, schedule: Schedule, robot: str) -> None:
        self._read, self._sensors = driver.read, wrong_sensors(schedule, robot)
        self.write, self.close = driver.write, driver.close
        if isinstance(driver, SimulatedDriver):
            self.truth = driver.truth

    def read(self) -> DriverReading:
        reading = self._read()
        if self._sensors is None:
            return reading
        faults, charge = self._sensors()
        battery = reading.battery if math.isnan(charge) else charge
        return reading._replace(battery=battery, faults=reading.faults | faults)


def wrong_sensors(schedule: Schedule, robot: str) -> Callable[[], Sensors] | None:
    """Return what tells what a robot's sensors say wrongly; None if they never do."""
    low, pressed = schedule.of("low_battery", robot=robot), schedule.of("wired_stop", robot=robot)

    def sensors() -> Sensors:
        now_ns = schedule.now_ns()
        charge = _LOW_CHARGE if struck(low, now_ns) else math.nan
        return Sensors(int(WIRED_STOP) if struck(pressed, now_ns) else 0, charge)

    return sensors if low or pressed else None

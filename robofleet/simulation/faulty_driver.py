"""Drivers whose robots have faults: of their bodies, if they are simulated, and of what they report."""

from dataclasses import replace
from typing import Protocol

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

    def open(self, context: DriverContext) -> Driver: ...


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

    def open(self, context: DriverContext) -> Driver:
        """Return the driver; raises what making it raises."""
        bodies, robot = self._schedule.bodies, context.robot
        if robot not in bodies:
            bodies[robot] = self._drivers.open(context)
        faulty = FaultySimulatedDriver if isinstance(bodies[robot], SimulatedDriver) else FaultyDriver
        return faulty(bodies[robot], self._schedule, robot)


class FaultyDriver:
    """A driver whose robot reads wrongly."""

    def __init__(self, driver: Driver, schedule: Schedule, robot: str) -> None:
        self._driver, self._now_ns = driver, schedule.now_ns
        self._low, self._pressed = schedule.of("low_battery", robot=robot), schedule.of("wired_stop", robot=robot)

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


class FaultySimulatedDriver(FaultyDriver):
    """The same for a robot that does not exist."""

    def __init__(self, driver: Driver, schedule: Schedule, robot: str) -> None:
        super().__init__(driver, schedule, robot)
        assert isinstance(driver, SimulatedDriver)
        self.truth = driver.truth

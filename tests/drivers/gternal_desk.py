"""A GTernal's motor controller on a port, whose time passes when a test lets it, or when its driver waits."""

import select
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from robofleet.core.clock import MS, SimulatedClock
from robofleet.drivers.gternal import GTernal
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.gternal import GTernalFirmware
from robofleet.simulation.serial_line import SerialLine
from robofleet.testing import serial_world
from robofleet.vehicles.interface import DriverContext, Simulation, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL

HEARD_S = 1.0  # at most: a pseudo-terminal takes a moment
LOOP_NS = 10 * MS

Result = TypeVar("Result")


class Desk:
    """``lines`` is what the driver has written; ``answer`` is what answers it."""

    def __init__(self, folder: Path) -> None:
        self.clock = SimulatedClock()
        self.port = folder / "gternal.tty"
        self.line = SerialLine(self.port)
        self.hardware = Hardware(GTERNAL, IDEAL, Plant(GTERNAL, IDEAL, (0.0, 0.0, 0.0), np.random.default_rng(1)))
        self.firmware = GTernalFirmware(self.hardware)
        self.lines: list[bytes] = []
        self.heard_ns = 0  # when the newest of them came
        self.unasked = b""  # what is said all the time while a driver waits
        self.answer: Callable[[bytes], bytes] = self.obey

    def obey(self, data: bytes) -> bytes:
        """Answer as a motor controller."""
        return self.firmware.receive(data, self.clock.now_ns())

    def make(self) -> GTernal:
        """Make a driver."""
        simulation = Simulation(
            drive=GTERNAL, imperfections=IDEAL, start=(0.0, 0.0, 0.0), trouble=None, rng=np.random.default_rng(1)
        )
        own = GTernal.Settings(port=str(self.port))
        return self.meanwhile(
            lambda: GTernal(
                DriverContext(robot="r1", drive=GTERNAL, simulation=simulation, now_ns=self.clock.now_ns, settings=own)
            )
        )

    def meanwhile(self, do: Callable[[], Result]) -> Result:
        """Let time pass while something waits for an answer."""
        with serial_world.shared(self.clock.now_ns, self._pass_until):
            return do()

    def hear(self, seconds: float = HEARD_S) -> None:
        """Take what was written, waiting so long for it at most, and answer."""
        if self.line.descriptor is None:
            self.line.read()
        readable = [] if self.line.descriptor is None else [self.line.descriptor]
        select.select(readable, [], [], seconds)
        self._answer()

    def tell(self, driver: GTernal, wheels: WheelSpeeds) -> WheelSpeeds:
        """Write, and return what the controller's motors are asked for then."""
        driver.write(wheels)
        self.hear()
        self.firmware.loop(self.clock.now_ns())
        return self.hardware.command

    def let_pass(self, loops: int, driver: GTernal) -> None:
        """Let time pass, 10 ms a loop; the driver is read in each of them, as its process does."""
        for _ in range(loops):
            self.clock.advance_to(self.clock.now_ns() + LOOP_NS)
            driver.read()
            self.hear(0.0)
            self.firmware.loop(self.clock.now_ns())

    def _pass_until(self, deadline_ns: int) -> int:
        self._answer()
        self.line.write(self.unasked)
        self.clock.advance_to(min(deadline_ns, self.clock.now_ns() + LOOP_NS))
        self.firmware.loop(self.clock.now_ns())
        return self.clock.now_ns()

    def _answer(self) -> None:
        if data := self.line.read():
            self.lines.append(data)
            self.heard_ns = self.clock.now_ns()
            self.line.write(self.answer(data))

"""A driver and its robot's firmware at two ends of a pseudo-terminal, in one thread, on the test's clock."""

import math
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Self
from unittest.mock import patch

import numpy as np

from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.drivers.arduino_bridge import ArduinoBridge
from robofleet.drivers.create2 import Create2
from robofleet.drivers.gternal import GTernal
from robofleet.drivers.rfp import Rfp
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.arduino_bridge import ArduinoBridgeFirmware
from robofleet.simulation.firmwares.create2 import Create2Firmware
from robofleet.simulation.firmwares.gternal import GTernalFirmware
from robofleet.simulation.firmwares.rfp import RfpFirmware
from robofleet.simulation.serial_line import SerialLine
from robofleet.testing.serial_world import shared
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import DriverContext, DriverReading, Imperfections, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import CREATE2, CREATE2_IDEAL, GTERNAL, IDEAL

COUNTS_PER_TURN, FRAME_S = 2000, 0.033  # of the Arduino's robot; 1000 / 30, in whole milliseconds
MM_S = 1e-3 / CREATE2.wheel_radius  # of a Create 2's wheel [rad/s]
Line = Callable[[bytes], bytes]


class LineBench:
    """The robot is there from the beginning; ``open`` makes its driver. Use it as a context.

    Attributes:
        received: What the robot has received, a piece each time that it listened.
        to_robot: Changes what is on its way to the robot.
        to_driver: Changes what is on its way to the driver.
        babble: What the robot says in each loop, beside what its firmware does.
    """

    def __init__(
        self, kind: Any, firmware: Any, drive: DifferentialDrive, imperfections: Imperfections, loop_ns: int,
        encoders: Imperfections | None = None,
    ) -> None:  # fmt: skip
        """Put the robot there; ``encoders``: of another firmware than the plant's."""
        self._kind, self._drive, self._period_ns = kind, drive, loop_ns
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        self._loop_ns = self.now_ns + loop_ns
        self.plant = Plant(drive, imperfections, (0.0, 0.0, 0.0), np.random.default_rng(1))
        self.hardware = Hardware(drive, encoders or imperfections, self.plant)
        self.firmware = firmware(self.hardware)
        self.to_robot: Line = bytes
        self.to_driver: Line = bytes
        self.babble = b""
        self.received: list[bytes] = []
        self.heard_ns = 0  # when it received something last
        self.driver: Any = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self.port, self.line = self.plug(stack)
            stack.callback(self.line.unplug)
            stack.enter_context(shared(self.clock.now_ns, self._pass_while_waiting))
            stack.callback(self._close)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.to_robot = self.to_driver = bytes
        self._stack.close()

    def plug(self, stack: ExitStack) -> tuple[Any, Any]:
        """Return the port, and the robot's end of the line."""
        port = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "r1.tty"
        return port, SerialLine(port)

    @property
    def now_ns(self) -> int:
        return self.clock.now_ns()

    def open(self, silent_s: float = 600.0, **settings: Any) -> Any:
        """Make the driver; while it waits for its robot, time passes. Its dead man's patience is real time."""
        made = self._kind.Settings.model_validate({"port": str(self.port), **settings})
        context = DriverContext(
            robot="r1", drive=self._drive, simulation=None, now_ns=self.clock.now_ns, settings=made
        )  # fmt: skip
        with patch("robofleet.drivers.dead_man.SILENT_S", silent_s):
            self.driver = self._kind(context)
        return self.driver

    def write(self, left: float, right: float) -> None:
        """Command the wheels [rad/s], and let the robot hear what is said of it."""
        self.driver.write(WheelSpeeds(left, right))
        self.hear()

    def read(self) -> DriverReading:
        reading: DriverReading = self.driver.read()
        self.hear()
        return reading

    def hear(self) -> bool:
        """Let the robot take what the driver has written, and answer it; returns whether that was something."""
        data = self.line.read()
        if data:
            self.received.append(data)
            self.heard_ns = self.now_ns
            self.say(self.firmware.receive(self.to_robot(data), self.now_ns))
        return bool(data)

    def say(self, data: bytes) -> None:
        """Let something come to the driver."""
        if data:
            self.line.write(self.to_driver(data))

    def let_pass(self, seconds: float) -> None:
        """Let time pass for the robot, which hears nothing."""
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns:
            before_ns = self.now_ns
            self.clock.advance_to(min(end_ns, self._loop_ns))
            self.plant.step(self.hardware.command, (self.now_ns - before_ns) / S)
            if self.now_ns == self._loop_ns:
                self._loop_ns += self._period_ns
                self.say(self.firmware.loop(self.now_ns))
                if self.babble:
                    self.line.write(self.babble)

    def skip(self, seconds: float) -> None:
        """Let time pass in which nothing happens."""
        self._loop_ns += round(seconds * S)
        self.clock.advance_to(self.now_ns + round(seconds * S))

    def pass_time(self, seconds: float, wheels: WheelSpeeds | None = None) -> list[DriverReading]:
        """Let time pass; the driver is read, and told ``wheels``, every 10 ms. Returns what was read."""
        readings = []
        for _ in range(round(seconds * 100)):
            self.let_pass(0.01)
            if wheels is not None:
                self.write(*wheels)
            readings.append(self.read())
        return readings

    def _close(self) -> None:
        if self.driver is not None:
            self.driver.close()

    def _pass_while_waiting(self, deadline_ns: int) -> None:
        self.hear()
        self.let_pass((min(deadline_ns, self._loop_ns) - self.now_ns) / S)


def create2() -> LineBench:
    return LineBench(Create2, Create2Firmware, CREATE2, CREATE2_IDEAL, 15 * MS)


def gternal() -> LineBench:
    return LineBench(GTernal, GTernalFirmware, GTERNAL, IDEAL, 10 * MS)


def arduino() -> LineBench:
    """Return a bench whose wheels turn as they are told, at once; the speed loop looks every millisecond."""
    encoders = replace(IDEAL, speed_quantum=math.tau / COUNTS_PER_TURN / FRAME_S, loop_period=FRAME_S)
    return LineBench(ArduinoBridge, ArduinoBridgeFirmware, GTERNAL, IDEAL, MS, encoders)


def rfp(firmware: Any = RfpFirmware) -> LineBench:
    """Return a bench whose wheels turn as its gate lets them, at once."""
    encoders = replace(IDEAL, speed_quantum=math.tau / COUNTS_PER_TURN / 0.005, loop_period=0.005)
    return LineBench(Rfp, firmware, GTERNAL, IDEAL, 5 * MS, encoders)

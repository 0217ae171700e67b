"""A Create 2's driver and its firmware's twin at two ends of a pseudo-terminal, in one thread, on the test's clock."""

import fcntl
import os
import select
import struct
import termios
import tty
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np

from robofleet.core.clock import MS
from robofleet.drivers.create2 import Create2
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.create2 import Create2Firmware
from robofleet.vehicles.interface import DriverContext, DriverReading, Imperfections, Simulation, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import CREATE2, CREATE2_IDEAL

LOOP_NS = 15 * MS
MM_S = 1e-3 / CREATE2.wheel_radius  # of a wheel [rad/s]
Line = Callable[[bytes], bytes]


def unchanged(data: bytes) -> bytes:
    return data


class Bench:
    """The robot is there from the beginning; ``open`` makes its driver."""

    def __init__(self, imperfections: Imperfections = CREATE2_IDEAL) -> None:
        self.plant = Plant(CREATE2, imperfections, (0.0, 0.0, 0.0), np.random.default_rng(1))
        self.hardware = Hardware(CREATE2, imperfections, self.plant)
        self.firmware = Create2Firmware(self.hardware)
        self.now_ns, self._loop_ns, self._waits = 0, LOOP_NS, False
        self.to_robot: Line = unchanged
        self.to_driver: Line = unchanged
        self.robot_end, self._terminal = os.openpty()  # held open, or the driver's end would hang up when it closes
        tty.setraw(self._terminal)
        self.port = os.ttyname(self._terminal)
        self._driver: Create2 | None = None

    @property
    def driver(self) -> Create2:
        assert self._driver is not None
        return self._driver

    def open(self, silent_s: float = 600.0, **settings: Any) -> Create2:
        """Make the driver; while it waits for its robot, time passes. Its dead man's patience is real time."""
        simulation = Simulation(
            drive=CREATE2,
            imperfections=CREATE2_IDEAL,
            start=(0.0, 0.0, 0.0),
            trouble=None,
            rng=np.random.default_rng(1),
        )
        made = Create2.Settings.model_validate({"port": self.port, **settings})
        self._waits = True
        try:
            with patch("robofleet.drivers.dead_man.SILENT_S", silent_s):
                self._driver = Create2(
                    DriverContext(robot="r1", drive=CREATE2, simulation=simulation, now_ns=self._now_ns, settings=made)
                )
        finally:
            self._waits = False
        return self._driver

    def close(self) -> None:
        self.close_driver()
        for descriptor in (self.robot_end, self._terminal):
            if descriptor >= 0:
                os.close(descriptor)

    def close_driver(self) -> None:
        if self._driver is not None and self.robot_end >= 0:
            self._waits = True
            self._driver.close()
            self._waits = False
            self.hear(0.0)
        elif self._driver is not None:
            self._driver.close()

    def unplug(self) -> None:
        os.close(self.robot_end)
        self.robot_end = -1

    def write(self, left: float, right: float) -> None:
        """Command the wheels [rad/s], and let the robot hear what is said of it."""
        with patch("os.write", wraps=os.write) as written:
            self.driver.write(WheelSpeeds(left, right))
        wrote = any(os.isatty(call.args[0]) for call in written.call_args_list)
        self.hear(1.0 if wrote else 0.0)

    def read(self) -> DriverReading:
        reading = self.driver.read()
        self.hear(0.0)
        return reading

    def heard(self, seconds: float = 1.0) -> bytes:
        """Return what the driver has written."""
        data = b""
        while select.select([self.robot_end], [], [], 0.0 if data else seconds)[0]:
            data += os.read(self.robot_end, 4096)
        return data

    def hear(self, seconds: float = 1.0) -> None:
        """Let the robot take what the driver has written."""
        data = self.to_robot(self.heard(seconds))
        if data:
            self.firmware.receive(data, self.now_ns)

    def pass_time(self, seconds: float, wheels: WheelSpeeds | None = None) -> list[DriverReading]:
        """Let time pass; the driver is read, and told ``wheels``, every 10 ms. Returns what was read."""
        readings = []
        for _ in range(round(seconds * 100)):
            self.let_pass(5 * MS)
            self.let_pass(5 * MS)
            if wheels is not None:
                self.write(*wheels)
            readings.append(self.read())
        return readings

    def _now_ns(self) -> int:
        if self._waits:
            self.hear(0.001)
            for _ in range(9):
                self.let_pass(5 * MS)
        return self.now_ns

    def let_pass(self, duration_ns: int) -> None:
        """Let time pass, one loop of the robot at most."""
        self.now_ns += duration_ns
        self.plant.step(self.hardware.command, duration_ns * 1e-9)
        if self.now_ns >= self._loop_ns:
            self._loop_ns += LOOP_NS
            self.say(self.firmware.loop(self.now_ns))

    def say(self, data: bytes) -> None:
        """Let something come to the driver: the kernel takes a moment to carry it."""
        data = self.to_driver(data)
        before = self._unread()
        os.write(self.robot_end, data)
        while self._unread() < before + len(data):
            select.select([], [], [], 0.0001)

    def _unread(self) -> int:
        return int(struct.unpack("i", fcntl.ioctl(self._terminal, termios.FIONREAD, bytes(4)))[0])

"""What is wrong with one robot: what it says of itself, and whether it can be reached at all."""

import math
import sys

from robofleet.processes.attached import in_words, sound
from robofleet.safety.gate import Latch
from robofleet.vehicles.interface import Driver, DriverReading, RobotFault

_PRESSED = int(RobotFault.WIRED_STOP)  # a plain number: the complement of a flag knows its own class's bits only
_UNREAD = DriverReading(0.0, 0.0, 0.0, 0.0, math.nan, 0)


class Health:
    """A robot's newest reading, and every reason to stop that it gives."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self.reading = _UNREAD
        self.failed = False  # it could not be written to or read from, in this loop or since
        self._away = False
        self._felt = 0  # faults since the gate was latched
        self._complaint = ""

    def look(self, driver: Driver, latch: Latch) -> bool:
        """Read the robot, whose gate is latched by ``latch``; returns whether it had failed in the last loop."""
        failed, self.failed = self.failed, False
        try:
            self.reading = sound(driver.read())
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self.fail(error)
        else:
            self._felt = self.reading.faults | (self._felt if latch else 0)
            if self._away and not failed:
                self._away = False
                self.complain("its driver has it again: look at the robot, then reset")
        return failed

    def fail(self, error: Exception) -> None:
        """Note that the robot could not be told or asked."""
        self.failed = self._away = True
        self.complain(f"its driver failed: {in_words(error)}")

    def complain(self, complaint: str) -> None:
        """Say it in the log, once."""
        if complaint != self._complaint:
            self._complaint = complaint
            print(f"{self._robot}: {complaint}", file=sys.stderr)

    @property
    def latch(self) -> Latch:
        """The robot's own reason to stop, while it lasts."""
        if self.failed:
            return Latch.DRIVER_FAILED
        if self.reading.faults & RobotFault.WIRED_STOP:
            return Latch.WIRED_STOP
        return Latch.ROBOT_FAULT if self.reading.faults else Latch.NONE

    def faults(self, latch: Latch) -> int:
        """Return what is said of it: what lasts, and what it felt since its gate was latched, however shortly.

        Its e-stop has a latch of its own, which says that it was pressed.
        """
        felt = self._felt & ~_PRESSED if latch else 0
        return self.reading.faults | felt | (RobotFault.UNREACHABLE if self.failed else 0)

"""What is wrong with one robot: what it says of itself, and whether it can be reached at all."""

import math
import sys

from robofleet.nodes.unit.attached import in_words, sound
from robofleet.safety import runaway
from robofleet.safety.latches import Latch
from robofleet.safety.runaway import Turning
from robofleet.vehicles.interface import STOP, Driver, DriverReading, RobotFault, WheelSpeeds

_PRESSED = int(RobotFault.WIRED_STOP)  # a plain number: the complement of a flag knows its own class's bits only
_UNREAD = DriverReading(0.0, 0.0, 0.0, 0.0, math.nan, 0)


def said_of_a_runaway(fastest: float) -> str:
    """Return what is said of a robot whose faster wheel turns by itself [rad/s]."""
    return f"a wheel turns by itself, {fastest:.1f} rad/s with an output of zero: switch off its power"


class Health:
    """A robot's newest reading, and every reason to stop that it gives."""

    def __init__(self, robot: str, now_ns: int) -> None:
        self._robot = robot
        self.reading = _UNREAD
        self.latch = Latch.NONE  # the robot's own reason to stop, while it lasts
        self.failed = False  # it could not be written to or read from, in this loop or since
        self._away = False
        self._felt = 0  # faults since the gate was latched
        self._turning = Turning(now_ns, now_ns)
        self._complaint = ""
        self._unsaid: list[str] = []

    def look(self, driver: Driver, latch: int, output: WheelSpeeds, now_ns: int) -> bool:
        """Read the robot, whose gate is latched by ``latch`` and gives ``output``.

        Returns whether it had failed in the last loop.
        """
        failed, self.failed = self.failed, False
        try:
            self.reading = sound(driver.read())
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self.fail(error)
        else:
            self._felt = self.reading.faults | (self._felt if latch else 0)
            if self._away and not failed:
                self._away = False
                self.complain("its driver has reconnected: look at the robot, then reset")
        fastest = 0.0 if self.failed else max(abs(self.reading.left_speed), abs(self.reading.right_speed))
        ran, self._turning = self._turning.runs, runaway.look(self._turning, output != STOP, fastest, now_ns)
        if self._turning.runs and not ran:
            self.complain(said_of_a_runaway(fastest))
        self.latch = self._reason()
        return failed

    def fail(self, error: Exception) -> None:
        """Note that the robot could not be told or asked."""
        self.failed = self._away = True
        self.latch = self._reason()
        self.complain(f"its driver failed: {in_words(error)}")

    def complain(self, complaint: str) -> None:
        """Have it said in the log, once."""
        if complaint != self._complaint:
            self._complaint = complaint
            self._unsaid.append(f"{self._robot}: {complaint}")

    def say(self) -> None:
        """Say it: a log may be slow, so the wheels and the bus go first."""
        if self._unsaid:
            lines, self._unsaid = self._unsaid, []
            print("\n".join(lines), file=sys.stderr)

    def _reason(self) -> Latch:
        if self.failed:
            return Latch.DRIVER_FAILED
        if self._turning.runs:
            return Latch.RUNAWAY
        if not self.reading.faults:
            return Latch.NONE
        return Latch.WIRED_STOP if self.reading.faults & _PRESSED else Latch.ROBOT_FAULT

    def faults(self, latch: int) -> int:
        """Return what is said of it: what lasts, and what it felt since its gate was latched, however shortly.

        Its e-stop has a latch of its own, which says that it was pressed.
        """
        felt = self._felt & ~_PRESSED if latch else 0
        return self.reading.faults | felt | (RobotFault.UNREACHABLE if self.failed else 0)

"""A robot's firmware, imitated from its protocol's public description: what a twin runs.

A firmware is bytes in, bytes out, and a loop; time comes in. It knows its own robot only by its ``Hardware``: motors
with encoders, a battery, what the robot feels, and its sensors. ``twin.py`` gives it a body, a serial port and its
troubles.
"""

import math
from collections.abc import Callable
from typing import Protocol

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, Imperfections, RobotFault
from robofleet.vehicles.plant import Plant
from robofleet.vehicles.readings import SensorReading


class Hardware:
    """What a firmware runs on. The wheel-speed loops of the plant aim at ``command`` [rad/s]."""

    def __init__(self, drive: DifferentialDrive, imperfections: Imperfections, plant: Plant) -> None:
        self.drive = drive  # as built into the firmware
        self.loop_period = imperfections.loop_period  # of its wheel-speed loop [s]
        self.radians_per_count = imperfections.speed_quantum * imperfections.loop_period
        self.command = STOP
        self.feels = RobotFault(0)  # BUMPED, CLIFF, WHEEL_DROPPED
        self.sense: Callable[[int], SensorReading] | None = None  # at an instant [ns]; None: it has no such sensors
        self._plant = plant

    @property
    def counts(self) -> tuple[int, int]:
        """Encoder counts since power-on, left and right, forward +."""
        reading = self._plant.reading()
        left, right = reading.left_angle / self.radians_per_count, reading.right_angle / self.radians_per_count
        return math.floor(left + 0.5), math.floor(right + 0.5)

    @property
    def charge(self) -> float:
        """Charge of the battery [0..1]."""
        return self._plant.charge


class Firmware(Protocol):
    """One kind's firmware, made from its :class:`Hardware`: then it has just been switched on.

    Found by the entry-point group ``robofleet.twins``, or as ``module:Class`` in ``robots[].twin``.
    """

    baud: int
    watchdog_s: float | None  # without a word for so long it stops its motors; None: it never does by itself
    # ``refusal()``, a static method, if it has one: why it cannot run on this computer; None: it can
    # ``target``, WheelSpeeds, if it has it: what it lets through [rad/s]; else its hardware's command is that
    # ``reports``, a RobotFault, if it has one: what it says of what its hardware feels; faults of touch need it

    def opened(self, now_ns: int) -> None:
        """The host opened the port: a board that resets by DTR starts anew."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes from the host, as they come; returns what is answered at once."""

    def loop(self, now_ns: int) -> bytes:
        """Run the wheel-speed loop, ``hardware.loop_period`` after the last time; returns what is said unasked."""

"""A robot that does not exist: the driver closes its loop through the plant of ``robofleet.vehicles.plant``."""

from typing import ClassVar

from robofleet.vehicles.interface import STOP, DriverContext, DriverReading, WheelSpeeds
from robofleet.vehicles.plant import WATCHDOG_NS, Plant
from robofleet.vehicles.readings import SensorReading, TruePose
from robofleet.vehicles.sensors import SimulatedSensors


class SimulatedRobot:
    """Integrates the plant up to the present whenever it is written to or read from."""

    body_faults: ClassVar[bool] = True

    def __init__(self, context: DriverContext) -> None:
        s = context.simulation
        assert s is not None, "a robot that does not exist is refused without one"
        self._now_ns = context.now_ns
        self._plant = (
            Plant(s.drive, s.imperfections, s.start, s.rng, now_ns=context.now_ns(), trouble=s.trouble)
            if s.plant is None
            else s.plant.robot(context.robot, s.trouble)
        )
        own = s.sensing  # it sees walls alone: it knows of no other robot
        self._sensors = None if own is None else SimulatedSensors([0], [own])
        self._sensed: SensorReading | None = None
        self._sense_ns = 0

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels from now on [rad/s]."""
        now_ns = self._advance()
        self._plant.write(wheels, off_ns=now_ns + WATCHDOG_NS)

    def read(self) -> DriverReading:
        """Return encoders and battery now, and its sensors as read last."""
        now_ns = self._advance()
        reading = self._plant.reading()
        if self._sensors is None:
            return reading
        if not self._sense_ns - self._sensors.period_ns <= now_ns < self._sense_ns:
            self._sense_ns = now_ns + self._sensors.period_ns
            self._sensed = self._sensors.first(now_ns, [self._plant.truth()], [0.0])
        return reading._replace(sensors=self._sensed)

    def truth(self) -> TruePose:
        """Return the true pose now."""
        self._advance()
        return self._plant.truth()

    def close(self) -> None:
        """Motors off."""
        self.write(STOP)

    def _advance(self) -> int:
        now_ns = self._now_ns()
        self._plant.advance(now_ns)
        return now_ns

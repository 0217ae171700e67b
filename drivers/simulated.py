"""A robot that does not exist: the driver closes its loop through the plant of ``robofleet.vehicles.plant``."""

from collections import deque

from robofleet.vehicles.interface import STOP, BodyTrouble, DriverContext, DriverReading, TruePose, WheelSpeeds
from robofleet.vehicles.plant import Plant

_NS = 1e-9
_HEALTHY = BodyTrouble()
_SILENT_NS = 200_000_000  # the firmware's own watchdog: without a word for so long the motors go off


class SimulatedRobot:
    """Integrates the plant up to the present whenever it is written to or read from."""

    def __init__(self, context: DriverContext) -> None:
        sim = context.simulation
        self._now_ns = context.now_ns
        self._plant = Plant(sim.drive, sim.imperfections, sim.start, sim.rng)
        self._longest_step_ns = round(sim.imperfections.loop_period / _NS)
        self._trouble = sim.trouble
        self._delay_ns = round(sim.imperfections.actuation_delay / _NS)
        self._command = STOP
        self._coming: deque[tuple[int, WheelSpeeds]] = deque()  # commands that do not act yet, and when they will
        self._reached_ns = context.now_ns()
        self._off_ns = self._reached_ns

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels from now on [rad/s]."""
        self._advance()
        self._coming.append((self._reached_ns + self._delay_ns, wheels))
        self._off_ns = self._reached_ns + _SILENT_NS

    def read(self) -> DriverReading:
        """Return encoders and battery now."""
        self._advance()
        return self._plant.reading()

    def truth(self) -> TruePose:
        """Return the true pose now."""
        self._advance()
        return self._plant.truth()

    def close(self) -> None:
        """Motors off."""
        self.write(STOP)

    def _advance(self) -> None:
        now_ns = self._now_ns()
        stuck, slip = _HEALTHY if self._trouble is None else self._trouble()
        while self._reached_ns < now_ns:
            while self._coming and self._coming[0][0] <= self._reached_ns:
                _, self._command = self._coming.popleft()
            step_ns = min(now_ns - self._reached_ns, self._longest_step_ns)
            if self._coming:
                step_ns = min(step_ns, self._coming[0][0] - self._reached_ns)
            elif self._reached_ns >= self._off_ns:
                self._command = STOP
            self._plant.step(self._command, step_ns * _NS, blocked=stuck, slip=slip)
            self._reached_ns += step_ns

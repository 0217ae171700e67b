"""A simulated robot's body in time: the plant, advanced exactly to the instants at which commands act."""

from collections import deque

from robofleet.vehicles.interface import STOP, BodyTrouble, Simulation, WheelSpeeds
from robofleet.vehicles.plant import Plant

_NS = 1e-9
_HEALTHY = BodyTrouble()


class SimulatedBody:
    """A plant that stands where it was put at ``now_ns``, told to stop."""

    def __init__(self, simulation: Simulation, now_ns: int) -> None:
        imperfections = simulation.imperfections
        self.plant = Plant(simulation.drive, imperfections, simulation.start, simulation.rng)
        self._trouble = simulation.trouble
        self._longest_step_ns = round(imperfections.loop_period / _NS)
        self._delay_ns = round(imperfections.actuation_delay / _NS)
        self._command = STOP
        self._coming: deque[tuple[int, WheelSpeeds]] = deque()  # commands that do not act yet, and when they will
        self._reached_ns = now_ns

    def command(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s] at the instant that was reached; they follow after the actuation delay."""
        self._coming.append((self._reached_ns + self._delay_ns, wheels))

    def advance(self, now_ns: int) -> None:
        """Let time pass until then [ns]; an instant that was reached already changes nothing."""
        if now_ns <= self._reached_ns:
            return
        stuck, slip, left, right, pushed = _HEALTHY if self._trouble is None else self._trouble()
        while self._reached_ns < now_ns:
            while self._coming and self._coming[0][0] <= self._reached_ns:
                _, self._command = self._coming.popleft()
            step_ns = min(now_ns - self._reached_ns, self._longest_step_ns)
            if self._coming:
                step_ns = min(step_ns, self._coming[0][0] - self._reached_ns)
            self.plant.step(self._command, step_ns * _NS, blocked=stuck, slip=slip, runs=(left, right))
            if pushed != _HEALTHY.pushed:
                self.plant.push(pushed[0] * step_ns * _NS, pushed[1] * step_ns * _NS)
            self._reached_ns += step_ns

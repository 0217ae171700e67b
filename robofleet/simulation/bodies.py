"""Many simulated robots' bodies at once: the equations of ``vehicles/plant.py``, compiled, on rows of arrays."""

import math
from collections.abc import Callable, Sequence
from dataclasses import astuple
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel, kernel_of_plain
from robofleet.core.rows import row_type
from robofleet.vehicles import plant
from robofleet.vehicles.interface import DriverContext
from robofleet.vehicles.plant import DRAWS, RANDOM_BLOCK, WATCHDOG_NS, Body, Build, Coming, built
from robofleet.vehicles.sensors import SimulatedSensors

BODY, BUILD, COMING = row_type(Body), row_type(Build), row_type(Coming)
_CALLS = 32  # after so many the random numbers are counted anew

advance, measured = kernel_of_plain(plant.advance), kernel_of_plain(plant.measured)
command = kernel_of_plain(plant.command)


class Sensors(NamedTuple):
    """What a robot's sensors say in spite of what is there."""

    faults: int = 0  # of vehicles.interface.RobotFault
    charge: float = math.nan  # of the battery; NaN: as it is


class Bodies:
    """The bodies of robots (N,); each stands where it was put, told to stop."""

    def __init__(self, contexts: Sequence[DriverContext]) -> None:
        self.sensors: list[tuple[int, Callable[[], Sensors]]] = []  # rows, and what their sensors say wrongly
        self._now_ns = contexts[0].now_ns
        simulations = [context.simulation for context in contexts if context.simulation is not None]
        assert len(simulations) == len(contexts), "a robot that does not exist is refused without one"
        n, now_ns = len(contexts), self._now_ns()
        self._rngs = [s.rng for s in simulations]
        self._troubles = [(row, s.trouble) for row, s in enumerate(simulations) if s.trouble is not None]
        builds = [built(s.drive, s.imperfections, s.rng) for s in simulations]
        self.builds = np.array([astuple(build) for build in builds], BUILD)
        self.bodies = np.array([astuple(plant.placed(s.start, now_ns)) for s in simulations], BODY)
        self._records = self.bodies.view(np.recarray)
        self.coming = np.zeros((n, max(plant.capacity(build.delay_ns) for build in builds)), COMING)
        self.radii = np.array([s.radius for s in simulations])
        sensing = [(row, s.sensing) for row, s in enumerate(simulations) if s.sensing is not None]
        self.sensing = SimulatedSensors(*zip(*sensing, strict=True)) if sensing else None
        self._step_ns = min(build.longest_step_ns for build in builds)
        self._noisy = any(build.slip for build in builds)
        self._enough_ns, self._calls = now_ns, 0  # until when the random numbers last, for so many calls
        self.noise = np.zeros((n, 2 * RANDOM_BLOCK))  # two blocks a robot
        if self._noisy:
            for row in range(n):
                self._draw(row, 0)
                self._draw(row, 1)

    def prepare(self) -> int:
        """Make ready for kernels that let time pass up to the present, and return that instant [ns]."""
        now_ns = self._now_ns()
        for row, trouble in self._troubles:
            if now_ns > self.bodies[row]["reached_ns"]:
                plant.befall(self._records[row], trouble())
        for row, sensors in self.sensors:
            troubles = sensors()
            self.bodies[row]["faults"], self.bodies[row]["low_charge"] = troubles
        if self._noisy:
            self._supply(now_ns)
        return now_ns

    def row(self, row: int) -> tuple[Any, Any, Any, Any]:
        """Return a robot's part of the arrays, as kernels take it."""
        return self.bodies[row], self.builds[row], self.coming[row], self.noise[row]

    def write(self, row: int, left: float, right: float) -> None:
        """Command a robot's wheels from now on [rad/s]."""
        write(*self.row(row), left, right, self.prepare())

    def truths(self) -> NDArray[np.float64]:
        """Return where the robots really are now, and how they move (N, 5): x, y, psi, v, omega."""
        advance_all(self.bodies, self.builds, self.coming, self.noise, self.prepare())
        b = self.bodies
        return np.stack([b[name] for name in ("x", "y", "psi", "v", "omega")], axis=1)

    def sense(self) -> NDArray[np.float64]:
        """Return what the sensors say now, as ``SimulatedSensors.read``; only where a robot has some."""
        assert self.sensing is not None
        truths = self.truths()
        return self.sensing.read(int(self.bodies["reached_ns"].max()), truths, self.radii)

    def _supply(self, now_ns: int) -> None:
        """Let there be random numbers enough until an instant; robots that need more than fit are brought there."""
        self._calls += 1
        if now_ns <= self._enough_ns and self._calls < _CALLS:
            return
        self._refill()
        b = self.bodies
        reached_ns, coming = int(b["reached_ns"].min()), int(b["waiting"].max())
        steps = (now_ns - reached_ns) // self._step_ns + coming + 3
        left = (2 * RANDOM_BLOCK - int(b["drawn"].max())) // DRAWS
        if steps <= left:
            # Between two calls a robot is told twice at most: each word can cut one step in two.
            self._calls, spare = 0, left - coming - 3 - 2 * _CALLS
            self._enough_ns = reached_ns + max(0, spare) * self._step_ns
            return
        while DRAWS * steps > RANDOM_BLOCK and (b["reached_ns"] < now_ns).any():
            advance_all(b, self.builds, self.coming, self.noise, now_ns)
            self._refill()

    def _refill(self) -> None:
        drawn = self.bodies["drawn"]
        for row in np.flatnonzero(drawn >= RANDOM_BLOCK).tolist():
            # The block that is under way comes first, a new one behind it.
            self.noise[row, :RANDOM_BLOCK] = self.noise[row, RANDOM_BLOCK:]
            drawn[row] -= RANDOM_BLOCK
            self._draw(row, 1)

    def _draw(self, row: int, block: int) -> None:
        self.noise[row, block * RANDOM_BLOCK : (block + 1) * RANDOM_BLOCK] = plant.random_numbers(self._rngs[row])


@kernel
def advance_all(bodies, builds, coming, noise, now_ns):  # type: ignore[no-untyped-def]
    """Let time pass for every robot (N,) until an instant [ns]; one that was reached already changes nothing."""
    for row in range(len(bodies)):
        advance(bodies[row], builds[row], coming[row], noise[row], now_ns)


@kernel
def write(b, p, coming, noise, left, right, now_ns):  # type: ignore[no-untyped-def]
    """Command a robot's wheels from an instant on [rad/s]."""
    advance(b, p, coming, noise, now_ns)
    command(b, p, coming, left, right, now_ns + WATCHDOG_NS)

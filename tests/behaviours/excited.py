"""The calibrating drive, and behind it what the wheels can do of it: as the controller has them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.excitation import Excitation, Manoeuvre
from robofleet.control import wheels
from robofleet.testing import situation, team
from robofleet.testing.behaviours import AHEAD
from tests.robots import GTERNAL

Array = NDArray[np.float64]

RADIUS = 0.055


class Excited:
    """A drive of GTernals."""

    def __init__(self, robots: int, manoeuvres: Mapping[str, Sequence[Manoeuvre]] | None = None) -> None:
        settings = Excitation.Settings(manoeuvres={name: tuple(own) for name, own in (manoeuvres or {}).items()})
        self.behaviour = Excitation(settings, team(robots))
        self._limits = wheels.limits((GTERNAL,) * robots)

    @property
    def ends(self) -> Array:
        """When each robot's script ends (N,) [s]."""
        return np.asarray(self.behaviour.ends)

    def restart(self) -> None:
        """Begin a new run."""
        self.behaviour.restart()

    def tick(self, t: float, poses: Array, driving: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the wheels' speeds (N, 2) [rad/s], and who is held (N,)."""
        n = len(poses)
        decision = self.behaviour.decide(replace(situation(poses, t), driving=driving))
        request = wheels.limited(
            decision.velocities, np.full(n, decision.of == "body"), poses, AHEAD, self._limits, driving
        )
        return request.wheels, np.broadcast_to(np.asarray(decision.figures["held"], dtype=np.float64), n).copy()

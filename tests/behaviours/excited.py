"""The calibrating drive, and behind it what the wheels can do of it: as the controller has them."""

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.excitation import Excitation
from robofleet.behaviours.interface import Flow, Situation, Team
from robofleet.control import wheels
from robofleet.safety.distances import Body, Keepout
from tests.robots import GTERNAL

Array = NDArray[np.float64]

RADIUS, TICK, AHEAD, ARENA = 0.055, 0.033, 0.08, (3.2, 2.0)
KEEPOUT = Keepout(
    gap=0.015, ahead=0.01, rate=10.0, pose_error=0.002, age=0.06, lost_after=0.5, point_ahead=AHEAD, tick=TICK,
    arena=ARENA,
)  # fmt: skip


class Excited:
    """A drive of GTernals."""

    def __init__(self, robots: int, seed: int) -> None:
        body, ids = Body(GTERNAL, RADIUS, 0.002), tuple(f"r{k + 1}" for k in range(robots))
        self.behaviour = Excitation(
            Excitation.Settings(),
            Team(
                name="drive", robots=ids, drives=(GTERNAL,) * robots, bodies=(body,) * robots, starts=(None,) * robots,
                bystanders=(), keepout=KEEPOUT, arena=ARENA, tick=TICK, delay=0.002, point_ahead=AHEAD,
                flow=Flow(45.0, 0.6, "exact"), rng=np.random.default_rng(seed),
            ),
        )  # fmt: skip
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
        decision = self.behaviour.decide(
            Situation(t=t, poses=poses, driving=driving, disturbance=np.zeros((n, 2)), others=np.empty((0, 3)))
        )
        request = wheels.limited(
            decision.velocities, np.full(n, decision.of == "body"), poses, AHEAD, self._limits, driving
        )
        return request.wheels, np.broadcast_to(np.asarray(decision.figures["held"], dtype=np.float64), n).copy()

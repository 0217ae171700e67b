"""The task coverage: the robots spread over the arena so that every place is near to one of them.

All earn alike by what the locational cost falls: the mean of the squared distances from places to their nearest robots.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from robofleet.behaviours.coverage import places
from robofleet.behaviours.interface import Team
from robofleet.core.arrays import Array, Indices
from robofleet.core.kernels import kernel
from robofleet.core.settings import Model, within
from robofleet.policies.interface import MOTION, Task, TaskView, Term, top_speeds
from robofleet.policies.observations import NEIGHBOUR, nearness, neighbours, rays

_BEARINGS = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)


class Coverage(Task):
    """Robots that spread."""

    class Settings(Model):
        """Keys of the task."""

        cells: Annotated[int, within(4, 200)] = 16
        """Places along the arena's longer side."""
        neighbours: Annotated[int, within(1, 32)] = 3
        """How many of the nearest robots are observed."""
        range_m: Annotated[float, within(0.1, 100)] = 2.0
        """What is farther away is not observed."""

    settings: Settings

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._places, self._cost = places(team.arena, settings.cells), np.zeros(arenas)
        self._most = float(top_speeds(team)[:, 0].max()) * team.tick * max(team.arena) / len(team)  # of a tick [m2]

    @property
    def terms(self) -> Sequence[Term]:
        return (
            *MOTION,
            Term("rays", len(_BEARINGS), "m", 1.0),
            Term("neighbours", NEIGHBOUR * self.settings.neighbours, "m", 1.0),
        )

    def observe(self, view: TaskView) -> Sequence[Array]:
        s, poses, others = self.settings, view.poses, view.others
        seen = rays(poses, others, self.team, _BEARINGS, s.range_m), neighbours(view, s.neighbours, s.range_m)
        return view.velocities[..., :1], view.velocities[..., 1:], *seen

    def reward(self, view: TaskView) -> Array:
        cost = self._locational_cost(view.poses)
        fell, self._cost = (self._cost - cost) / self._most, cost
        return np.asarray(fell[:, None] - nearness(view.gaps))

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        self._cost[arenas] = self._locational_cost(poses)

    def _locational_cost(self, poses: Array) -> Array:
        """Return the cost (A,) [m2]."""
        found = np.empty(len(poses))
        _mean_squared(self._places, poses, found)
        return found


@kernel
def _mean_squared(places: Array, poses: Array, found: Array) -> None:
    """Write the mean of the squared distances from places (M, 2) to the nearest of the robots (A, N, 3) [m2]."""
    for a in range(len(poses)):
        total = 0.0
        for k in range(len(places)):
            least = np.inf
            for i in range(poses.shape[1]):
                x, y = poses[a, i, 0] - places[k, 0], poses[a, i, 1] - places[k, 1]
                least = min(least, x * x + y * y)
            total += least
        found[a] = total / len(places)


KERNELS = (_mean_squared,)  # that are called from Python

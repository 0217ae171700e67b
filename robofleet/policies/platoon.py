"""The task platoon: the leader follows a closed path on time, every other robot the one ahead of it along the path."""

from collections.abc import Sequence

import numpy as np

from robofleet.behaviours.interface import Line, Shape, Team
from robofleet.behaviours.paths import PathFile
from robofleet.core.arrays import Array, Indices
from robofleet.core.settings import Model, Positive
from robofleet.policies.following import Following, Targets
from robofleet.policies.interface import TaskView

_OFF_M, _OFF_RAD = 0.02, 0.3  # of starts from their places on the path, at most


class Platoon(Following):
    """Robots one behind the other."""

    class Settings(Model):
        """Keys of the task: as those of the behaviour of this name."""

        path: PathFile
        """Path that the leader follows."""
        spacing_m: Positive
        """Distance of each robot's centre from that of the robot ahead."""
        path_rate: Positive
        """Speed of the leader's target, in sides of the path per second."""

    settings: Settings

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._path, self._begin = settings.path.path(), np.zeros(arenas)
        self._near = np.full((arenas, len(team)), np.nan)  # parameter of the path, of each robot

    def targets(self, view: TaskView) -> Targets:
        points = np.ascontiguousarray(view.poses[..., :2]).reshape(-1, 2)
        self._near = self._path.nearest(points, self._near.reshape(-1)).reshape(self._near.shape)
        back = self._path.back(self._near[:, :-1].reshape(-1), self.settings.spacing_m)
        leader = self._begin + self.settings.path_rate * view.t
        sigma = np.column_stack([leader, back.reshape(len(leader), -1)])
        return Targets(self._path.position(sigma), self.settings.path_rate * self._path.derivative(sigma))

    def starts(self, count: int, rng: np.random.Generator) -> Array:
        """Return places one behind the other, anywhere on the path."""
        sigma, found = rng.uniform(0.0, self._path.sides, count), np.empty((count, len(self.team), 3))
        for robot in range(len(self.team)):
            found[:, robot, :2] = self._path.position(sigma)
            found[:, robot, 2] = np.arctan2(*self._path.tangent(sigma).T[::-1])
            sigma = self._path.back(sigma, self.settings.spacing_m)
        return found + rng.uniform(-1.0, 1.0, found.shape) * (_OFF_M, _OFF_M, _OFF_RAD)

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        self._begin[arenas], self._near[arenas] = self._path.nearest(poses[:, 0, :2]), np.nan

    def shapes(self) -> Sequence[Shape]:
        return (Line("path", self._path.position(np.linspace(0.0, self._path.sides, 400)), closed=True, directed=True),)

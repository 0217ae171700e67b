"""The task pursuit: the group's first robot flees, and the others chase it until one is near. Both learn."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from robofleet.behaviours.interface import Team
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.settings import Model, within
from robofleet.policies.interface import MOTION, Task, TaskView, Term, top_speeds
from robofleet.policies.observations import NEIGHBOUR, away, in_frames, nearness, neighbours, rays

_BEARINGS = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)


class Pursuit(Task):
    """One network chases and flees: its first number says which."""

    class Settings(Model):
        """Keys of the task."""

        catch_m: Annotated[float, within(0.01, 10)] = 0.2
        """A chaser whose centre is so near has caught."""
        neighbours: Annotated[int, within(1, 32)] = 3
        """How many of the nearest robots are observed."""
        range_m: Annotated[float, within(0.1, 100)] = 1.0
        """What is farther away is not observed, but for the one that flees."""

    settings: Settings

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._left, self._flees = np.zeros((arenas, len(team))), np.arange(len(team)) == 0
        self._most = top_speeds(team)[:, 0] * team.tick  # way of a tick [m]

    @property
    def terms(self) -> Sequence[Term]:
        near = Term("neighbours", NEIGHBOUR * self.settings.neighbours, "m", 0.5)
        return Term("flees", 1), Term("prey", 2, "m", 1.0), *MOTION, Term("rays", len(_BEARINGS), "m", 1.0), near

    def observe(self, view: TaskView) -> Sequence[Array]:
        s, poses, others = self.settings, view.poses, view.others
        flees = np.broadcast_to(self._flees[:, None], (*poses.shape[:2], 1))
        seen = rays(poses, others, self.team, _BEARINGS, s.range_m), neighbours(view, s.neighbours, s.range_m)
        return flees, in_frames(poses, poses[:, :1, :2]), view.velocities[..., :1], view.velocities[..., 1:], *seen

    def reward(self, view: TaskView) -> Array:
        """Return the share of the top speed with which a chaser came nearer, or the nearest one fell behind."""
        left = self._distances(view.poses)
        nearer, self._left = (self._left - left) / self._most, left
        return np.asarray(np.where(self._flees, 0.1 - nearer, nearer - 0.1) - nearness(view.gaps))

    def done(self, view: TaskView) -> Flags:
        return np.asarray(self._distances(view.poses)[:, 0] < self.settings.catch_m)

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        self._left[arenas] = self._distances(poses)

    def _distances(self, poses: Array) -> Array:
        """Return each chaser's distance from the one that flees (A, N), in whose column is the least of them [m]."""
        found = away(poses, poses[:, :1])
        found[:, 0] = found[:, 1:].min(axis=1, initial=np.inf)
        return found

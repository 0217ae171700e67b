"""What tasks share in which every robot follows a target that moves."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array
from robofleet.policies.interface import MOTION, Task, TaskView, Term
from robofleet.policies.observations import NEIGHBOUR, away, in_frames, nearness, neighbours

_NEIGHBOURS = 2
_RANGE_M = 1.0
_HALF_M = 0.05  # so far from its target a robot earns half


class Targets(NamedTuple):
    """Where robots are to be.

    Attributes:
        points: (A, N, 2) [m; world].
        velocities: (A, N, 2) [m/s; world].
    """

    points: Array
    velocities: Array


class Following(Task):
    """Each robot's centre at its target. ``targets`` must be written."""

    _looked: tuple[TaskView, Targets] | None = None

    def targets(self, view: TaskView) -> Targets:
        """Return where the robots are to be."""
        raise NotImplementedError

    @property
    def terms(self) -> Sequence[Term]:
        target, velocity = Term("target", 2, "m", 0.25), Term("target_velocity", 2, "m/s", 0.2)
        return target, velocity, *MOTION, Term("neighbours", NEIGHBOUR * _NEIGHBOURS, "m", 0.5)

    def observe(self, view: TaskView) -> Sequence[Array]:
        targets = self._targets(view)
        along = in_frames(view.poses, view.poses[..., :2] + targets.velocities)
        near = neighbours(view, _NEIGHBOURS, _RANGE_M)
        return in_frames(view.poses, targets.points), along, view.velocities[..., :1], view.velocities[..., 1:], near

    def reward(self, view: TaskView) -> Array:
        """Return 1 at the target and half of it 5 cm away, less for being near others."""
        off = away(view.poses, self._targets(view).points)
        return np.asarray(_HALF_M / (_HALF_M + off) - nearness(view.gaps))

    def _targets(self, view: TaskView) -> Targets:
        """Return the targets, which are searched once a tick."""
        if self._looked is None or self._looked[0] is not view:
            self._looked = view, self.targets(view)
        return self._looked[1]

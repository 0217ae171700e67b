"""The task formation: a rigid shape moves along a closed path, and each robot keeps its place in it."""

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Line, Refusal, Shape, Team
from robofleet.behaviours.paths import PathFile
from robofleet.core.arrays import Array, Indices
from robofleet.core.settings import ROBOTS, Coordinate, Model, Positive
from robofleet.policies.following import Following, Targets
from robofleet.policies.interface import TaskView

_STEP_S = 0.01  # between the two places by which a velocity is found


class Formation(Following):
    """A shape that moves. It begins where the path is nearest to the robots' middle."""

    class Settings(Model):
        """Keys of the task: as those of the behaviour of this name."""

        path: PathFile
        """Path of the shape's origin."""
        path_rate: Positive
        """Speed of the shape's origin, in sides of the path per second."""
        offsets_m: Annotated[
            tuple[Annotated[tuple[Coordinate, Coordinate], Field(strict=False)], ...],
            Field(min_length=1, max_length=ROBOTS, strict=False),
        ]
        """Place of each robot in the shape, in the group's order: forwards and to the left of the origin."""

    settings: Settings

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._path, self._begin = settings.path.path(), np.zeros(arenas)

    def targets(self, view: TaskView) -> Targets:
        sigma = self._begin + self.settings.path_rate * view.t
        points = self._places(sigma)
        return Targets(points, (self._places(sigma + self.settings.path_rate * _STEP_S) - points) / _STEP_S)

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        self._begin[arenas] = self._path.nearest(poses[..., :2].mean(axis=1))

    def refusals(self) -> Iterator[Refusal]:
        if len(self.settings.offsets_m) != len(self.team):
            message = f"has {len(self.settings.offsets_m)} places for {len(self.team)} robots: write one for each"
            yield Refusal("offsets_m", message)

    def shapes(self) -> Sequence[Shape]:
        return (Line("path", self._path.position(np.linspace(0.0, self._path.sides, 400)), closed=True, directed=True),)

    def _places(self, sigma: Array) -> Array:
        """Return the robots' places (A, N, 2) where the shape's origin is at ``sigma`` (A,) [m; world]."""
        x, y = self._path.tangent(sigma).T[:, :, None]
        forwards, left = np.array(self.settings.offsets_m).T
        turned = np.stack([x * forwards - y * left, y * forwards + x * left], axis=-1)
        return np.asarray(self._path.position(sigma)[:, None] + turned)

"""The task go_to: every robot to a goal of its own, without touching anything."""

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours.go_to import Goal
from robofleet.behaviours.interface import Dots, Refusal, Shape, Team
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.settings import ROBOTS, Model, Name, within
from robofleet.policies.interface import MOTION, Task, TaskView, Term, top_speeds
from robofleet.policies.observations import NEIGHBOUR, away, drawn_poses, in_frames, nearness, neighbours


class GoTo(Task):
    """Each robot to its goal; an episode is done when all are there."""

    class Settings(Model):
        """Keys of the task."""

        goals: dict[Name, Goal] = Field({}, max_length=ROBOTS)
        """Where each robot is to be, by the robot's id, as the behaviour of this name has it; headings do not count.
        Without it each episode draws goals."""
        accuracy_m: Annotated[float, within(0.001, 1)] = 0.05
        """A robot within this distance of its goal is there."""
        neighbours: Annotated[int, within(1, 32)] = 3
        """How many of the nearest robots are observed."""
        range_m: Annotated[float, within(0.1, 100)] = 1.0
        """Robots farther away are not observed."""

    settings: Settings
    duration_s = 30.0

    def __init__(self, settings: Settings, team: Team, arenas: int) -> None:
        super().__init__(settings, team, arenas)
        self._goals, self._left = np.zeros((arenas, len(team), 2)), np.zeros((arenas, len(team)))
        self._most = top_speeds(team)[:, 0] * team.tick  # way of a tick [m]

    @property
    def terms(self) -> Sequence[Term]:
        return Term("goal", 2, "m", 1.0), *MOTION, Term("neighbours", NEIGHBOUR * self.settings.neighbours, "m", 0.5)

    def observe(self, view: TaskView) -> Sequence[Array]:
        near = neighbours(view, self.settings.neighbours, self.settings.range_m)
        return in_frames(view.poses, self._goals), view.velocities[..., :1], view.velocities[..., 1:], near

    def reward(self, view: TaskView) -> Array:
        """Return the share of the top speed with which the goal came nearer, less for the time and for being near."""
        left = away(view.poses, self._goals)
        nearer, self._left = (self._left - left) / self._most, left
        return np.asarray(nearer - 0.1 * (left > self.settings.accuracy_m) - nearness(view.gaps))

    def done(self, view: TaskView) -> Flags:
        return np.asarray((away(view.poses, self._goals) <= self.settings.accuracy_m).all(axis=1))

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        given = self.settings.goals
        drawn = [given[robot].pose for robot in self.team.robots] if given else drawn_poses(self.team, len(arenas), rng)
        self._goals[arenas] = np.asarray(drawn)[..., :2]
        self._left[arenas] = away(poses, self._goals[arenas])

    def refusals(self) -> Iterator[Refusal]:
        """Yield robots without a goal, and goals without a robot, where goals are given."""
        for robot in self.settings.goals:
            if robot not in self.team.robots:
                yield Refusal(f"goals.{robot}", f"{robot} is not in the group: remove its goal")
        for robot in self.team.robots if self.settings.goals else ():
            if robot not in self.settings.goals:
                yield Refusal("goals", f"{robot} has no goal: add `{robot}: {{x_m: ..., y_m: ...}}`, or remove all")

    def shapes(self) -> Sequence[Shape]:
        return (Dots("goals", self._goals[0]),)

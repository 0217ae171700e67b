"""The task go_to: every robot to a pose of its own, without touching anything."""

from collections.abc import Iterator, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.behaviours.go_to import Goal
from robofleet.behaviours.interface import Dots, Refusal, Shape, Team
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.settings import ROBOTS, Model, Name, within
from robofleet.policies.interface import Task, Term, View, top_speeds
from robofleet.policies.observations import drawn_poses, neighbours, pose_in_frames


class GoTo(Task):
    """Each robot to its goal; an episode is done when all are there."""

    class Settings(Model):
        """Keys of the task."""

        goals: dict[Name, Goal] = Field({}, max_length=ROBOTS)
        """Goal of each robot, by the robot's id. Without it every episode draws goals."""
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
        self._goals, self._left = np.zeros((arenas, len(team), 3)), np.zeros((arenas, len(team)))

    @property
    def terms(self) -> Sequence[Term]:
        s = self.settings
        return (
            Term("goal", 2, "m", 1.0),
            Term("goal_heading", 2),
            Term("speed", 1, "m/s", 0.2),
            Term("turn_rate", 1, "rad/s", 3.0),
            Term("neighbours", 3 * s.neighbours, "m", 1.0),
        )

    def observe(self, view: View) -> Sequence[Array]:
        goal = pose_in_frames(view.poses, self._goals)
        near = neighbours(view.poses, view.others, self.settings.neighbours, self.settings.range_m)
        return goal[..., :2], goal[..., 2:], view.velocities[..., :1], view.velocities[..., 1:], near

    def reward(self, view: View) -> Array:
        """What the way became shorter [tenths of the top speed's way], less for being near others."""
        left = self._distances(view.poses)
        nearer, self._left = self._left - left, left
        per_tick = top_speeds(self.team)[:, 0] * self.team.tick
        there = left < self.settings.accuracy_m
        return np.asarray(nearer / per_tick + 0.5 * there - 1.0 * (view.gaps < 0.02) - 0.1)

    def done(self, view: View) -> Flags:
        return np.asarray((self._distances(view.poses) < self.settings.accuracy_m).all(axis=1))

    def begin(self, arenas: Indices, poses: Array, rng: np.random.Generator) -> None:
        goals = self.settings.goals
        if goals:
            self._goals[arenas] = [goals[robot].pose for robot in self.team.robots]
        else:
            self._goals[arenas] = drawn_poses(self.team, len(arenas), rng)
        self._left[arenas] = np.hypot(*np.moveaxis(self._goals[arenas] - poses, 2, 0)[:2])

    def refusals(self) -> Iterator[Refusal]:
        """Yield robots without a goal, and goals without a robot, where goals are given."""
        for robot in self.settings.goals:
            if robot not in self.team.robots:
                yield Refusal(f"goals.{robot}", f"{robot} is not in the group: remove its goal")
        for robot in self.team.robots if self.settings.goals else ():
            if robot not in self.settings.goals:
                yield Refusal("goals", f"{robot} has no goal: add `{robot}: {{x_m: ..., y_m: ...}}`, or remove all")

    def shapes(self) -> Sequence[Shape]:
        return (Dots("goals", self._goals[0, :, :2]),)

    def _distances(self, poses: Array) -> Array:
        return np.asarray(np.hypot(*np.moveaxis(self._goals - poses, 2, 0)[:2]))

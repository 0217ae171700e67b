"""policy: a trained network drives the group, by what its task observes; the barrier and the gates are on.

The same task that it was trained for observes here, and says what each tick earned: so a run's return stands beside
that of the training.
"""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field, JsonValue, ValidationError, ValidationInfo

from robofleet.behaviours.interface import (
    SHARE_OF_TICK,
    Behaviour,
    Bound,
    Decision,
    Figure,
    Past,
    Refusal,
    Shape,
    Situation,
    Team,
    statistics,
)
from robofleet.core.arrays import Array
from robofleet.core.errors import BadInputError
from robofleet.core.plugins import PluginError, reach
from robofleet.core.settings import Model, Named
from robofleet.policies.description import Description, pinned, read_policy, split
from robofleet.policies.interface import Task, TaskView, Term, load_task, observed, velocities
from robofleet.policies.network import Policy, inference_s, load_policy

DONE_S = 0.5  # so long a task must be done for the run to end
_FIRST = np.zeros(1, dtype=np.int64)  # the only arena of a run


def _pinned(name: str, info: ValidationInfo) -> str:
    """Return a policy's file with the digest of its content, where the configuration's folder is known."""
    folder = (info.context or {}).get("folder")
    return name if folder is None else pinned(name, folder)


class PolicyBehaviour(Behaviour):
    """Robots that do what a network was trained for."""

    class Settings(Model):
        """Which policy, and the settings of its task."""

        file: Annotated[Named, AfterValidator(_pinned)]
        """The network: a path from the configuration's folder that ends in .onnx; its JSON stands beside it. Where
        robofleet keeps a configuration, it adds `#sha256=...`: both files must still have that content."""
        task: dict[str, JsonValue] = Field({})
        """Settings of the task that are to be others than in training: the goals, for example."""

    settings: Settings
    figures: ClassVar[Sequence[Figure]] = (
        Figure("reward", meaning="what the tick before earned by the task"),
        Figure("return", meaning="sum of the rewards since the start", live=False),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self.restart()

    def restart(self) -> None:
        n = len(self.team)
        self._t = -np.inf  # of the tick before
        self._poses, self._u = np.zeros((n, 3)), np.zeros((n, 2))
        self._return, self._done_s = np.zeros(n), 0.0

    def changed(self, velocities: Array) -> None:
        self._u = velocities.copy()

    @property
    def arrived(self) -> bool:
        """Whether the task has been done for a while."""
        return self._done_s > DONE_S

    def decide(self, now: Situation) -> Decision:
        """Return the body velocities that the network's actions ask for."""
        view, task = self._view(now), self.task
        if self._t < 0.0:
            task.begin(_FIRST, view.poses, deepcopy(self.team.rng))  # the goals that ``shapes`` shows
        reward, done = task.reward(view)[0], bool(task.done(view)[0])
        if earned := now.t > self._t >= 0.0:  # not in a hold, nor before anything was done
            self._return = self._return + reward  # a decision keeps the array
        if now.t > self._t:
            self._done_s = self._done_s + self.team.tick if done else 0.0
        self._t = now.t
        actions = self.policy.act(observed(task, view))[0]
        figures: dict[str, Array | float] = {"reward": reward if earned else np.nan, "return": self._return}
        return Decision(velocities(actions, self.team), "body", figures=figures)

    def _view(self, now: Situation) -> TaskView:
        """Return what the task observes by. What was commanded is of the poses by which it was decided."""
        c, s = np.cos(self._poses[:, 2]), np.sin(self._poses[:, 2])
        (x, y), ahead = self._u.T, self.team.point_ahead
        self._poses = now.poses.copy()
        bodies = np.stack([c * x + s * y, (c * y - s * x) / ahead], axis=1)
        return TaskView(
            t=np.array([now.t]), poses=now.poses[None], velocities=bodies[None], others=now.others[None],
            team=self.team,
        )  # fmt: skip

    @cached_property
    def policy(self) -> Policy:
        """The policy; PolicyError where it cannot be loaded."""
        return load_policy(self.settings.file)

    @cached_property
    def task(self) -> Task:
        """The task that it was trained for, with this group's settings."""
        return self._made(self.policy.description)

    def _made(self, described: Description) -> Task:
        reach(split(self.settings.file)[0].parent, described.task.name)
        kind, given = load_task(described.task.name), described.task.settings | self.settings.task
        return kind(kind.Settings.model_validate(given), self.team, 1)

    def refusals(self) -> Iterator[Refusal]:
        """Yield why the policy cannot be loaded, or was trained for something else."""
        path, _ = split(self.settings.file)
        try:
            described = read_policy(self.settings.file).description  # it may be gone since it was loaded
            task = self.task
        except (BadInputError, PluginError) as error:
            yield Refusal("settings.file", str(error))
            return
        except ValidationError as invalid:
            for fault in invalid.errors(include_url=False):
                where = ".".join(["settings.task", *map(str, fault["loc"])])
                yield Refusal(where, f"{fault['msg']}: it is a key of the task {described.task.name}")
            return
        yield from (Refusal(f"settings.task.{key}", message) for key, message in task.refusals())
        again = "or train it again"
        if tuple(task.terms) != described.terms:
            then, today = _shown(described.terms), _shown(task.terms)
            message = f"{path} observes {then}, and its task {described.task.name} is {today} now: mend settings.task"
            yield Refusal("settings.file", f"{message}, {again}")
        if described.robots not in (None, len(self.team)):
            message = f"{path} drives {described.robots} robots, and the group has {len(self.team)}"
            yield Refusal("settings.file", f"{message}: name {described.robots} in robots, {again}")
        if abs(described.tick_s - self.team.tick) > 1e-9:
            message = f"{path} decides every {described.tick_s:g} s, and controller.tick_s is {self.team.tick:g}"
            yield Refusal("settings.file", f"{message}: set it to {described.tick_s:g}, {again}")

    def bounds(self) -> Iterator[Bound]:
        """Yield whether the network is fast enough."""
        try:
            took_s = inference_s(self.policy, len(self.team))
        except (BadInputError, ValueError):
            return  # refused
        mend = "the robots would stand, so train a smaller network"
        yield Bound("settings.file", "a decision of the network", took_s, SHARE_OF_TICK * self.team.tick, "s", mend)

    def shapes(self) -> list[Shape]:
        try:
            task = self._made(read_policy(self.settings.file).description)
        except (BadInputError, PluginError, ValidationError):
            return []  # a viewer on another computer has no policy; a run is refused
        poses = [start or (0.0, 0.0, 0.0) for start in self.team.starts]
        task.begin(_FIRST, np.array([poses]), deepcopy(self.team.rng))
        return list(task.shapes())

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the rewards, and the return in the end."""
        found = super().summary(past)
        del found["return"]
        return found | {"final_return": statistics(past.figures["return"][-1:])}


def _shown(terms: Sequence[Term]) -> str:
    every = (f"{term.name} {term.size}{' ' if term.unit else ''}{term.unit} / {term.scale:g}" for term in terms)
    return f"{sum(term.size for term in terms)} numbers ({', '.join(every)})"

"""Episodes of a task in many arenas: what the environments of Gymnasium and PettingZoo are made of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from robofleet.behaviours.interface import Behaviour, Pose, Situation, Team
from robofleet.config import barrier as config_barrier
from robofleet.config import groups, slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config, Group
from robofleet.core import refusal
from robofleet.core.arrays import Array, Array32, Flags, Indices
from robofleet.core.errors import BadInputError
from robofleet.envs.arenas import Arenas
from robofleet.envs.robots import builds
from robofleet.policies.interface import Task, TaskView, load_task, observed, velocities

if TYPE_CHECKING:
    from robofleet.envs.jax.arenas import JaxArenas


@dataclass(frozen=True, kw_only=True)
class Step:
    """What a tick brought to arenas (A,) with robots (N,).

    Attributes:
        observations: What each robot observes now (A, N, F); of an episode that ended here, at its end.
        rewards: (A, N).
        terminated: Where the task is done, or failed for good (A,).
        truncated: Where the time is over (A,).
    """

    observations: Array32
    rewards: Array
    terminated: Flags
    truncated: Flags


class Episodes:
    """Episodes of one group's task in A arenas. Other groups of the configuration do what their behaviours decide.

    Attributes:
        task: The task.
        team: What is known of the group: N robots.
        own: The group's rows of the arenas' arrays.
        radii: Radii of all bodies (M,) [m].
        arenas: The arenas.
    """

    def __init__(
        self, config: Config | Path | str, task: str | type[Task], *, arenas: int, seed: int = 0,
        settings: Mapping[str, Any] | None = None, group: str | None = None, randomise: float = 1.0,
        barrier: bool = True, threads: int | None = None, backend: str = "numba",
    ) -> None:  # fmt: skip
        """Make the arenas; ``reset`` begins their first episodes.

        Args:
            config: A configuration, or its file.
            task: The task's name, ``module:Class``, or its class.
            arenas: A.
            seed: Of all random numbers. Same seed, same numbers.
            settings: The task's settings.
            group: Name of the group whose robots learn. None: the first one.
            randomise: How far robots differ from episode to episode, as ``envs.robots.builds`` has it.
            barrier: Whether the barrier changes commands.
            threads: How many step the arenas. None: one for each core.
            backend: What steps the arenas: ``numba``; ``jax``, on an accelerator if there is one; ``jax32``: numbers
                of 32 bits.

        Raises:
            ValidationError: Wrong settings.
            BadInputError: Settings that this group cannot have.
            PluginError: There is no such task.
            ValueError: No such group, no arena, or a robot that cannot be simulated.
        """
        if arenas < 1:
            raise ValueError(f"arenas={arenas}: must be at least 1")
        config = groups.named(config if isinstance(config, Config) else load_config(Path(config)))
        titles = [each.title for each in config.groups]
        if group is not None and group not in titles:
            raise ValueError(f"there is no group {group!r}: the configuration has {', '.join(titles)}")
        own = titles.index(group) if group is not None else 0
        self._config, self._rows = config, groups.rows(config.groups)
        beside = _starts_beside(config, config.groups[own])
        self.own, self.team = self._rows[own], _team(config, config.groups[own], beside)
        kind = task if isinstance(task, type) else load_task(task)
        self.task: Task = kind(kind.Settings.model_validate(dict(settings or {})), self.team, arenas)
        if wrong := [f"settings.{key}: {message}" for key, message in self.task.refusals()]:
            raise BadInputError("\n".join(wrong))
        self._episode_ticks = round(self.task.duration_s / self.team.tick)
        make = _arenas(backend, threads)
        self.arenas = make(config, arenas, seed, builds=builds(config, randomise), barrier=barrier)
        self._rng = slices.generator(seed, "episodes")
        self._beside = [
            (rows, [groups.behaviour(config, each) for _ in range(arenas)])
            for k, (each, rows) in enumerate(zip(config.groups, self._rows, strict=True)) if k != own
        ]  # fmt: skip
        members = len(config.members)
        self._starts = np.array([beside.get(robot.id, (0.0, 0.0, 0.0)) for robot in config.members])
        self._commands, self._of_body = np.zeros((arenas, members, 2)), np.ones(members, dtype=np.bool_)
        self.radii = np.array([robot.vehicle.body_radius_m for robot in config.bodies])
        self._others = np.array(
            [row for row in range(len(config.bodies)) if row not in range(*self.own.indices(members))], dtype=np.intp
        )

    def reset(self, arenas: Indices | None = None, *, seed: int | None = None, starts: Array | None = None) -> Array32:
        """Begin new episodes.

        Args:
            arenas: In which arenas (K,). None: in all.
            seed: Of all random numbers from now on. None: they go on.
            starts: Where the group's robots stand (K, N, 3). None: where the task draws them.

        Returns:
            What is observed in all arenas (A, N, F).
        """
        self.begin(arenas, seed=seed, starts=starts)
        return observed(self.task, self.view())

    def begin(self, arenas: Indices | None = None, *, seed: int | None = None, starts: Array | None = None) -> None:
        """Begin new episodes, as ``reset``, where nobody asks what is observed."""
        if seed is not None:
            self._rng = slices.generator(seed, "episodes")
            self.arenas.seed(seed)
        rows = np.arange(len(self.arenas)) if arenas is None else arenas
        every = np.repeat(self._starts[None], len(rows), axis=0)
        every[:, self.own] = self.task.starts(len(rows), self._rng) if starts is None else starts
        self.arenas.reset(rows, every)
        self.task.begin(rows, every[:, self.own], self._rng)
        for _, behaviours in self._beside:
            for row in rows.tolist():
                behaviours[row].restart()

    def step(self, actions: Array | Array32) -> Step:
        """Let a tick pass.

        Args:
            actions: (A, N, 2) in [-1, 1]: shares of top speed v and of top turn rate omega.

        Raises:
            ValueError: Actions of another shape, or not finite.
        """
        expected = len(self.arenas), len(self.team), 2
        if np.shape(actions) != expected:
            raise ValueError(f"actions {np.shape(actions)}: must be {expected}: arenas, robots, v and omega")
        if not np.isfinite(actions).all():
            arena, robot, _ = np.argwhere(~np.isfinite(actions))[0]
            raise ValueError(f"an action of {self.team.robots[robot]} in arena {arena} is not finite")
        self._commands[:, self.own] = velocities(actions, self.team)
        for rows, behaviours in self._beside:
            for arena, behaviour in enumerate(behaviours):
                decision = behaviour.decide(self._situation(arena, rows, behaviour))
                self._commands[arena, rows], self._of_body[rows] = decision.velocities, decision.of == "body"
        headings = self.arenas.poses[..., 2].copy() if self._beside else None
        self.arenas.step(self._commands, self._of_body)
        for rows, behaviours in self._beside:
            assert headings is not None
            obeyed = self.arenas.velocities[:, rows]
            for behaviour, changed in zip(
                behaviours, point_velocities(obeyed, headings[:, rows], self.team), strict=True
            ):
                behaviour.changed(changed)
        view = self.view()
        return Step(
            rewards=self.task.reward(view), observations=observed(self.task, view), terminated=self.task.done(view),
            truncated=self.arenas.ticks >= self._episode_ticks,
        )  # fmt: skip

    def close(self) -> None:
        """End the threads."""
        self.arenas.close()

    def view(self) -> TaskView:
        """Return what the task sees now."""
        a = self.arenas
        others = np.empty((len(a), len(self._others), 3))
        others[..., :2], others[..., 2] = a.poses[:, self._others, :2], self.radii[self._others]
        return TaskView(
            t=np.asarray(a.ticks * self.team.tick, np.float64), poses=a.poses[:, self.own],
            velocities=a.velocities[:, self.own], others=others, team=self.team,
        )  # fmt: skip

    def _situation(self, arena: int, rows: slice, behaviour: Behaviour) -> Situation:
        poses = self.arenas.poses[arena]
        everybody = np.column_stack([poses[:, :2], self.radii])
        n = rows.stop - rows.start
        return Situation(
            t=float(self.arenas.ticks[arena]) * self.team.tick + behaviour.team.delay, poses=poses[rows].copy(),
            driving=np.ones(n, dtype=np.bool_), disturbance=np.zeros((n, 2)), others=np.delete(everybody, rows, axis=0),
        )  # fmt: skip


def point_velocities(velocities: Array, headings: Array, team: Team) -> Array:
    """Return velocities v [m/s] and omega [rad/s] (..., 2) as those of the points ahead [m/s; world]."""
    v, across = velocities[..., 0], team.point_ahead * velocities[..., 1]
    c, s = np.cos(headings), np.sin(headings)
    return np.stack([c * v - s * across, s * v + c * across], axis=-1)


def _arenas(backend: str, threads: int | None) -> "Callable[..., Arenas | JaxArenas]":
    """Return what makes arenas."""
    if backend == "numba":
        return partial(Arenas, threads=threads)
    if backend not in ("jax", "jax32"):
        raise ValueError(f"backend={backend!r}: must be 'numba', 'jax' or 'jax32'")
    refusal.need_extra("jax", "jax")
    from robofleet.envs.jax.arenas import JaxArenas  # noqa: PLC0415 - an extra

    return partial(JaxArenas, double=backend == "jax")


def _starts_beside(config: Config, own: Group) -> dict[str, Pose]:
    """Return where the robots of the other groups begin, by id."""
    beside = [robot.id for robot in config.members if robot.id not in own.robots]
    starts = groups.starts_of(config) if beside else {}
    if missing := [robot for robot in beside if robot not in starts]:
        raise ValueError(f"nothing says where {', '.join(missing)} begin: give them a `start`")
    return {robot: starts[robot] for robot in beside}


def _team(config: Config, group: Group, beside: Mapping[str, Pose]) -> Team:
    """Return what is known of a group. Robots of other groups stand at their starts first, as bystanders do."""
    team = groups.team(config, group)
    others = tuple((name, config_barrier.body(config, config.robot(name)), start) for name, start in beside.items())
    return replace(team, bystanders=(*team.bystanders, *others))

"""A policy in the environment that stands for a run: the same configuration, robots' starts, goals and end."""

import math
from typing import Any

import numpy as np

from robofleet.behaviours.interface import statistics
from robofleet.config import groups
from robofleet.config.tree import Config, Group
from robofleet.core.errors import BadInputError
from robofleet.envs.episodes import Episodes
from robofleet.policies.policy import DONE_S, PolicyBehaviour


def learned(config: Config) -> list[Group]:
    """Return the groups that a policy drives."""
    return [group for group in config.groups if issubclass(groups.kind(group), PolicyBehaviour)]


def evaluated(config: Config) -> dict[str, Any]:
    """Return what a run's ``summary.json`` would have of the groups that a policy drives, in an arena of their own.

    Raises:
        BadInputError: No group has the behaviour ``policy``.
    """
    config = groups.named(config)
    if not (policies := learned(config)):
        raise BadInputError("no group has the behaviour policy: an environment runs nothing else")
    found = {group.title: _group(config, group) for group in policies}
    return {
        "outcome": "completed", "cause": None, "mode": "environment", "robots": [r.id for r in config.members],
        "ticks": max(group.pop("ticks") for group in found.values()),
        "min_gap_mm": min(group.pop("min_gap_mm") for group in found.values()),
        "groups": found, "stops": [], "bounds": [], "trace_hash": None,
    }  # fmt: skip


def _group(config: Config, group: Group) -> dict[str, Any]:
    behaviour = groups.behaviour(config, group)
    assert isinstance(behaviour, PolicyBehaviour)
    policy, task = behaviour.policy, behaviour.task
    episodes = Episodes(
        config, type(task), arenas=1, seed=config.run.seed, settings=task.settings.model_dump(exclude_unset=True),
        group=group.title,
    )  # fmt: skip
    starts = groups.starts_of(config)
    observations = episodes.reset(starts=np.array([[starts[robot] for robot in group.robots]]))
    tick, total, done_s, closest = episodes.team.tick, np.zeros(len(group.robots)), 0.0, math.inf
    rewards = []
    for _ in range(math.ceil(config.run.duration_s / tick)):
        step = episodes.step(policy.act(observations))
        observations = step.observations
        rewards.append(step.rewards[0])
        total += step.rewards[0]
        closest = min(closest, _apart(episodes))
        done_s = done_s + tick if step.terminated[0] else 0.0
        if done_s > DONE_S:
            break
    episodes.close()
    return {
        "behaviour": group.behaviour, "robots": list(group.robots), "ticks": len(rewards),
        "min_gap_mm": round(1e3 * closest, 3), "reward": statistics(np.array(rewards)),
        "final_return": statistics(total[None]),
    }  # fmt: skip


def _apart(episodes: Episodes) -> float:
    """Return the smallest distance of a body of the group from another body [m], as a run's `min_gap_mm` has it."""
    points, radii = episodes.arenas.truths[0, :, :2], episodes.radii
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) - radii[:, None] - radii[None]
    np.fill_diagonal(apart, math.inf)
    return float(apart[episodes.own].min())

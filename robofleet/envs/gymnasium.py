"""Episodes as Gymnasium has environments: one arena, or many of them at once. Extra `envs`."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from robofleet.core.arrays import Array32
from robofleet.envs.episodes import Episodes
from robofleet.policies.interface import LARGEST, width

ACTIONS = 2  # of a robot: shares of its top speed and of its top turn rate


class FleetEnv(gymnasium.Env[Array32, Array32]):
    """One arena; one agent decides for all robots.

    Observation: of all robots side by side (N F,). Action: of all robots side by side (2 N,) in [-1, 1]. Reward: the
    mean over the robots.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - as Gymnasium has it

    def __init__(self, episodes: Episodes) -> None:
        """Take episodes of one arena."""
        if len(episodes.arenas) != 1:
            raise ValueError(f"one arena is needed, not {len(episodes.arenas)}: use VectorFleetEnv for many")
        self.episodes, n = episodes, len(episodes.team)
        self.observation_space = Box(-LARGEST, LARGEST, (n * width(episodes.task),), np.float32)
        self.action_space = Box(-1.0, 1.0, (n * ACTIONS,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        return self.episodes.reset(seed=seed).reshape(-1), {}

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, dict[str, Any]]:
        """Let a tick pass."""
        step = self.episodes.step(np.reshape(action, (1, -1, ACTIONS)))
        done, over = bool(step.terminated[0]), bool(step.truncated[0])
        return step.observations.reshape(-1), float(step.rewards.mean()), done, over, {}

    def close(self) -> None:
        """End the threads."""
        self.episodes.close()


class VectorFleetEnv(VectorEnv[Array32, Array32, Any]):
    """Many arenas. An agent is a robot, so that all robots learn one policy, or an arena.

    An episode that ends is followed by a new one in the same step (``AutoresetMode.SAME_STEP``): ``infos["final_obs"]``
    has what was observed at its end.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - as Gymnasium has it

    def __init__(self, episodes: Episodes, *, each: str = "robot") -> None:
        """Take episodes.

        Args:
            episodes: Of A arenas with N robots.
            each: What an agent is: ``robot`` (A N agents, arena by arena), or ``arena`` (A agents; the reward is the
                mean over its robots).

        Raises:
            ValueError: ``each`` is neither.
        """
        if each not in ("robot", "arena"):
            raise ValueError(f"each={each!r}: must be 'robot' or 'arena'")
        self.episodes, n = episodes, len(episodes.team)
        self._agents, self._robots = (n, 1) if each == "robot" else (1, n)  # of an arena, of an agent
        self.num_envs = len(episodes.arenas) * self._agents
        self.single_observation_space = Box(-LARGEST, LARGEST, (self._robots * width(episodes.task),), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (self._robots * ACTIONS,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Begin an episode in every arena. Of a list of seeds the first one counts."""
        first = seed[0] if isinstance(seed, list) else seed
        return self._flat(self.episodes.reset(seed=first)), {}

    def step(self, actions: Array32) -> tuple[Array32, Any, Any, Any, dict[str, Any]]:
        """Let a tick pass in every arena."""
        arenas, n = len(self.episodes.arenas), len(self.episodes.team)
        step = self.episodes.step(np.reshape(actions, (arenas, n, ACTIONS)))
        rewards = step.rewards.reshape(self.num_envs, self._robots).mean(axis=1)
        ended, infos = step.terminated | step.truncated, {}
        observations = step.observations
        if ended.any():
            final, ends = self._flat(observations), np.repeat(ended, self._agents)
            observations = self.episodes.reset(np.flatnonzero(ended))
            infos = {"final_obs": final, "_final_obs": ends, "final_info": {}, "_final_info": ends}
        terminated, truncated = (np.repeat(flags, self._agents) for flags in (step.terminated, step.truncated))
        return self._flat(observations), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self.episodes.close()

    def _flat(self, observations: Array32) -> Array32:
        return observations.reshape(self.num_envs, -1)

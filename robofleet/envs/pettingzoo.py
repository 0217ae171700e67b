"""Episodes of one arena as PettingZoo has environments of many agents: one for each robot. Extra `envs`."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv

from robofleet.core.arrays import Array32
from robofleet.envs.episodes import Episodes
from robofleet.envs.gymnasium import ACTIONS
from robofleet.policies.interface import LARGEST, width


class ParallelFleetEnv(ParallelEnv[str, Array32, Array32]):  # type: ignore[misc]
    """One arena; each robot is an agent, named by its id."""

    metadata = {"name": "robofleet", "render_modes": []}  # noqa: RUF012 - as PettingZoo has it

    def __init__(self, episodes: Episodes) -> None:
        """Take episodes of one arena."""
        if len(episodes.arenas) != 1:
            raise ValueError(f"one arena is needed, not {len(episodes.arenas)}: use VectorFleetEnv for many")
        self.episodes = episodes
        self.possible_agents = list(episodes.team.robots)
        self.agents: list[str] = []
        observation = Box(-LARGEST, LARGEST, (width(episodes.task),), np.float32)
        self.observation_spaces = dict.fromkeys(self.possible_agents, observation)
        self.action_spaces = dict.fromkeys(self.possible_agents, Box(-1.0, 1.0, (ACTIONS,), np.float32))

    def observation_space(self, agent: str) -> Box:
        """Return what an agent observes (F,)."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return what an agent decides: shares of its top speed and of its top turn rate."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array32], dict[str, Any]]:
        """Begin an episode."""
        self.agents = list(self.possible_agents)
        return self._by_agent(self.episodes.reset(seed=seed)[0]), {agent: {} for agent in self.agents}

    def step(
        self, actions: dict[str, Array32]
    ) -> tuple[dict[str, Array32], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Let a tick pass."""
        step = self.episodes.step(np.stack([actions[agent] for agent in self.possible_agents])[None])
        agents, done, over = self.agents, bool(step.terminated[0]), bool(step.truncated[0])
        observations = self._by_agent(step.observations[0])
        rewards = dict(zip(agents, step.rewards[0].tolist(), strict=True))
        if done or over:
            self.agents = []
        return observations, rewards, dict.fromkeys(agents, done), dict.fromkeys(agents, over), {a: {} for a in agents}

    def close(self) -> None:
        """End the threads."""
        self.episodes.close()

    def _by_agent(self, rows: Array32) -> dict[str, Array32]:
        return dict(zip(self.possible_agents, rows, strict=True))

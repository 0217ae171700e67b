"""Many arenas as stable-baselines3 has environments, for its algorithms."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from robofleet.core.arrays import Array32
from robofleet.envs.episodes import Episodes
from robofleet.envs.gymnasium import VectorFleetEnv
from robofleet.policies.description import described
from robofleet.policies.torch_export import export_torch


class SB3FleetEnv(VecEnv):  # type: ignore[misc]
    """Many arenas; agents as ``VectorFleetEnv`` has them.

    Attributes:
        episodes: The episodes.
        each: What an agent is.
    """

    def __init__(self, episodes: Episodes, *, each: str = "robot") -> None:
        """Take episodes, and what an agent is, as ``VectorFleetEnv`` does."""
        self.episodes, self.each, self._env = episodes, each, VectorFleetEnv(episodes, each=each)
        super().__init__(self._env.num_envs, self._env.single_observation_space, self._env.single_action_space)

    def reset(self) -> Array32:
        """Begin an episode in every arena."""
        seed = self._seeds[0]
        self._reset_seeds()
        return self._env.reset(seed=seed)[0]

    def step_async(self, actions: Array32) -> None:
        """Take the actions of the next tick."""
        self._actions = actions

    def step_wait(self) -> tuple[Array32, Any, Any, list[dict[str, Any]]]:
        """Let a tick pass."""
        observations, rewards, terminated, truncated, found = self._env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(terminated | truncated).tolist():
            over = bool(truncated[k] and not terminated[k])
            infos[k] = {"terminal_observation": found["final_obs"][k], "TimeLimit.truncated": over}
        return observations, rewards, terminated | truncated, infos

    def close(self) -> None:
        """End the threads."""
        self.episodes.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the arenas: it is the same for all."""
        return [getattr(self._env, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: arenas have nothing of their own to set."""
        raise NotImplementedError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse: arenas are no environments of their own."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Sequence[bool]:
        """Return that no arena is."""
        return [False] * self.num_envs


def export(model: OnPolicyAlgorithm, world: SB3FleetEnv, file: Path) -> None:
    """Write a policy's two files.

    Args:
        model: PPO or A2C with ``MlpPolicy``, trained in ``world`` without further normalisation.
        world: The arenas.
        file: Of the network; it ends in .onnx.

    Raises:
        PolicyError: The files cannot be written.
    """
    network = torch.nn.Sequential(model.policy.mlp_extractor.policy_net, model.policy.action_net)
    export_torch(network, file, described(world.episodes.task, form="group" if world.each == "arena" else "robot"))

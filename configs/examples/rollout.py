"""Rollouts: a fleet as an environment for reinforcement learning, with Gymnasium's calls and without the package.

An episode is a run in lockstep, and a step is a tick. Equal seeds give equal episodes, to the bit. Two policies try to
bring all robots to goals: one acts at random, and one knows how.

Start it with: python configs/examples/rollout.py
"""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet import Fleet

Array = NDArray[np.float64]
CONFIG = Path(__file__).parents[1] / "script.yaml"
SCALE = np.array([0.15, 2.0])  # what the action 1 is: v [m/s], omega [rad/s]
NEAR, LIMIT_S = 0.02, 20.0  # all goals are reached within [m]; an episode takes no longer


class Reach:
    """Goals are to be reached.

    Observation (N, 2): each robot's goal, forwards and to the left of its point ahead [m]. Action (N, 2): v and omega,
    each from -1 to 1. Reward: less the mean distance from the goals, by time [m s].
    """

    def __init__(self) -> None:
        """An episode begins with ``reset``."""
        self.run = ExitStack()

    def reset(self, seed: int) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; return the first observation."""
        self.run.close()
        fleet = Fleet(CONFIG, lockstep=True, seed=seed, out=False, settings=["tracker.source=truth"])
        self.fleet = self.run.enter_context(fleet)
        self.goals = np.random.default_rng(seed).uniform(0.15, 0.6, (4, 2)) * [[-2, 1], [-2, -1], [2, 1], [2, -1]]
        self.ticks = self.fleet.ticks(LIMIT_S)
        next(self.ticks)
        return self._observation(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive for a tick; return observation, reward, whether all are there, whether time is over, and no more."""
        self.fleet.drive(SCALE * np.clip(action, -1, 1))
        over = next(self.ticks, None) is None
        seen = self._observation()
        away = np.linalg.norm(seen, axis=1)
        return seen, -self.fleet.tick_s * float(away.mean()), bool((away < NEAR).all()), over, {}

    def close(self) -> None:
        """End the run."""
        self.run.close()

    def _observation(self) -> Array:
        to_goal = (self.goals - self.fleet.points) @ [1, 1j] * np.exp(-1j * self.fleet.poses[:, 2])
        return np.column_stack([to_goal.real, to_goal.imag])


def rollout(env: Reach, policy: Callable[[Array], Array], seed: int) -> tuple[float, int]:
    """Return an episode's sum of rewards, and its number of steps."""
    seen, _ = env.reset(seed)
    total, steps, done = 0.0, 0, False
    while not done:
        seen, reward, terminated, over, _ = env.step(policy(seen))
        total, steps, done = total + reward, steps + 1, terminated or over
    return total, steps


def straight(seen: Array) -> Array:
    """Drive the point ahead straight to its goal: forwards is driving, and sideways is turning about the axle."""
    action: Array = seen * [1.0, 1.0 / 0.08] / SCALE
    return action


if __name__ == "__main__":
    env, rng = Reach(), np.random.default_rng(0)
    for name, policy in {"straight": straight, "random": lambda seen: rng.uniform(-1, 1, seen.shape)}.items():
        for seed in range(3):
            total, steps = rollout(env, policy, seed)
            print(f"{name}, seed {seed}: return {total:.2f} m s in {steps} steps")
    env.close()

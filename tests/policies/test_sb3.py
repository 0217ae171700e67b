"""stable-baselines3 trains in the arenas, and what it trained acts as its own policy does."""

from pathlib import Path

import numpy as np
import pytest

from robofleet.policies import load_policy
from tests.shipped import PLATOON

pytest.importorskip("stable_baselines3", reason="NO STABLE-BASELINES3: its interface is tested where it is installed")


@pytest.mark.parametrize("each", ["robot", "arena"])
@pytest.mark.filterwarnings("ignore")  # of torch
def test_a_model_is_trained_and_its_files_act_alike(each: str, tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    from robofleet.envs import Episodes
    from robofleet.envs.sb3 import SB3FleetEnv, export

    world = SB3FleetEnv(Episodes(PLATOON, "go_to", arenas=4), each=each)
    model = PPO("MlpPolicy", world, n_steps=8, batch_size=16, n_epochs=1, seed=0, device="cpu").learn(64)
    export(model, world, tmp_path / "p.onnx")
    observations = world.reset()
    actions, _ = model.predict(observations, deterministic=True)
    policy = load_policy(tmp_path / "p.onnx")
    acted = policy.act(observations.reshape(4, 4, -1))
    assert np.clip(acted, -1.0, 1.0).reshape(actions.shape) == pytest.approx(actions, abs=1e-5)


def test_an_episode_that_ends_says_what_was_observed_at_its_end() -> None:
    from robofleet.envs import Episodes
    from robofleet.envs.sb3 import SB3FleetEnv

    episodes = Episodes(PLATOON, "go_to", arenas=2)
    world = SB3FleetEnv(episodes)
    world.seed(3)
    first = world.reset()
    world.seed(3)
    assert (world.reset() == first).all()
    episodes.arenas.ticks[1] = 10_000
    observations, _, done, infos = world.step(np.zeros((8, 2), np.float32))
    assert done.tolist() == [False] * 4 + [True] * 4
    assert [bool(info) for info in infos] == done.tolist()
    assert infos[4]["TimeLimit.truncated"]
    assert infos[4]["terminal_observation"] == pytest.approx(first[4], abs=0.1)
    assert observations[4] != pytest.approx(first[4], abs=0.1)

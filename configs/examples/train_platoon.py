"""Train a platoon: the leader follows the path on time, every other robot the one ahead of it.

The robots of 128 arenas learn one network, by proximal policy optimisation (PPO) of stable-baselines3. It takes three
to four minutes of CPU time, and writes platoon.onnx and platoon.json to the current folder. It needs
`pip install 'robofleet[envs]' stable-baselines3 onnx`.

Start it with: python configs/examples/train_platoon.py
"""

from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from robofleet.config.load import load_config
from robofleet.envs import Episodes
from robofleet.envs.sb3 import SB3FleetEnv, export

CONFIG = Path(__file__).parents[1] / "platoon.yaml"
FILE = Path("platoon.onnx")
STEPS = 5_000_000  # of robots

if __name__ == "__main__":
    torch.set_num_threads(1)  # with small networks more threads wait for each other
    config = load_config(CONFIG)
    settings = {key: config.groups[0].settings[key] for key in ("path", "spacing_m", "path_rate")}
    episodes = Episodes(config, "platoon", arenas=128, settings=settings)
    world = SB3FleetEnv(episodes)
    model = PPO(
        "MlpPolicy", VecMonitor(world), n_steps=64, batch_size=8192, n_epochs=4, seed=0, verbose=1,
        learning_rate=lambda left: 1e-3 * max(left, 0.4), policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.5},
        gamma=0.95, device="cpu",
    )  # fmt: skip
    # A mean beyond the limits would be cut off, and noise would change nothing.
    model.policy.action_net = torch.nn.Sequential(model.policy.action_net, torch.nn.Tanh())
    model.learn(STEPS)
    export(model, world, FILE)
    print(f"{FILE.absolute()}: drive it with the behaviour policy")

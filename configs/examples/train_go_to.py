"""Train four robots to drive to goals, without touching and without waiting for each other for ever.

The robots of 128 arenas learn one network, by proximal policy optimisation (PPO) of stable-baselines3. It takes three
to four minutes of CPU time, and writes go_to.onnx and go_to.json to the current folder. It needs
`pip install 'robofleet[envs]' stable-baselines3 onnx`.

Start it with: python configs/examples/train_go_to.py
"""

from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from robofleet.envs import Episodes
from robofleet.envs.sb3 import SB3FleetEnv, export

CONFIG = Path(__file__).parents[1] / "policy.yaml"
FILE = Path("go_to.onnx")
STEPS = 5_000_000  # of robots

if __name__ == "__main__":
    torch.set_num_threads(1)  # with small networks more threads wait for each other
    episodes = Episodes(CONFIG, "go_to", arenas=128, settings={"accuracy_m": 0.03})  # a run asks for 0.05
    world = SB3FleetEnv(episodes)
    model = PPO(
        "MlpPolicy", VecMonitor(world), n_steps=64, batch_size=8192, n_epochs=4, seed=0, verbose=1,
        learning_rate=lambda left: 1e-3 * max(left, 0.4), policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.5},
        device="cpu",
    )  # fmt: skip
    # A mean beyond the limits would be cut off, and noise would change nothing.
    model.policy.action_net = torch.nn.Sequential(model.policy.action_net, torch.nn.Tanh())
    model.learn(STEPS)
    export(model, world, FILE)
    print(f"{FILE.absolute()}: drive it with robofleet run {CONFIG} --set groups.0.settings.file={FILE.absolute()}")

"""The networks that are shipped drive: a few seeds of ``tools.measure.behaviours.policy_trials``, and the platoon."""

import numpy as np
import pytest

from robofleet.envs import Episodes
from robofleet.policies import load_policy
from tests.shipped import SHIPPED
from tools.measure.behaviours import policy_trials


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_four_robots_arrive_and_nobody_touches(seed: int) -> None:
    trial = policy_trials.drive("truth", str(SHIPPED / "policies" / "go_to.onnx"), seed)
    assert trial.arrived
    assert trial.gap_mm > 10.0


@pytest.mark.slow
def test_a_platoon_keeps_to_its_path_and_its_spacing() -> None:
    policy = load_policy(SHIPPED / "policies" / "platoon.onnx")
    settings = policy.description.task.settings
    episodes = Episodes(SHIPPED / "platoon.yaml", "platoon", arenas=8, settings=settings, threads=1)
    observations, poses = episodes.reset(seed=1), []
    for _ in range(600):
        observations = episodes.step(policy.act(observations)).observations
        poses.append(episodes.arenas.poses[..., :2].copy())
    spacings = np.linalg.norm(np.diff(np.array(poses)[200:], axis=2), axis=-1)
    assert spacings == pytest.approx(settings["spacing_m"], abs=0.025)
    assert spacings.mean() == pytest.approx(settings["spacing_m"], abs=0.005)

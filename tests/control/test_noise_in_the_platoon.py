"""Pose noise from robot to robot: the paper's Euler step amplifies it, the exact step does not."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.control.driven import WHEELS, Column, Platoon

PlatoonOf = Callable[..., Platoon]
LineUp = Callable[..., np.ndarray]
TICK, LAG, DELAY_TICKS, NOISE = 0.033, 0.08, 2, 0.0005
ALL = np.ones(4, dtype=np.bool_)


def mean_control_errors(platoon: Platoon, poses: np.ndarray, seed: int) -> np.ndarray:
    """Return each robot's mean error [m] over 25 s, with noisy poses, delayed commands and lagging motors."""
    rng, poses = np.random.default_rng(seed), poses.copy()
    under_way = deque([np.zeros((4, 2))] * DELAY_TICKS)
    speeds, errors = np.zeros((4, 2)), []
    step = TICK / 3
    decay = math.exp(-step / LAG)
    for k in range(round(30.0 / TICK)):
        measured = poses + np.column_stack([rng.normal(0.0, NOISE, (4, 2)), np.zeros(4)])
        decisions = platoon.tick(k * TICK, measured, ALL)
        errors.append(decisions[:, Column.CONTROL_ERROR])
        under_way.append(decisions[:, WHEELS])
        command = under_way.popleft()
        for _ in range(3):
            mean = command + (speeds - command) * (1 - decay) * LAG / step
            speeds = command + (speeds - command) * decay
            for i, wheels in enumerate(mean):
                poses[i] = arc(*poses[i], *body_from_wheels(*wheels, 0.016, 0.105), step)
    return np.mean(errors[round(5.0 / TICK) :], axis=0)


@pytest.fixture(scope="module")
def errors(platoon_of: PlatoonOf, line_up: LineUp) -> Callable[[str], np.ndarray]:
    start = line_up(np.array([4.0, 3.82, 3.68, 3.5]))

    def of(integrator: str) -> np.ndarray:
        runs = [mean_control_errors(platoon_of(integrator=integrator), start, seed) for seed in range(3)]
        return np.mean(runs, axis=0)

    return of


def test_euler_amplifies_and_exact_does_not(errors: Callable[[str], np.ndarray]) -> None:
    exact, euler = errors("exact"), errors("euler")
    assert exact[3] / exact[0] < 1.2
    assert euler[3] / euler[0] >= 3.0
    assert (euler[3] / euler[0]) / (exact[3] / exact[0]) >= 3.0
    assert (np.diff(euler) > 0.2e-3).all()  # each robot passes on more than it got
    assert exact.max() < 0.0015

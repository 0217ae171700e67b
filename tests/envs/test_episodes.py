"""Episodes, and the environments of Gymnasium and PettingZoo that are made of them."""

from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test, parallel_seed_test

from robofleet.core.arrays import Array, Flags
from robofleet.core.errors import RobofleetError
from robofleet.envs import Episodes, env, parallel_env, vector_env
from robofleet.policies import Task, TaskView, Term
from tests.shipped import PLATOON, SHIPPED


class Forward(Task):
    """Earns what it drives along x; done beyond 5 cm, over after a second."""

    duration_s = 1.0

    @property
    def terms(self) -> Sequence[Term]:
        return (Term("x", 1, "m", 2.0), Term("speed", 1, "m/s", 0.2))

    def observe(self, view: TaskView) -> Sequence[Array]:
        return view.poses[..., :1], view.velocities[..., :1]

    def reward(self, view: TaskView) -> Array:
        return view.velocities[..., 0] * np.cos(view.poses[..., 2])

    def done(self, view: TaskView) -> Flags:
        return view.poses[:, 0, 0] - self.began > 0.05

    def starts(self, count: int, rng: np.random.Generator) -> Array:
        starts = np.zeros((count, len(self.team), 3))
        starts[..., 0], starts[..., 1] = -1.0, np.linspace(-0.6, 0.6, len(self.team))
        return starts

    def begin(self, arenas: Any, poses: Array, rng: np.random.Generator) -> None:
        if not hasattr(self, "began"):
            self.began = np.zeros(self.arenas)
        self.began[arenas] = poses[:, 0, 0]


def test_gymnasium_and_pettingzoo_find_nothing_wrong() -> None:
    check_env(env(PLATOON, "go_to"), skip_render_check=True)
    parallel_api_test(parallel_env(PLATOON, "go_to"), num_cycles=300)
    parallel_seed_test(lambda: parallel_env(PLATOON, "go_to"), num_cycles=50)


def test_an_episode_that_ends_is_followed_by_a_new_one() -> None:
    with closing(vector_env(PLATOON, Forward, arenas=3, each="arena")) as world:
        observations, _ = world.reset(seed=1)
        assert observations.shape == (3, 8)
        action = np.zeros((3, 8), np.float32)
        action[0, ::2] = 1.0  # one drives, two stand until the time is over
        done_at = over_at = None
        for tick in range(1, 40):
            observations, _, terminated, truncated, infos = world.step(action)
            if terminated[0] and done_at is None:
                done_at = tick
                assert infos["final_obs"][0, 0] == pytest.approx((-1.0 + 0.05) / 2.0, abs=0.01)
                assert observations[0, 0] == pytest.approx(-0.5, abs=0.002)
                assert not infos["_final_obs"][1:].any()
            if truncated[1] and over_at is None:
                over_at = tick
        assert over_at == round(1.0 / 0.033)
        assert done_at is not None and done_at < 20


def test_agents_are_robots_or_arenas() -> None:
    with (
        closing(vector_env(PLATOON, Forward, arenas=2)) as robots,
        closing(vector_env(PLATOON, Forward, arenas=2, each="arena")) as whole,
    ):
        assert (robots.num_envs, whole.num_envs) == (8, 2)
        each_robot, other = robots.reset(seed=4)[0], whole.reset(seed=4)[0]
        assert np.array_equal(each_robot.reshape(2, -1), other)
        actions = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 8)).astype(np.float32)
        rewards, mean = robots.step(actions.reshape(8, 2))[1], whole.step(actions)[1]
        assert rewards.reshape(2, 4).mean(axis=1) == pytest.approx(mean)


def test_the_same_seed_gives_the_same_episode() -> None:
    def end(seed: int) -> Array:
        world = Episodes(PLATOON, "go_to", arenas=2, seed=9)
        observations = world.reset(seed=seed)
        for action in np.random.default_rng(0).uniform(-1.0, 1.0, (30, 2, 4, 2)):
            observations = world.step(action).observations
        return np.asarray(observations)

    assert np.array_equal(end(1), end(1))
    assert not np.array_equal(end(1), end(2))


def test_other_groups_do_what_their_behaviours_decide() -> None:
    """One group learns, the other one goes on with its own law."""
    world = Episodes(SHIPPED / "two-groups.yaml", Forward, arenas=2, group="ring")
    world.reset()
    rows = np.delete(np.arange(world.arenas.poses.shape[1]), world.own)
    before = world.arenas.truths[:, rows, :2].copy()
    for _ in range(60):
        world.step(np.zeros((2, len(world.team), 2)))
    moved = np.hypot(*np.moveaxis(world.arenas.truths[:, rows, :2] - before, 2, 0))
    assert moved.max() > 0.05
    assert not world.arenas.velocities[:, world.own].any()


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"task": "go_too"}, "did you mean 'go_to'"),
        ({"task": "go_to", "arenas": 0}, "arenas=0: must be at least 1"),
        ({"task": "go_to", "group": "nobody"}, "there is no group 'nobody': the configuration has platoon"),
        ({"task": "go_to", "settings": {"accuracy_m": -1}}, "accuracy_m"),
        ({"task": "go_to", "settings": {"goals": {"r1": {"x_m": 0, "y_m": 0}}}}, "r2"),
        ({"task": "go_to", "backend": "cuda"}, "backend='cuda': must be 'numba', 'jax' or 'jax32'"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], line: str) -> None:
    with pytest.raises((RobofleetError, ValueError), match=line):
        Episodes(PLATOON, **{"arenas": 1, **options}).reset()


def test_actions_that_cannot_be_are_refused() -> None:
    world = Episodes(PLATOON, Forward, arenas=2)
    world.reset()
    with pytest.raises(ValueError, match=r"actions \(2, 2\): must be \(2, 4, 2\)"):
        world.step(np.zeros((2, 2)))
    actions = np.zeros((2, 4, 2))
    actions[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="an action of r3 in arena 1 is not finite"):
        world.step(actions)


def test_a_task_that_observes_something_else_than_it_says_is_refused() -> None:
    class Wrong(Forward):
        def observe(self, view: TaskView) -> Sequence[Array]:
            return (view.poses, view.velocities[..., :1])

    with pytest.raises(ValueError, match=r"`terms` says \[\(1, 4, 1\), \(1, 4, 1\)\]"):
        Episodes(PLATOON, Wrong, arenas=1).reset()

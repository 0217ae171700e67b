"""Arenas in JAX do what numba's do. Only JAX's CPU backend is tried: nobody has an accelerator here."""

import importlib.util
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.envs import Episodes
from robofleet.envs.arenas import Arenas
from robofleet.envs.robots import Builds, builds
from robofleet.vehicles.plant import Build
from tests.envs.test_arenas import OF_BODY, STARTS, commands, with_plants
from tests.shipped import PLATOON, SHIPPED

if TYPE_CHECKING:  # JAX takes a second to import, and every worker of the fast tests reads this file
    from robofleet.envs.jax.arenas import JaxArenas

pytestmark = [
    pytest.mark.slow,  # XLA compiles a step for five to ten seconds
    pytest.mark.skipif(importlib.util.find_spec("jax") is None, reason="NO JAX: pip install -e '.[jax]'"),
]

CART = "arena.moving=[{name: cart, tag: 40, radius_m: 0.12, start: {x_m: 0.9, y_m: 0.3, heading_deg: 0}}]"
CLOSE = 1e-5  # [m, rad]


def without_noise(config: Config, **errors: Any) -> Config:
    truth = config.tracker.truth.model_copy(update={"position_noise_m": 0.0, "heading_noise_rad": 0.0})
    config = config.model_copy(update={"tracker": config.tracker.model_copy(update={"truth": truth})})
    return with_plants(config, slip_noise=0.0, **errors)


def unlike(config: Config, odd_share: float) -> Builds:
    """Return what draws robots each of which is another one; each world gets the same. Some are wired oddly."""
    alike, rng = builds(config, 0.0), np.random.default_rng(5)

    def drawn(_: np.random.Generator) -> Sequence[Build]:
        odd = rng.random(4) < odd_share
        return [
            replace(
                build, left_gain=rng.uniform(0.98, 1.02), max_wheel_speed=build.max_wheel_speed * rng.uniform(0.9, 1.0),
                swapped=bool(odd[0]), left_sign=-1.0 if odd[1] else 1.0, speed_quantum=0.0 if odd[2] else 0.2244,
                stop_lag=0.0 if odd[3] else build.stop_lag,
            )
            for build in alike(rng)
        ]  # fmt: skip

    return drawn


@contextmanager
def both(config: Config, starts: Array, *, barrier: bool, odd_share: float) -> "Iterator[tuple[Arenas, JaxArenas]]":
    from robofleet.envs.jax.arenas import JaxArenas

    count = len(starts)
    numba = Arenas(config, count, 7, builds=unlike(config, odd_share), barrier=barrier)
    with closing(numba):
        other = JaxArenas(config, count, 7, builds=unlike(config, odd_share), barrier=barrier)
        for world in (numba, other):
            world.reset(np.arange(count), starts)
        yield numba, other


def apart(first: Array, other: Array) -> float:
    """Return how far poses are apart at most [m, rad]."""
    off = np.abs(first - other)
    off[..., 2] = np.abs((off[..., 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return float(off.max())


def test_robots_obey_as_numbas_do() -> None:
    """Behind a delay of three ticks, each another one, for 20 s."""
    import jax

    config = without_noise(load_config(PLATOON), actuation_delay_s=0.07)
    starts = np.repeat(STARTS[None], 8, axis=0)
    with both(config, starts, barrier=False, odd_share=0.2) as worlds:
        (numba, other), requests = worlds, np.repeat(commands(606)[:, None], 8, axis=1)
        began = other.state
        for request in requests:
            for world in worlds:
                world.step(request, OF_BODY)
        assert apart(numba.truths, other.truths) < CLOSE
        with jax.enable_x64(True):  # and so does a loop of JAX's own
            key = jax.random.key(1)
            ended, _ = jax.lax.scan(lambda state, u: (other.advance(state, u, OF_BODY, key), None), began, requests)
        assert np.array_equal(ended.body.x, other.truths[..., 0])
        assert np.hypot(*(numba.truths - starts)[..., :2].T).min() > 0.05
        assert jax.numpy.zeros(1).dtype == np.float32  # who trains beside it keeps numbers of 32 bits


def test_the_barrier_does_what_numbas_does() -> None:
    """Robots change sides among obstacles, a floor's corner and a cart, for 10 s: they hold each other, and turn.

    Not for longer: robots that press each other are chaotic, as their encoders count. After 20 s numba's own arenas
    end up to 0.5 mm elsewhere where their starts differ by 1e-15 m.
    """
    config = without_noise(load_config(SHIPPED / "obstacles.yaml", [CART]))
    rng = np.random.default_rng(3)
    starts = np.array([(-1.3, 0.6, 0.0), (-1.3, -0.2, 0.0), (1.3, 0.2, 3.1), (1.3, -0.6, 3.1)])
    starts = starts + rng.uniform(-0.1, 0.1, (8, 4, 3))
    goals, turned = starts[:, [3, 2, 1, 0], :2], 0
    with both(config, starts, barrier=True, odd_share=0.0) as (numba, other):
        for _ in range(303):
            poses = numba.poses[:, :4]
            ahead = poses[..., :2] + 0.08 * np.stack([np.cos(poses[..., 2]), np.sin(poses[..., 2])], axis=-1)
            way = goals - ahead
            away = np.linalg.norm(way, axis=-1, keepdims=True)
            for world in (numba, other):
                world.step(way / away * np.minimum(0.2, 2.0 * away), ~OF_BODY)
            assert other.state is not None
            turned += int((np.asarray(other.state.memory.turn) > 0).sum())
            assert apart(numba.truths, other.truths) < CLOSE
        assert apart(numba.poses, other.poses) < CLOSE
        assert np.array_equal(numba.truths[:, 4], other.truths[:, 4])
        assert numba.velocities == pytest.approx(other.velocities, abs=CLOSE)
    assert turned > 1000


def test_episodes_are_the_same() -> None:
    config, steps = without_noise(load_config(PLATOON)), []
    for backend in ("numba", "jax"):
        rng = np.random.default_rng(2)
        world = Episodes(config, "go_to", arenas=3, seed=1, randomise=0.0, barrier=False, backend=backend)
        with closing(world):
            brought = [world.reset()]
            for tick in range(30):
                step = world.step(rng.uniform(-1.0, 1.0, (3, 4, 2)))
                brought += [step.observations, step.rewards]
                if tick == 10:
                    brought.append(world.reset(np.array([1])))
            assert world.arenas.ticks.tolist() == [30, 19, 30]
            steps.append(brought)
    for numba, other in zip(*steps, strict=True):
        assert numba == pytest.approx(other, abs=CLOSE)


def test_noise_is_what_the_configuration_says_and_comes_from_the_seed() -> None:
    from robofleet.envs.jax.arenas import JaxArenas

    config, ends = load_config(PLATOON), []
    world = JaxArenas(config, 300, 1, builds=builds(config, 0.0), barrier=False)
    for seed in (1, 1, 2):
        world.seed(seed)
        world.reset(np.arange(300), np.repeat(STARTS[None], 300, axis=0))
        for request in commands(40):
            world.step(np.repeat(request[None], 300, axis=0), OF_BODY)
        deviation = np.std(world.poses - world.truths, axis=(0, 1))
        truth = config.tracker.truth
        sigma = truth.position_noise_m, truth.position_noise_m, truth.heading_noise_rad
        assert deviation == pytest.approx(sigma, rel=0.1)
        ends.append(world.truths)
    assert np.array_equal(ends[0], ends[1])
    assert len(np.unique(np.concatenate([ends[0], ends[2]])[:, 0, 0])) == 600  # slip is drawn for each robot

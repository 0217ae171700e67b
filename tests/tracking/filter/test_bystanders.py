"""Where robots stand that nobody drives: as seen last, and moved on for a moment where a hand pushes them."""

import math

import numpy as np
import pytest

from robofleet.core.clock import MS
from robofleet.tracking.filter.estimator import Bystanders

START_NS = 10**9
PERIOD_NS = 33 * MS
NOBODY = np.full((1, 3), np.nan)


@pytest.fixture
def bystanders() -> Bystanders:
    """Return one robot that nobody drives."""
    return Bystanders(np.array([0.05]), 0.133)


def seen(bystanders: Bystanders, poses: np.ndarray, start_ns: int = START_NS) -> int:
    """Let it be seen at (K, 3), an image a tick; returns the instant of the last one."""
    for k, pose in enumerate(poses):
        bystanders.observe(np.array([start_ns + k * PERIOD_NS]), pose[None])
    return start_ns + (len(poses) - 1) * PERIOD_NS


def pushed(speed: float, bearing: float, images: int = 40, sigma: float = 0.0) -> np.ndarray:
    """Return the poses of one that is pushed straight on (K, 3)."""
    way = speed * np.arange(images) * PERIOD_NS * 1e-9
    poses = np.stack([0.3 + way * math.cos(bearing), -0.2 + way * math.sin(bearing), np.full(images, 2.0)], axis=1)
    return np.asarray(poses + sigma * np.random.default_rng(1).standard_normal(poses.shape))


def test_one_that_stands_is_where_it_was_seen(bystanders: Bystanders) -> None:
    assert bystanders.measured_ns.tolist() == [0]
    last_ns = seen(bystanders, pushed(0.0, 0.0))
    assert bystanders.measured_ns.tolist() == [last_ns]
    assert bystanders.predict(last_ns + 10**9).tolist() == [[0.3, -0.2, 2.0]]
    assert bystanders.velocities.tolist() == [[0.0, 0.0]]


def test_the_noise_of_one_that_stands_moves_nobody(bystanders: Bystanders) -> None:
    fastest = 0.0
    for k, pose in enumerate(pushed(0.0, 0.0, 500, sigma=0.0004)):
        bystanders.observe(np.array([START_NS + k * PERIOD_NS]), pose[None])
        fastest = max(fastest, float(np.hypot(*bystanders.velocities[0])))
    assert fastest < 0.02


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("bearing", [0.0, 2.0, -1.0])
def test_one_that_is_pushed_is_known_to_move(bystanders: Bystanders, speed: float, bearing: float) -> None:
    last_ns = seen(bystanders, pushed(speed, bearing))
    velocity = speed * np.array([math.cos(bearing), math.sin(bearing)])
    assert bystanders.velocities[0] == pytest.approx(velocity, rel=0.01)
    for after_s, moved_s in ((0.0, 0.0), (0.05, 0.05), (0.133, 0.133), (1.0, 0.133)):
        expected = pushed(speed, bearing)[-1, :2] + moved_s * velocity
        assert bystanders.predict(last_ns + round(after_s * 1e9))[0, :2] == pytest.approx(expected, abs=1e-3 * speed)


def test_one_that_stops_is_known_to_stand_soon(bystanders: Bystanders) -> None:
    way = pushed(0.1, 0.0)
    last_ns = seen(bystanders, way)
    seen(bystanders, np.repeat(way[-1:], 12, axis=0), last_ns + PERIOD_NS)
    assert float(np.hypot(*bystanders.velocities[0])) < 0.003


@pytest.mark.parametrize(("jump", "carried"), [(0.0499, False), (0.0501, True)])
def test_one_that_is_carried_stands_where_it_was_put(bystanders: Bystanders, jump: float, carried: bool) -> None:
    last_ns = seen(bystanders, pushed(0.1, 1.0))
    pose = pushed(0.1, 1.0)[-1] + (jump, 0.0, 0.0)
    bystanders.observe(np.array([last_ns + PERIOD_NS]), pose[None])
    assert bystanders.predict(last_ns + PERIOD_NS)[0].tolist() == pose.tolist()
    assert (bystanders.velocities[0].tolist() == [0.0, 0.0]) == carried


def test_what_is_old_or_nothing_changes_nothing(bystanders: Bystanders) -> None:
    last_ns = seen(bystanders, pushed(0.1, 1.0))
    before = bystanders.predict(last_ns).tolist(), bystanders.velocities.tolist()
    bystanders.observe(np.array([last_ns + PERIOD_NS]), NOBODY)
    bystanders.observe(np.array([last_ns]), np.zeros((1, 3)))
    bystanders.observe(np.array([last_ns + PERIOD_NS]), np.array([[0.0, math.inf, 0.0]]))
    assert (bystanders.predict(last_ns).tolist(), bystanders.velocities.tolist()) == before
    assert bystanders.measured_ns.tolist() == [last_ns]


def test_each_is_on_its_own() -> None:
    bystanders = Bystanders(np.array([0.05, 0.05]), 0.133)
    for k, pose in enumerate(pushed(0.1, 0.0)):
        other = pose + np.array([0.5, 0.0, 0.0]) if k % 2 else np.full(3, np.nan)
        bystanders.observe(np.full(2, START_NS + k * PERIOD_NS), np.stack([pose, other]))
    assert bystanders.velocities[:, 0] == pytest.approx([0.1, 0.1], rel=0.01)

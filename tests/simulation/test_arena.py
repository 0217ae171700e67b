"""Where simulated robots were, by what their drivers said: between samples, before the first and after the newest."""

import math

import numpy as np
import pytest

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.simulation.arena import World
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth
from tests.shipped import PLATOON

Sample = tuple[int, float, float, float, float, float]  # when [ns], x, y [m], psi [rad], v [m/s], omega [rad/s]


def pose_at(instant_ns: int, *samples: Sample) -> tuple[float, ...] | None:
    """Return where the second robot was, of which alone something was said."""
    (pose,) = poses_at([instant_ns], *samples)
    return pose


def poses_at(instants_ns: list[int], *samples: Sample) -> list[tuple[float, ...] | None]:
    config, bus = load_config(PLATOON, ["drivers.robots_per_process=1"]), MemoryBus("platoon", SimulatedClock(), 0)
    world, publish = World(config, config.robots, bus), bus.publisher(TRUTH, "r2")
    for stamp_ns, *sample in samples:
        publish(TRUTH_LAYOUT.encode(Truth(1, S + stamp_ns, *sample)))
        world.update()
    poses = []
    for instant_ns in instants_ns:
        nobody, pose, *_ = world.moving(np.full(4, S + instant_ns), 1)[0].tolist()
        assert all(map(math.isnan, nobody))
        poses.append(None if math.isnan(pose[0]) else tuple(pose))
    return poses


def drive(duration_ms: int) -> list[Sample]:
    """True states every 0.1 ms of a robot whose motors (80 ms of lag) follow new commands every 33 ms."""
    x, y, psi, v, omega, step = 0.1, -0.2, 3.0, 0.0, 0.0, 1e-4
    samples = []
    for k in range(duration_ms * 10):
        samples.append((k * MS // 10, x, y, math.remainder(psi, math.tau), v, omega))
        tick = k // 330
        v_wanted, omega_wanted = 0.2 * math.cos(tick), 2.5 * math.sin(1.7 * tick)
        share = -math.expm1(-step / 0.08)
        v_next, omega_next = v + share * (v_wanted - v), omega + share * (omega_wanted - omega)
        middle = psi + omega * step / 2
        x += (v + v_next) / 2 * step * math.cos(middle)
        y += (v + v_next) / 2 * step * math.sin(middle)
        psi += (omega + omega_next) / 2 * step
        v, omega = v_next, omega_next
    return samples


def test_between_samples_it_is_where_the_robot_was() -> None:
    truth = drive(300)
    poses = poses_at([stamp_ns for stamp_ns, *_ in truth[:-100]], *truth[::100])
    for pose, (_, x, y, psi, _, _) in zip(poses, truth, strict=False):
        assert math.hypot(pose[0] - x, pose[1] - y) < 2e-5
        assert abs(math.remainder(pose[2] - psi, math.tau)) < math.radians(0.05)


def test_after_the_newest_it_goes_on_with_the_same_twist() -> None:
    pose = pose_at(100 * MS, (0, 0.0, 0.0, 0.0, 0.2, 2.0))
    assert pose == pytest.approx((0.1 * math.sin(0.2), 0.1 * (1 - math.cos(0.2)), 0.2))


def test_before_the_first_it_is_the_first_and_without_any_nothing() -> None:
    assert pose_at(0) is None
    assert pose_at(0, (10 * MS, 1.0, 2.0, 0.5, 0.2, 0.0)) == (1.0, 2.0, 0.5)


def test_only_the_newest_are_kept_and_late_ones_ignored() -> None:
    samples = [(k * MS, float(k), 0.0, 0.0, 0.0, 0.0) for k in range(40)]
    assert pose_at(0, *samples) == (8.0, 0.0, 0.0)
    late = (38 * MS, 99.0, 0.0, 0.0, 0.0, 0.0)
    assert pose_at(38 * MS, *samples, late) == pytest.approx((38.0, 0.0, 0.0))


def test_heading_turns_the_short_way_over_pi() -> None:
    pose = pose_at(5 * MS, (0, 0.0, 0.0, 3.14, 0.0, 0.4), (10 * MS, 0.0, 0.0, -3.14, 0.0, 0.4))
    assert abs(math.remainder(pose[2] - math.pi, math.tau)) < 0.002

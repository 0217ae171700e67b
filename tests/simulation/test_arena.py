import math
from collections.abc import Iterator

import pytest

from robofleet.simulation.arena import TruthHistory

MS = 1_000_000
Sample = tuple[int, float, float, float, float, float]


class History:
    """That of the second of two robots."""

    def __init__(self, capacity: int) -> None:
        self._both = TruthHistory(2, capacity)

    def add(self, stamp_ns: int, *sample: float) -> None:
        x, y, psi, v, omega = sample
        self._both.add(1, stamp_ns, (x, y, psi, v, omega))

    def pose_at(self, stamp_ns: int) -> tuple[float, ...] | None:
        nobody, pose = self._both.reported_at(stamp_ns).tolist()
        assert all(map(math.isnan, nobody))
        return None if math.isnan(pose[0]) else tuple(pose)


def drive(duration_ms: int) -> Iterator[Sample]:
    """True states every 0.1 ms of a robot whose motors (80 ms of lag) follow new commands every 33 ms."""
    x, y, psi, v, omega, step = 0.1, -0.2, 3.0, 0.0, 0.0, 1e-4
    for k in range(duration_ms * 10):
        yield k * MS // 10, x, y, math.remainder(psi, math.tau), v, omega
        tick = k // 330
        v_wanted, omega_wanted = 0.2 * math.cos(tick), 2.5 * math.sin(1.7 * tick)
        share = -math.expm1(-step / 0.08)
        v_next, omega_next = v + share * (v_wanted - v), omega + share * (omega_wanted - omega)
        middle = psi + omega * step / 2
        x += (v + v_next) / 2 * step * math.cos(middle)
        y += (v + v_next) / 2 * step * math.sin(middle)
        psi += (omega + omega_next) / 2 * step
        v, omega = v_next, omega_next


def test_between_samples_it_is_where_the_robot_was() -> None:
    history, truth = History(64), list(drive(600))
    for sample in truth[::100]:
        history.add(*sample)
    for stamp_ns, x, y, psi, _, _ in truth[:-100]:
        pose = history.pose_at(stamp_ns)
        assert pose is not None
        assert math.hypot(pose[0] - x, pose[1] - y) < 2e-5
        assert abs(math.remainder(pose[2] - psi, math.tau)) < math.radians(0.05)


def test_after_the_newest_it_goes_on_with_the_same_twist() -> None:
    history = History(4)
    history.add(0, 0.0, 0.0, 0.0, 0.2, 2.0)
    pose = history.pose_at(100 * MS)
    assert pose == pytest.approx((0.1 * math.sin(0.2), 0.1 * (1 - math.cos(0.2)), 0.2))


def test_before_the_first_it_is_the_first_and_without_any_nothing() -> None:
    history = History(4)
    assert history.pose_at(0) is None
    history.add(10 * MS, 1.0, 2.0, 0.5, 0.2, 0.0)
    assert history.pose_at(0) == (1.0, 2.0, 0.5)


def test_only_the_newest_are_kept_and_late_ones_ignored() -> None:
    history = History(2)
    for k in (0, 10, 20):
        history.add(k * MS, float(k), 0.0, 0.0, 0.0, 0.0)
    assert history.pose_at(0) == (10.0, 0.0, 0.0)
    history.add(15 * MS, 99.0, 0.0, 0.0, 0.0, 0.0)
    assert history.pose_at(20 * MS) == (20.0, 0.0, 0.0)


def test_heading_turns_the_short_way_over_pi() -> None:
    history = History(4)
    history.add(0, 0.0, 0.0, 3.14, 0.0, 0.4)
    history.add(10 * MS, 0.0, 0.0, -3.14, 0.0, 0.4)
    pose = history.pose_at(5 * MS)
    assert pose is not None
    assert abs(math.remainder(pose[2] - math.pi, math.tau)) < 0.002

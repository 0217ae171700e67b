"""The fleet filter against robots with lag and delay, outliers, hands, and a textbook Kalman filter."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.config.controller import FilterSettings
from robofleet.core.clock import MS, S
from robofleet.tracking.filter.estimator import CARRIED, UNUSED, USED, FleetFilter
from robofleet.vehicles.interface import WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL

TICK, LATE, DELAY = 33 * MS, 18 * MS, 2 * MS
NOISE = FilterSettings(efficiency_sigma=0.0)
LAG_ONLY = replace(IDEAL, motor_lag=0.08)


def apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between two poses."""
    return float(np.hypot(*(a[:2] - b[:2]))), abs(math.remainder(a[2] - b[2], math.tau))


class Lab:
    """One robot, its filter, and images of it, mid-exposure 18 ms before each tick."""

    def __init__(self, believed_lag: float = 0.08, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        self.plant = Plant(GTERNAL, LAG_ONLY, start, np.random.default_rng(1))
        self.filter = FleetFilter((replace(GTERNAL, motor_lag=believed_lag),), (DELAY,), NOISE)
        self.now_ns = 10 * S
        self.tick_ns = self.now_ns
        self.blocked = False
        self.exposed_ns = 0
        self._acting = self._next = WheelSpeeds(0.0, 0.0)

    def pose(self) -> np.ndarray:
        return np.array(self.plant.truth()[:3])

    def carry(self, by: tuple[float, float, float]) -> None:
        """Lift the robot and put it down somewhere else; its wheels are at rest then."""
        x, y, psi = (self.pose() + by).tolist()
        self.plant = Plant(GTERNAL, LAG_ONLY, (x, y, psi), np.random.default_rng(1))

    def tick(self, wheels: WheelSpeeds, add: np.ndarray | None = None, seen: bool = True) -> int:
        """Go on to the next tick, ask for ``wheels`` in it; returns what became of its image (``add``: its error)."""
        self.run_to(self.tick_ns + DELAY)
        self._acting = self._next
        self.tick_ns += TICK
        self.run_to(self.tick_ns - LATE)
        image = self.pose() + (0.0 if add is None else add)
        self.exposed_ns = self.now_ns
        self.run_to(self.tick_ns)
        poses = np.array([image if seen else [np.nan] * 3])
        used = int(self.filter.observe(np.array([self.exposed_ns]), poses)[0])
        here, _, _ = self.filter.predict(self.tick_ns)
        self.error = apart(here[0], self.pose())
        self._next = wheels
        self.filter.command(self.tick_ns, np.array([wheels]))
        return used

    def run_to(self, instant_ns: int) -> None:
        while self.now_ns < instant_ns:
            self.plant.step(self._acting, 1e-3, blocked=self.blocked)
            self.now_ns += MS


def weaving(k: int) -> WheelSpeeds:
    return WheelSpeeds(6.0 + 4.0 * math.sin(0.4 * k), 6.0 + 4.0 * math.cos(0.27 * k))


def test_it_predicts_through_lag_and_delay() -> None:
    def worst(believed_lag: float) -> float:
        lab, errors = Lab(believed_lag), []
        for k in range(200):
            lab.tick(weaving(k))
            errors.append(lab.error[0])
        return max(errors[30:])

    assert worst(0.08) < 0.00002  # nothing is left but the plant's 1 ms steps
    assert worst(0.0) > 0.001


def test_an_outlier_is_refused_and_changes_nothing() -> None:
    lab, steady = Lab(), WheelSpeeds(6.0, 6.0)
    for _ in range(30):
        lab.tick(steady)
    for outlier in ((0.05, 0.0, 0.0), (0.0, -0.05, 0.0), (0.0, 0.0, 1.5)):
        assert lab.tick(steady, np.array(outlier)) == UNUSED
        assert lab.error[0] < 0.001
        assert lab.tick(steady) == USED


def test_outliers_that_disagree_are_never_believed() -> None:
    lab, rng = Lab(), np.random.default_rng(2)
    for _ in range(10):
        lab.tick(WheelSpeeds(0.0, 0.0))
    for k in range(30):
        away = np.array([0.3 + 0.1 * (k % 2), rng.uniform(-0.3, 0.3), 0.0])
        assert lab.tick(WheelSpeeds(0.0, 0.0), away) == UNUSED
    assert lab.error[0] < 0.001


@pytest.mark.parametrize("by", [(0.6, -0.3, 1.0), (0.0, 0.0, math.pi)])
def test_a_carried_robot_is_found_after_a_few_images_and_reported(by: tuple[float, float, float]) -> None:
    lab = Lab()
    assert lab.tick(WheelSpeeds(5.0, 5.0)) == CARRIED  # seen for the first time
    for _ in range(30):
        assert lab.tick(WheelSpeeds(5.0, 5.0)) == USED
    lab.carry(by)
    results = [lab.tick(WheelSpeeds(5.0, 5.0)) for _ in range(8)]
    found = results.index(CARRIED)
    assert results[:found] == [UNUSED] * found
    assert 2 <= found < 8
    assert results.count(CARRIED) == 1
    assert lab.error[0] < 0.0005
    assert lab.error[1] < 0.01


def test_a_robot_that_is_held_up_is_no_outlier() -> None:
    lab = Lab()
    for _ in range(30):
        lab.tick(WheelSpeeds(8.0, 8.0))
    lab.blocked = True
    for k in range(30):
        assert lab.tick(WheelSpeeds(8.0, 8.0)) == USED
        if k > 3:
            assert lab.error[0] < 8.0 * 0.016 * (0.033 + 0.018)  # not believed to drive on


def test_an_image_that_is_not_newer_is_not_used() -> None:
    lab = Lab()
    for k in range(30):
        lab.tick(weaving(k))
    before, _, _ = lab.filter.predict(lab.tick_ns)
    for exposed_ns in (lab.exposed_ns, lab.exposed_ns - MS, 1):
        assert lab.filter.observe(np.array([exposed_ns]), np.zeros((1, 3))).tolist() == [UNUSED]
    after, _, _ = lab.filter.predict(lab.tick_ns)
    assert np.array_equal(before, after)
    assert lab.filter.measured_ns[0] == lab.exposed_ns


def test_a_robot_that_is_not_seen_is_predicted_on() -> None:
    lab = Lab()
    for k in range(30):
        lab.tick(weaving(k))
    exposed_ns = lab.exposed_ns
    for k in range(15):
        assert lab.tick(weaving(k), seen=False) == UNUSED
        assert lab.error[0] < 0.002
    assert lab.filter.measured_ns[0] == exposed_ns


@pytest.mark.parametrize("spin", [4.0, -4.0])
def test_the_heading_wraps_at_pi(spin: float) -> None:
    lab = Lab(start=(0.0, 0.0, math.copysign(3.0, spin)))
    for k in range(120):
        assert lab.tick(WheelSpeeds(-spin, spin)) == (USED if k else CARRIED)
        here, predicted, _ = lab.filter.predict(lab.tick_ns + 5 * TICK)
        assert (-math.pi < np.array([here[0, 2], predicted[0, 2]])).all()
        assert (np.array([here[0, 2], predicted[0, 2]]) <= math.pi).all()
        if k > 30:
            assert lab.error[1] < 0.005


def test_noise_about_pi_is_no_outlier() -> None:
    lab = Lab(start=(0.0, 0.0, math.pi))
    for k in range(50):
        beyond = 0.004 - math.tau  # as a camera reports pi + 0.004
        error = np.array([0.0, 0.0, beyond if k % 2 else -0.004])
        assert lab.tick(WheelSpeeds(0.0, 0.0), error) == (USED if k else CARRIED)
        if k > 20:
            assert lab.error[1] < 0.004


def test_before_the_first_image_it_knows_nothing_and_takes_no_time() -> None:
    """The clock's zero may be weeks ago: nothing is integrated from there."""
    fleet = FleetFilter((GTERNAL,) * 4, (DELAY,) * 4, NOISE)
    month_ns = 30 * 24 * 3600 * S
    for k in range(100):
        fleet.command(month_ns + k * TICK, np.full((4, 2), 5.0))
        here, predicted, _ = fleet.predict(month_ns + k * TICK)
        assert not here.any()
        assert not predicted.any()
    assert not fleet.measured_ns.any()

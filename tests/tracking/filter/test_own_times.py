"""Each robot at its own times: delays, lags and mid-exposures that differ from robot to robot."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.drivers.simulated import SimulatedRobot
from robofleet.tracking.filter.estimator import CARRIED, UNUSED, USED, FleetFilter
from robofleet.vehicles.interface import DriverContext, Simulation, WheelSpeeds
from tests.robots import GTERNAL, WORN
from tests.tracking.filter.test_estimator import NOISE

TICK = 33 * MS
NO_SPREAD = replace(WORN, wheel_gain_spread=0.0, wheel_base_spread=0.0)
SEEN = np.array([3e-5, 3e-5, math.radians(0.05)])  # what the tracker's poses are worth


class Fleet:
    """Simulated robots with delays and lags of their own, and the filter that is told of them."""

    def __init__(
        self,
        delays_s: list[float],
        lags_s: list[float],
        before_ns: list[int],
        *,
        lost: float = 0.0,
        reports: bool = True,
    ) -> None:
        self.now_ns = 10 * S
        self.rng, self.lost, self.before_ns = np.random.default_rng(4), lost, before_ns
        self.robots: list[SimulatedRobot] = []
        self.images: list[list[np.ndarray]] = [[] for _ in delays_s]
        for row, (delay_s, lag_s) in enumerate(zip(delays_s, lags_s, strict=True)):
            faults = replace(NO_SPREAD, actuation_delay=delay_s, motor_lag=lag_s)
            simulation = Simulation(
                drive=GTERNAL, imperfections=faults, start=(0.0, 0.0, 3.0), trouble=None, rng=np.random.default_rng(row)
            )
            self.robots.append(
                SimulatedRobot(
                    DriverContext(robot=f"r{row}", drive=GTERNAL, simulation=simulation, now_ns=lambda: self.now_ns)
                )
            )
        drives = tuple(replace(GTERNAL, motor_lag=lag_s if reports else 0.0) for lag_s in lags_s)
        self.filter = FleetFilter(drives, tuple(round(delay_s * S) if reports else 0 for delay_s in delays_s), NOISE)

    def run(self, seconds: float) -> tuple[float, float]:
        """Weave, hard; return the rms error of the poses at the tick [mm, deg]."""
        errors = []
        for k in range(round(seconds * S / TICK)):
            tick_ns = 10 * S + (k + 1) * TICK
            for row, before_ns in sorted(enumerate(self.before_ns), key=lambda item: -(item[1] % TICK)):
                self.now_ns = tick_ns - before_ns % TICK
                seen = np.array(self.robots[row].truth()[:3]) + SEEN * self.rng.normal(size=3)
                self.images[row].append(seen if self.rng.random() >= self.lost else np.full(3, np.nan))
            self.now_ns = tick_ns
            if k > 2:
                ages = [before_ns // TICK for before_ns in self.before_ns]  # in ticks
                poses = np.array([images[-1 - age] for images, age in zip(self.images, ages, strict=True)])
                self.filter.observe(tick_ns - np.array(self.before_ns), poses)
            here, _, _ = self.filter.predict(tick_ns)
            true = np.array([robot.truth()[:3] for robot in self.robots])
            if k > 60:
                errors.append(here - true)
            wheels = np.array([[6.0 + 4.5 * math.sin(0.7 * k), 6.0 + 4.5 * math.cos(0.45 * k)]] * len(self.robots))
            for robot, (left, right) in zip(self.robots, wheels.tolist(), strict=True):
                robot.write(WheelSpeeds(left, right))
            self.filter.command(tick_ns, wheels)
        error = np.concatenate(errors)
        turn = np.sin(error[:, 2] / 2) * 2
        return 1e3 * float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean())), math.degrees(np.sqrt((turn**2).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay_s", "before_ms"),
    [(0.002, 45), (0.045, 18), (0.027, 18)],
    ids=["images 45 ms old", "commands 45 ms late", "45 ms from exposure to effect"],
)
def test_the_pose_now_through_45_ms_of_delay_60_ms_of_lag_and_lost_images(delay_s: float, before_ms: int) -> None:
    error_mm, error_deg = Fleet([delay_s], [0.06], [before_ms * MS], lost=0.2).run(60.0)
    assert error_mm <= 0.3
    assert error_deg <= 0.2


@pytest.mark.slow
def test_every_robot_has_its_own_delay_lag_and_exposure() -> None:
    different = [0.0, 0.02, 0.07, 0.045], [0.0, 0.12, 0.03, 0.06], [28 * MS, 18 * MS, 8 * MS, 45 * MS]
    error_mm, _ = Fleet(*different).run(20.0)
    assert error_mm < 0.15
    believed_alike, _ = Fleet(*different, reports=False).run(20.0)
    assert believed_alike > 1.0


def test_a_command_is_predicted_to_act_when_its_robot_does() -> None:
    fleet = FleetFilter((replace(GTERNAL, motor_lag=0.0),) * 2, (10 * MS, 60 * MS), NOISE)
    fleet.observe(np.full(2, S), np.zeros((2, 3)))
    fleet.command(S + 10 * MS, np.full((2, 2), 10.0))
    here, predicted, _ = fleet.predict(S + 50 * MS)
    assert here[:, 0] == pytest.approx([0.16 * 0.030, 0.0], abs=1e-9)  # 30 ms of 10 rad/s; nothing yet
    assert predicted[:, 0] == pytest.approx([0.16 * 0.040, 0.16 * 0.040], abs=1e-9)  # at 60 ms, and at 110 ms


def test_what_is_old_for_one_robot_may_be_new_for_another() -> None:
    fleet = FleetFilter((GTERNAL,) * 2, (0, 0), NOISE)
    assert fleet.observe(np.array([S + 9 * MS, S]), np.zeros((2, 3))).tolist() == [CARRIED, CARRIED]
    assert fleet.observe(np.array([S + 5 * MS, S + 5 * MS]), np.zeros((2, 3))).tolist() == [UNUSED, USED]
    assert fleet.measured_ns.tolist() == [S + 9 * MS, S + 5 * MS]

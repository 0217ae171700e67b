"""A plant of one's own behind simulated robots: their commands, their time, what they report."""

import math

import numpy as np
import pytest

from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from robofleet.vehicles.interface import STOP, BodyTrouble, WheelSpeeds
from robofleet.vehicles.plant import WATCHDOG_NS, Plant
from robofleet.vehicles.plants import PlantContext, PlantState, SharedPlant
from tests.shipped import PLATOON

DELAYED = [f"robots.{row}.vehicle.simulated.actuation_delay_s=0.025" for row in (0, 1)]
EXACT = [f"robots.{row}.vehicle.simulated.{key}=0" for row in (0, 1)
         for key in ("motor_lag_s", "slip_s_per_rad", "deadband_rad_s", "breakaway_rad_s")]  # fmt: skip


class Unhurried:
    """Wheels that turn as they are told at once, without slip."""

    def __init__(self, context: PlantContext) -> None:
        self._builds = [robot.build for robot in context.robots]
        self._poses = np.array([robot.start for robot in context.robots])
        self._angles, self._speeds = np.zeros((2, len(self._builds), 2))

    def step(self, setpoints: np.ndarray, duration: float) -> None:
        self._speeds = setpoints.copy()
        self._angles = self._angles + setpoints * duration
        for pose, motion in zip(self._poses, self._motions(), strict=True):
            pose[:] = arc(*pose, *motion, duration)

    def state(self) -> PlantState:
        return PlantState(self._poses.copy(), np.array(self._motions()), self._angles, self._speeds)

    def _motions(self) -> list[tuple[float, float]]:
        rows = zip(self._builds, self._speeds.tolist(), strict=True)
        return [
            body_from_wheels(b.left_gain * left, b.right_gain * right, b.wheel_radius, b.wheel_base)
            for b, (left, right) in rows
        ]


def config(*changes: str) -> Config:
    return load_config(PLATOON, [*EXACT, "plant.model=tests.vehicles.test_plants:Unhurried", *changes])


def shared(*changes: str) -> SharedPlant:
    plant = slices.shared_plant(config(*changes), ["r1", "r2"], 0)
    assert plant is not None
    return plant


def own(robot: str, *changes: str) -> Plant:
    s = slices.simulation(config(*changes), config(*changes).robot(robot), None)
    return Plant(s.drive, s.imperfections, s.start, s.rng)


def test_the_own_plant_is_the_default() -> None:
    assert slices.shared_plant(load_config(PLATOON), ["r1", "r2"], 0) is None


@pytest.mark.parametrize("changes", [(), DELAYED], ids=["at once", "delayed"])
def test_robots_of_a_plant_are_commanded_and_read_as_others(changes: list[str]) -> None:
    plant, commands = shared(*changes), ((0, 8.0, 6.0), (3, -2.0, 5.0), (41, 12.5, 12.5), (47, 1.0, -9.0))
    for name in ("r1", "r2"):
        reference = own(name, *changes)
        for at_ms, left, right in commands if name == "r1" else ():
            for robot in (reference, plant.robot("r1")):
                robot.advance(at_ms * MS)
                robot.write(WheelSpeeds(left, right), off_ns=at_ms * MS + WATCHDOG_NS)
        for robot in (reference, plant.robot(name)):
            robot.advance(1000 * MS)
        assert tuple(plant.robot(name).truth()) == pytest.approx(tuple(reference.truth()), abs=1e-8)
        assert tuple(plant.robot(name).reading()) == pytest.approx(tuple(reference.reading()), abs=1e-8)
    assert plant.robot("r1").truth().v == 0.0  # the watchdog


def test_a_wheel_that_runs_and_motors_that_stand() -> None:
    plant = shared()
    trouble = BodyTrouble(left=4.0)
    robot, other = plant.robot("r1", lambda: trouble), plant.robot("r2")
    robot.write(STOP)
    plant.advance(100 * MS)
    assert robot.reading().left_speed == pytest.approx(4.0, abs=0.3)
    assert other.reading().left_speed == 0.0
    trouble = BodyTrouble(stuck=True)
    robot.write(WheelSpeeds(9.0, 9.0))
    plant.advance(200 * MS)
    before = robot.truth()
    plant.advance(300 * MS)
    assert tuple(robot.truth()) == tuple(before)
    assert math.isclose(robot.reading().battery, 1.0, abs_tol=1e-3)


def test_distance_sensors_see_the_robots_of_the_same_plant() -> None:
    perfect = [f"robots.0.vehicle.sensors.distances.{error}=0" for error in ("noise", "dropout", "outliers")]
    starts = [f"robots.{row}.start={{x_m: {0.3 * row}, y_m: 0, heading_deg: 0}}" for row in (0, 1)]
    drivers = ConfiguredDrivers(config("robots.0.sensors=true", "arena.walls=[]", *perfect, *starts), lambda: 0)
    sensors = drivers.driver(drivers.context("r1")).read().sensors
    assert sensors is not None
    assert sensors.distances[3] == pytest.approx(0.3 - 0.05 - 0.055, abs=1e-3)  # of the sensor ahead, to r2's disc

"""The GTernal's sensors, through its driver and its twin's serial line."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.config import slices
from robofleet.simulation.twin import Twin
from robofleet.testing import DriverBench, DriverSubject
from robofleet.vehicles.interface import DriverError, WheelSpeeds
from robofleet.vehicles.readings import TruePose
from robofleet.vehicles.sensors import Sensing, SimulatedSensors

EXACT = DriverSubject("gternal", twin="gternal", vehicle="ideal", sensors=True, encoders=False)
MM = 0.0005 + 1e-9  # it tells whole millimetres
DEGREES = math.radians(1 / 32) + 1e-9  # and sixteenths of degrees


def expected(bench: DriverBench, truth: TruePose, *others: TruePose) -> np.ndarray:  # type: ignore[type-arg]
    """Return the true distances within range; NaN beyond it."""
    kind = bench.sensors
    assert kind is not None and kind.distances is not None
    eyes = SimulatedSensors([0], [Sensing(kind, slices.walls(bench.config.arena), np.random.default_rng(1))])
    (true,) = eyes.true_distances(np.array([truth, *others]), np.full(1 + len(others), 0.055))
    return np.where(true > kind.distances.range, np.nan, true)


def test_distances_and_heading_come_through_the_line() -> None:
    with DriverBench(EXACT) as bench:
        bench.make()
        bench.drive(WheelSpeeds(6.0, 9.0), 4.0)
        assert bench.twin is not None
        turned = bench.twin.truth().psi
        (*_, last) = bench.drive(WheelSpeeds(0.0, 0.0), 0.5)
        truth = bench.twin.truth()
        assert abs(turned - bench.config.robots[0].start.psi) > 1.0  # type: ignore[union-attr]
        assert last.reading is not None and last.reading.sensors is not None
        sensors = last.reading.sensors
        np.testing.assert_allclose(sensors.distances, expected(bench, truth), atol=MM)
        assert np.isfinite(sensors.distances).any()
        assert sensors.heading is not None
        assert math.remainder(sensors.heading - truth.psi, math.tau) == pytest.approx(0.0, abs=DEGREES)
        assert (sensors.gyro, sensors.accelerometer, sensors.magnetometer) == (None, None, None)


def test_it_sees_the_other_twins() -> None:
    with DriverBench(EXACT) as bench:
        x, y, psi = slices.start_pose(bench.config.robots[0])
        other = TruePose(x + 0.3 * math.cos(psi), y + 0.3 * math.sin(psi), 0.0, 0.0, 0.0)
        assert isinstance(bench.twin, Twin)
        bench.twin.others = lambda: [(other, 0.055)]
        driver = bench.make()
        sensors = driver.read().sensors
        assert sensors is not None
        np.testing.assert_allclose(sensors.distances, expected(bench, bench.twin.truth(), other), atol=MM)
        assert sensors.distances is not None and sensors.distances[3] == pytest.approx(0.3 - 0.055 - 0.05, abs=MM)


def test_a_firmware_that_does_not_tell_them_is_named() -> None:
    with DriverBench(EXACT) as bench:
        assert bench.twin is not None
        bench.twin.hardware.sense = None
        with pytest.raises(DriverError, match=r"its firmware does not tell distances and orientation: .*sensors: true"):
            bench.make()


def test_other_sensors_than_it_has_are_named() -> None:
    with DriverBench(EXACT) as bench:
        assert bench.sensors is not None and bench.sensors.distances is not None
        fewer = replace(bench.sensors.distances, places=bench.sensors.distances.places[:5])
        bench.sensors = replace(bench.sensors, distances=fewer)
        with pytest.raises(DriverError, match=r"it tells 7 distances, but vehicle\.sensors\.distances has 5 places"):
            bench.make()


def test_what_it_told_long_ago_is_not_told_again() -> None:
    with DriverBench(EXACT) as bench:
        assert bench.twin is not None and bench.sensors is not None
        bench.sensors = replace(bench.sensors, period=0.2)
        bench.make()
        bench.twin.hardware.sense = None  # from now on it answers the lines between
        readings = [moment.reading for moment in bench.drive(WheelSpeeds(2.0, 2.0), 1.0)]
        assert readings[10] is not None and readings[10].sensors is not None
        assert readings[-1] is not None and readings[-1].sensors is None

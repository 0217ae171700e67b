"""The fleet filter's certainty is what it deserves: a textbook Kalman filter agrees, innovations have their size."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.tracking.filter.estimator import UNUSED, USED, FleetFilter
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.robots import GTERNAL
from tests.tracking.filter.test_estimator import NOISE

DRIVE = replace(GTERNAL, motor_lag=0.0)
ROBOTS, IMAGES, PERIOD_S = 40, 100, 0.033
WHEELS = np.random.default_rng(5).uniform(2.0, 10.0, (ROBOTS, 2))
R = np.diag([0.0004, 0.0004, 0.006]) ** 2
Q = np.diag([0.0015, 0.0015, 0.06]) ** 2 * PERIOD_S


def moved(pose: np.ndarray, wheels: np.ndarray) -> np.ndarray:
    v, omega = body_from_wheels(*wheels, DRIVE.wheel_radius, DRIVE.wheel_base)
    return np.array(arc(*pose, v, omega, PERIOD_S))


def world(rng: np.random.Generator, wheels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return measured poses (IMAGES, ROBOTS, 3) of robots that drift as the filter believes; and the true ones."""
    true = [np.column_stack([rng.uniform(-1, 1, (ROBOTS, 2)), rng.uniform(-3, 3, ROBOTS)])]
    for _ in range(IMAGES - 1):
        on = np.array([moved(p, w) for p, w in zip(true[-1], wheels, strict=True)])
        true.append(on + rng.normal(size=(ROBOTS, 3)) * np.sqrt(np.diag(Q)))
    poses = np.array(true)
    return poses + rng.normal(size=poses.shape) * np.sqrt(np.diag(R)), poses


def wrapped(pose: np.ndarray) -> np.ndarray:
    return np.array([pose[0], pose[1], math.remainder(pose[2], math.tau)])


class Textbook:
    """Extended Kalman filter of one robot, by matrices."""

    def __init__(self, pose: np.ndarray) -> None:
        self.pose, self.p = pose, R.copy()

    def observe(self, image: np.ndarray, wheels: np.ndarray) -> float:
        """Use an image and return the normalised innovation squared."""
        before, self.pose = self.pose, moved(self.pose, wheels)
        dx, dy = (self.pose - before)[:2]
        F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        self.p = F @ self.p @ F.T + Q
        innovation = wrapped(image - self.pose)
        s = self.p + R
        gain = self.p @ np.linalg.inv(s)
        self.pose = wrapped(self.pose + gain @ innovation)
        self.p = (np.eye(3) - gain) @ self.p
        return float(innovation @ np.linalg.solve(s, innovation))


def instants() -> list[int]:
    return [10 * S + k * 33 * MS for k in range(IMAGES)]


def test_it_is_the_textbooks_filter_and_its_innovations_are_chi_square() -> None:
    images, true = world(np.random.default_rng(11), WHEELS)
    fleet = FleetFilter((DRIVE,) * ROBOTS, (0,) * ROBOTS, NOISE.model_copy(update={"gate_sigma": 1e6}))
    fleet.command(1, WHEELS)
    books = [Textbook(wrapped(image)) for image in images[0]]
    nis, errors = [], []
    for k, instant in enumerate(instants()):
        used = fleet.observe(np.full(ROBOTS, instant), images[k])
        here, _, _ = fleet.predict(instant)
        if k:
            assert (used == USED).all()
            nis += [b.observe(image, w) for b, image, w in zip(books, images[k], WHEELS, strict=True)]
        expected = np.array([b.pose for b in books])
        assert here[:, :2] == pytest.approx(expected[:, :2], abs=1e-9)
        assert np.abs(np.sin((here - expected)[:, 2] / 2)).max() < 1e-9
        errors.append(here[:, :2] - true[k][:, :2])
    deviation = math.sqrt(2 * 3 / len(nis))  # of the mean of so many chi-squares of 3 degrees of freedom
    assert np.mean(nis) == pytest.approx(3.0, abs=4 * deviation)
    better = np.sqrt(np.mean(np.square(errors[10:]))) / 0.0004
    assert better < 0.7  # the filter is worth its while


def test_the_gate_refuses_as_many_good_images_as_chi_square_says() -> None:
    """Robots at rest; the gate is the 99 % quantile of chi-square with 3 degrees of freedom."""
    images, _ = world(np.random.default_rng(12), np.zeros((ROBOTS, 2)))
    fleet = FleetFilter((DRIVE,) * ROBOTS, (0,) * ROBOTS, NOISE.model_copy(update={"gate_sigma": math.sqrt(11.345)}))
    used = [fleet.observe(np.full(ROBOTS, instant), image) for instant, image in zip(instants(), images, strict=True)]
    refused = (np.array(used[1:]) == UNUSED).mean()
    assert 0.005 < refused < 0.016

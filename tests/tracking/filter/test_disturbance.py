"""Wheels that do not do as asked: what the filter finds out about them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.config.controller import FilterSettings
from robofleet.tracking.filter.estimator import FleetFilter
from robofleet.vehicles.differential_drive import arc, body_from_wheels
from tests.robots import GTERNAL

DRIVE = replace(GTERNAL, motor_lag=0.0)
TICK = 33_000_000
L = 0.08
NOISE = FilterSettings()


def drive(noise: FilterSettings, efficiency: tuple[float, float], seconds: float) -> tuple[FleetFilter, np.ndarray]:
    """Drive a robot whose wheels travel ``efficiency`` of what is believed; return the filter and the true pose."""
    fleet, pose, rng = FleetFilter((DRIVE,), (0,), noise), (0.1, -0.2, 0.5), np.random.default_rng(3)
    instant = 10**12
    for k in range(round(seconds / 0.033)):
        wheels = (6.0 + math.sin(0.05 * k), 5.0 + math.cos(0.03 * k))
        fleet.command(instant, np.array([wheels]))
        v, omega = body_from_wheels(efficiency[0] * wheels[0], efficiency[1] * wheels[1], 0.016, 0.105)
        pose = arc(*pose, v, omega, 0.033)
        instant += TICK
        measured = np.array(pose) + rng.normal(0, (0.0002, 0.0002, 0.002))
        fleet.observe(np.array([instant]), measured[None])
    return fleet, np.array([pose])


@pytest.mark.parametrize("efficiency", [(0.9, 0.9), (1.0, 0.93), (1.05, 0.97)])
def test_the_missing_velocity_is_found(efficiency: tuple[float, float]) -> None:
    fleet, pose = drive(NOISE, efficiency, 15.0)
    wheels = np.array([6.5, 4.5])
    fleet.command(10**15, wheels[None])
    v, omega = body_from_wheels(*(wheels * (np.array(efficiency) - 1.0)).tolist(), 0.016, 0.105)
    c, s = math.cos(pose[0, 2]), math.sin(pose[0, 2])
    missing = np.array([c * v - s * L * omega, s * v + c * L * omega])
    found = fleet.disturbance(pose, L)[0]
    assert np.linalg.norm(found - missing) < 0.0015  # of about 0.1 m/s
    assert np.linalg.norm(missing) > 0.002


def test_a_robot_at_rest_has_no_disturbance() -> None:
    fleet, pose = drive(NOISE, (0.9, 0.9), 5.0)
    fleet.command(10**15, np.zeros((1, 2)))
    assert np.all(fleet.disturbance(pose, L) == 0.0)


def test_without_it_every_wheel_is_taken_as_believed() -> None:
    fleet, pose = drive(FilterSettings(efficiency_sigma=0.0), (0.9, 0.9), 5.0)
    assert np.all(fleet.disturbance(pose, L) == 0.0)

"""Delay and lag from drives whose truth is known: found to a millisecond, or refused."""

from dataclasses import replace

import numpy as np
import pytest

from robofleet.calibration.robots import inputs, latency
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.information import PARAMETERS as MODEL
from robofleet.calibration.robots.information import SYSTEMATIC_VARIANCE
from robofleet.calibration.store import CalibrationError

from .conftest import LATE, Make
from .conftest import found as identified
from .test_offsets import part

COUNT = 0.001  # of an encoder whose counts cannot be seen [rad]


def find(drive: RobotDrive) -> latency.Latency:
    inputs.refuse_unusable(drive)
    latency.refuse_unusable(drive)
    return latency.of(identified(drive))


@pytest.mark.parametrize(
    ("delay_s", "lag_s"),
    [
        pytest.param(0.043, 0.06, marks=pytest.mark.slow),
        *[pytest.param(*known, marks=pytest.mark.long) for known in ((0.0, 0.0), (0.002, 0.08), (0.12, 0.2))],
    ],
)
def test_delay_and_lag_are_found_to_a_millisecond(driven: Make, delay_s: float, lag_s: float) -> None:
    found = find(driven(replace(LATE, actuation_delay=delay_s, motor_lag=lag_s)))
    assert found.delay_s == pytest.approx(delay_s, abs=0.001)
    assert found.motor_lag_s == pytest.approx(lag_s, abs=0.001)
    assert found.sigma[0] < 0.001


@pytest.mark.long
@pytest.mark.parametrize("counting", [False, True], ids=["poses", "encoders"])
def test_sigma_is_what_drives_scatter_by(smooth: RobotDrive, *, counting: bool) -> None:
    counted = slice(None if counting else 0)
    smooth = replace(smooth, encoders_s=smooth.encoders_s[counted], encoders_rad=smooth.encoders_rad[counted])
    rng, found = np.random.default_rng(7), []
    for _ in range(4):
        noise = rng.normal(size=smooth.poses.shape) * (3e-4, 3e-4, 0.004)
        rounding = COUNT * rng.uniform(-0.5, 0.5, smooth.encoders_rad.shape)
        found.append(find(replace(smooth, poses=smooth.poses + noise, encoders_rad=smooth.encoders_rad + rounding)))
    errors = np.array([(result.delay_s, result.motor_lag_s) for result in found]) - (0.043, 0.06)
    stated = np.array([result.sigma for result in found])
    if counting:  # they tell the lag far better than a robot's firmware knows its instants, and these know them
        stated = np.sqrt(stated**2 - SYSTEMATIC_VARIANCE[[MODEL.index(name) for name in latency.PARAMETERS]])
    scatter = np.sqrt((errors**2).mean(axis=0)) / stated.mean(axis=0)
    assert (scatter > 0.3).all()
    assert (scatter < 2.2).all()


@pytest.mark.slow
def test_outliers_and_missing_images_change_little(driven: Make) -> None:
    drive = driven(lost=0.2)
    rng, poses = np.random.default_rng(3), drive.poses.copy()
    wrong = rng.choice(len(poses), 30, replace=False)
    poses[wrong] += rng.normal(size=(30, 3)) * (0.02, 0.02, 0.5)
    found = find(replace(drive, poses=poses))
    assert (found.delay_s, found.motor_lag_s) == pytest.approx((0.043, 0.06), abs=0.001)
    assert 20 <= found.found.left_out <= 70


@pytest.mark.slow
def test_too_little_is_refused(worn: RobotDrive) -> None:
    def refusal(drive: RobotDrive) -> str:
        with pytest.raises(CalibrationError) as refused:
            find(drive)
        (line,) = refused.value.faults
        return line

    assert "changed 4 times only" in refusal(part(worn, 0.0, 11.0))
    assert "seen in 0 %" in refusal(replace(worn, poses_s=worn.poses_s[:0], poses=worn.poses[:0]))
    assert "time stamps" in refusal(replace(worn, poses_s=worn.poses_s - 0.06))  # before it was told to move

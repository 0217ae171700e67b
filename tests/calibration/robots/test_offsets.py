"""Offsets from drives whose truth is known: found, with the sigma that they deserve, or refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.calibration.robots import offsets
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import TagOffset
from tests.robots import GTERNAL

from .conftest import LATE, OFFSET, Make

pytestmark = pytest.mark.long

TRUE_TAG = np.array([OFFSET.forward_m, OFFSET.left_m, OFFSET.heading_deg])


def true_wheels(seed: int) -> tuple[float, float]:
    """Return radius and base of the simulated robot of a seed, as its plant draws them."""
    left, right, base = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return (
        GTERNAL.wheel_radius * (1 + LATE.wheel_gain_spread * (left + right) / 2),
        GTERNAL.wheel_base * (1 + LATE.wheel_base_spread * base),
    )


def without_encoders(drive: RobotDrive) -> RobotDrive:
    return replace(drive, encoders_s=np.empty(0), encoders_rad=np.empty((0, 2)))


@pytest.mark.parametrize("encoders", [True, False])
def test_the_tag_is_placed_and_the_wheels_are_measured(worn: RobotDrive, encoders: bool) -> None:
    found = offsets.find(worn if encoders else without_encoders(worn), GTERNAL)
    assert found.by_encoders == encoders
    error = np.abs(found.values[:3] - TRUE_TAG)
    assert error[:2].max() < 0.00004
    assert error[2] < 0.03
    radius, base = true_wheels(1)
    assert found.wheel_radius_m == pytest.approx(radius, rel=0.001)
    assert found.wheel_base_m == pytest.approx(base, rel=0.005)


@pytest.mark.parametrize("heading_deg", [90.0, 179.0, -135.0])
def test_a_tag_may_be_glued_on_any_way_round(driven: Make, heading_deg: float) -> None:
    turned = TagOffset(forward_m=-0.02, left_m=0.03, heading_deg=heading_deg)
    found = offsets.find(driven(offset=turned), GTERNAL)
    assert (1e3 * found.tag_offset.forward_m, 1e3 * found.tag_offset.left_m) == pytest.approx((-20, 30), abs=0.06)
    assert found.tag_offset.heading_deg == pytest.approx(heading_deg, abs=0.03)


def test_sigma_is_what_drives_scatter_by(smooth: RobotDrive) -> None:
    rng, found = np.random.default_rng(7), []
    for _ in range(8):
        noise = rng.normal(size=smooth.poses.shape) * (3e-4, 3e-4, 0.004)
        found.append(offsets.find(replace(smooth, poses=smooth.poses + noise), GTERNAL))
    errors = np.array([result.values for result in found]) - [*TRUE_TAG, GTERNAL.wheel_radius, GTERNAL.wheel_base]
    scatter = np.sqrt((errors**2).mean(axis=0)) / np.array([result.sigma for result in found]).mean(axis=0)
    assert (scatter > 0.4).all()
    assert (scatter < 2.0).all()


def test_outliers_change_little_and_are_counted(worn: RobotDrive) -> None:
    rng, poses = np.random.default_rng(3), worn.poses.copy()
    wrong = rng.choice(len(poses), 40, replace=False)
    poses[wrong] += rng.normal(size=(40, 3)) * (0.02, 0.02, 0.5)
    found = offsets.find(replace(worn, poses=poses), GTERNAL)
    assert 30 <= found.left_out <= 90
    assert np.abs(found.values[:2] - TRUE_TAG[:2]).max() < 0.00006
    assert abs(found.values[2] - TRUE_TAG[2]) < 0.04


def test_missing_images_do_no_harm(driven: Make) -> None:
    found = offsets.find(driven(lost=0.2), GTERNAL)
    assert np.abs(found.values[:2] - TRUE_TAG[:2]).max() < 0.00005
    assert abs(found.values[2] - TRUE_TAG[2]) < 0.03


def test_a_robot_without_encoders_is_measured_by_what_reached_it_and_when(driven: Make) -> None:
    """On a busy machine commands come late: a way that was asked for is not one that was told."""
    found = offsets.find(without_encoders(driven(late=15_000_000)), GTERNAL)
    assert not found.by_encoders
    radius, base = true_wheels(1)
    assert found.wheel_radius_m == pytest.approx(radius, rel=0.002)
    assert found.wheel_base_m == pytest.approx(base, rel=0.005)


def test_counts_that_are_old_now_more_now_less_do_no_harm(worn: RobotDrive) -> None:
    """A robot that is asked for its counts answers when it can: taken as they are, turns would look smaller."""
    age = np.random.default_rng(1).integers(0, 2, len(worn.encoders_s))  # 20 ms, or none
    stale = worn.encoders_rad[np.maximum(np.arange(len(age)) - age, 0)]
    found = offsets.find(replace(worn, encoders_rad=stale), GTERNAL)
    assert found.by_encoders
    radius, base = true_wheels(1)
    assert found.wheel_radius_m == pytest.approx(radius, rel=0.002)
    assert found.wheel_base_m == pytest.approx(base, rel=0.01)


def test_encoders_of_another_clock_are_put_right(worn: RobotDrive) -> None:
    """What the way to the driver takes is missing from its clock: some milliseconds."""
    found = offsets.find(replace(worn, encoders_s=worn.encoders_s - 0.012), GTERNAL)
    assert np.abs(found.values[:2] - TRUE_TAG[:2]).max() < 0.00005


def part(drive: RobotDrive, start_s: float, end_s: float) -> RobotDrive:
    fields = {}
    for instants, values in (
        ("commands_s", "commands_rad_s"),
        ("poses_s", "poses"),
        ("told_s", "told_rad"),
        ("encoders_s", "encoders_rad"),
    ):
        at_s = getattr(drive, instants)
        inside = (at_s >= start_s) & (at_s <= end_s)
        fields |= {instants: at_s[inside], values: getattr(drive, values)[inside]}
    return replace(drive, **fields)


def refusal(drive: RobotDrive) -> str:
    with pytest.raises(CalibrationError) as refused:
        offsets.find(drive, GTERNAL)
    (line,) = refused.value.faults
    assert line.startswith("r1: ")
    return line


def test_what_a_drive_does_not_determine_is_refused(worn: RobotDrive) -> None:
    turn = 1.1 * math.tau / (0.4 * 12.5 * 2 * GTERNAL.wheel_radius / GTERNAL.wheel_base)
    spins, straights = part(worn, 0.0, 1.5 + 2 * turn), part(worn, 2.0 + 3 * turn, 2.0 + 3 * turn + 8.0)
    assert "straight" in refusal(spins)
    assert "spin both ways" in refusal(straights)
    assert "spin both ways" in refusal(part(worn, 0.0, 0.5 + turn))  # one way only
    poor = worn.poses + np.random.default_rng(1).normal(size=worn.poses.shape) * (0.02, 0.02, 0.3)
    assert "are allowed" in refusal(replace(worn, poses=poor))


def test_a_robot_that_was_lost_or_never_moved_is_refused(worn: RobotDrive) -> None:
    hidden = (worn.poses_s > 10.0) & (worn.poses_s < 12.0)
    assert "once not for 2.0 s" in refusal(replace(worn, poses_s=worn.poses_s[~hidden], poses=worn.poses[~hidden]))
    assert "50 % of the images" in refusal(replace(worn, poses_s=worn.poses_s[::2], poses=worn.poses[::2]))
    assert "seen in 0 %" in refusal(replace(worn, poses_s=worn.poses_s[:0], poses=worn.poses[:0]))
    still = np.tile(worn.poses[0], (len(worn.poses), 1))
    assert "did not" in refusal(replace(worn, poses=still))

"""Offsets from drives whose truth is known: found, with the sigma that they deserve, or refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.calibration.robots import inputs, offsets
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.information import SYSTEMATIC_VARIANCE
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import TagOffset
from tests.robots import GTERNAL

from .conftest import LATE, OFFSET, Make, believed, shots
from .conftest import found as identified

pytestmark = pytest.mark.long

TRUE_TAG = np.array([OFFSET.forward_m, OFFSET.left_m, OFFSET.heading_deg])


def true_wheels(seed: int) -> tuple[float, float]:
    """Return radius and base of the simulated robot of a seed, as its plant draws them."""
    left, right, base = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return (
        GTERNAL.wheel_radius * (1 + LATE.wheel_gain_spread * (left + right) / 2),
        GTERNAL.wheel_base * (1 + LATE.wheel_base_spread * base),
    )


def find(drive: RobotDrive) -> offsets.Offsets:
    inputs.refuse_unusable(drive)
    offsets.refuse_unusable(shots(drive), believed().values)
    return offsets.of(identified(drive))


def test_the_tag_is_placed_and_the_wheels_are_measured(worn: RobotDrive) -> None:
    found = find(worn)
    error = np.abs(found.values[:3] - TRUE_TAG)
    assert error[:2].max() < 0.00004
    assert error[2] < 0.03
    radius, base = true_wheels(1)
    assert found.values[3] == pytest.approx(radius, rel=0.001)
    assert found.values[4] == pytest.approx(base, rel=0.005)


@pytest.mark.parametrize("heading_deg", [90.0, 179.0, -135.0])
def test_a_tag_may_be_glued_on_any_way_round(driven: Make, heading_deg: float) -> None:
    turned = TagOffset(forward_m=-0.02, left_m=0.03, heading_deg=heading_deg)
    found = find(driven(offset=turned))
    assert (1e3 * found.tag_offset.forward_m, 1e3 * found.tag_offset.left_m) == pytest.approx((-20, 30), abs=0.06)
    assert found.tag_offset.heading_deg == pytest.approx(heading_deg, abs=0.03)


def test_sigma_is_what_drives_scatter_by(smooth: RobotDrive) -> None:
    rng, found = np.random.default_rng(7), []
    for _ in range(8):
        noise = rng.normal(size=smooth.poses.shape) * (3e-4, 3e-4, 0.004)
        found.append(find(replace(smooth, poses=smooth.poses + noise)))
    errors = np.array([result.values for result in found]) - [*TRUE_TAG, GTERNAL.wheel_radius, GTERNAL.wheel_base]
    tracker = offsets.of(
        replace(found[0].found, covariance=np.diag(SYSTEMATIC_VARIANCE))
    )  # these poses have none of it
    random = np.sqrt(np.array([result.sigma**2 for result in found]) - tracker.sigma**2)
    scatter = np.sqrt((errors**2).mean(axis=0)) / random.mean(axis=0)
    assert (scatter > 0.4).all()
    assert (scatter < 2.0).all()


def test_outliers_change_little_and_are_counted(worn: RobotDrive) -> None:
    rng, poses = np.random.default_rng(3), worn.poses.copy()
    wrong = rng.choice(len(poses), 40, replace=False)
    poses[wrong] += rng.normal(size=(40, 3)) * (0.02, 0.02, 0.5)
    found = find(replace(worn, poses=poses))
    assert 30 <= found.found.left_out <= 90
    assert np.abs(found.values[:2] - TRUE_TAG[:2]).max() < 0.00006
    assert abs(found.values[2] - TRUE_TAG[2]) < 0.04


def test_missing_images_do_no_harm(driven: Make) -> None:
    found = find(driven(lost=0.2))
    assert np.abs(found.values[:2] - TRUE_TAG[:2]).max() < 0.00005
    assert abs(found.values[2] - TRUE_TAG[2]) < 0.03


def test_a_robot_is_measured_by_what_reached_it_and_when(driven: Make) -> None:
    """On a busy machine commands come late: a way that was asked for is not one that was told."""
    found = find(driven(late=15_000_000))
    radius, base = true_wheels(1)
    assert found.values[3] == pytest.approx(radius, rel=0.002)
    assert found.values[4] == pytest.approx(base, rel=0.005)


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
        find(drive)
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

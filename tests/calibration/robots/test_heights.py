"""What a drive says of a tag's height: by its size, by two cameras, by both."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from robofleet.calibration.robots import drive_file, heights
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.config.load import load_config

CONFIG = load_config(Path(__file__).parents[3] / "configs" / "platoon.yaml")  # sides of 70 mm, 80 mm high, 2.5 m below
EXACT = CONFIG.model_copy(update={"tracker": CONFIG.tracker.model_copy(update={"tag_side_tolerance_m": 1e-6})})
NOTHING = np.empty((0, 2))
DRIVE = RobotDrive("r1", *(NOTHING,) * 8, 0.0, 1.0)
BY_SIZE, BY_PARALLAX = np.array([[0.002, 0.0002]]), np.array([[-0.001, 0.0003]])


def test_one_camera_cannot_tell_a_height_from_a_side_that_is_not_exact() -> None:
    drive = replace(DRIVE, higher_by_size=BY_SIZE)
    found = heights.find(CONFIG, drive)
    assert "appears 0.08% larger: it lies 2.0 mm higher than configured, or its side is 70.06 mm" in found.sentence
    assert found.measured_m is None
    assert heights.find(EXACT, drive).measured_m == pytest.approx(0.082)


def test_two_cameras_tell_the_height_and_so_the_side() -> None:
    found = heights.find(CONFIG, replace(DRIVE, higher_by_size=BY_SIZE, higher_by_parallax=BY_PARALLAX))
    assert "lies 1.0 mm lower than configured by two cameras" in found.sentence
    assert "its side is 70.09 mm" in found.sentence
    assert found.measured_m == pytest.approx(0.079, abs=2e-4)


def test_a_drive_without_a_height_says_so() -> None:
    found = heights.find(CONFIG, DRIVE)
    assert found.measured_m is None
    assert "was not measured" in found.sentence


def test_a_drive_keeps_its_heights_and_one_of_an_earlier_version_has_none(worn: RobotDrive, tmp_path: Path) -> None:
    file = tmp_path / "drive.npz"
    drive_file.save(file, [replace(worn, higher_by_size=BY_SIZE)])
    (read,) = drive_file.load(file)
    assert (read.higher_by_size == BY_SIZE).all()
    assert not len(read.higher_by_parallax)
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files if "higher" not in name}
    np.savez_compressed(file, **arrays)
    assert not len(drive_file.load(file)[0].higher_by_size)

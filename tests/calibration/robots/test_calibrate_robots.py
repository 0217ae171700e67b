"""``robofleet calibrate offsets`` and ``latency``: files written whole, kept, and used; bad input refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration.robots import drive_file
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import load
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config

from .conftest import OFFSET

pytestmark = pytest.mark.usefixtures("unplotted")

ROOT = Path(__file__).parents[3]

Calibrate = Callable[..., Result]


@pytest.fixture
def calibrate(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Calibrate:
    """Return what runs the tool in this process."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(cli.app, ["calibrate", *map(str, arguments)])


def refused(done: Result) -> str:
    assert done.exit_code == 2
    return done.stderr


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Return a configuration in a folder of its own."""
    file = tmp_path / "lab.yaml"
    file.write_text((ROOT / "configs" / "platoon.yaml").read_text().replace("source: camera", "source: truth"))
    return file


@pytest.fixture
def recorded(worn: RobotDrive, tmp_path: Path) -> Path:
    file = tmp_path / "drive.npz"
    drive_file.save(file, [worn])
    return file


@pytest.mark.slow
def test_both_parts_stand_in_one_file_the_one_before_is_kept_and_they_are_what_was_measured(
    calibrate: Calibrate, lab: Path, recorded: Path
) -> None:
    file = lab.parent / "robots" / "r1.yaml"
    assert calibrate("offsets", lab, "--recording", recorded, "--out", lab.parent / "a").exit_code == 0
    first = load(file, RobotCalibration)
    assert (first.delay_s, first.latency) == (None, None)
    assert calibrate("latency", lab, "--recording", recorded, "--out", lab.parent / "b").exit_code == 0
    both = load(file, RobotCalibration)
    assert both.model_copy(update={"delay_s": None, "motor_lag_s": None, "latency": None}) == first
    assert "calibration: r1" in calibrate("offsets", lab, "--recording", recorded, "--out", lab.parent / "c").stdout
    again = load(file, RobotCalibration)
    assert (again.delay_s, again.motor_lag_s, again.latency) == (both.delay_s, both.motor_lag_s, both.latency)
    assert len(list((file.parent / "earlier").glob("r1-*.yaml"))) == 2
    for page in "abc":
        assert (lab.parent / page / "report.html").read_text().count("<svg") == 2

    config = load_config(lab, ["robots.0.calibration=r1"])
    found = config.robots[0].calibration
    assert found is not None
    assert found.tag_offset.forward_m == pytest.approx(OFFSET.forward_m, abs=0.00004)
    assert slices.delay_ns(config, config.robots[0]) == pytest.approx(43e6, abs=1e6)
    assert slices.drive(config.robots[0]).motor_lag == pytest.approx(0.06, abs=0.001)
    for part, count in ((found.offsets, 5), (found.latency, 2)):
        assert part is not None
        assert set(part.inputs) == {"drive.npz"}
        assert len(part.parameters) == count
        covariance = np.array(part.covariance)
        assert covariance.shape == (count, count)
        assert np.allclose(covariance, covariance.T, rtol=1e-4, atol=1e-12)
    assert found.offsets is not None
    assert found.offsets.figures["sigma_forward_mm"] == pytest.approx(1e3 * found.offsets.covariance[0][0] ** 0.5, 1e-3)


@pytest.mark.slow
def test_a_drive_in_lockstep_is_kept_and_calibrates(calibrate: Calibrate, lab: Path) -> None:
    out = lab.parent / "out"
    drive = calibrate("offsets", lab, "--lockstep", "--robots", "r2", "--out", out)
    assert drive.exit_code == 0
    assert "r2 drives" in drive.stderr
    assert sorted(file.name for file in out.iterdir()) == ["drive.npz", "report.html"]
    assert [file.name for file in (lab.parent / "robots").iterdir()] == ["r2.yaml"]
    assert calibrate("latency", lab, "--recording", out / "drive.npz").exit_code == 0
    assert load(lab.parent / "robots" / "r2.yaml", RobotCalibration).delay_s == pytest.approx(0.001, abs=0.001)
    assert "not empty" in refused(calibrate("offsets", lab, "--lockstep", "--out", out))


@pytest.mark.parametrize("command", ["offsets", "latency"])
def test_a_drives_configuration_is_changed_by_set(
    calibrate: Calibrate, lab: Path, recorded: Path, command: str
) -> None:
    assert "groups.0.robots" in refused(calibrate(command, lab, "--recording", recorded, "--set", "robots.0.id=x1"))
    assert "robots.1.start" in refused(calibrate(command, lab, "--lockstep", "--set", "robots.1.start.x_m=9"))
    assert not (lab.parent / "robots").exists()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["offsets", "latency"])
def test_what_cannot_be_used_ends_with_2_one_line_and_nothing_written(
    calibrate: Calibrate, lab: Path, recorded: Path, worn: RobotDrive, command: str
) -> None:
    def refusal(*arguments: object) -> str:
        (line,) = refused(calibrate(command, lab, *arguments)).splitlines()
        assert not (lab.parent / "robots").exists()
        assert not (lab.parent / "runs").exists()
        return str(line)

    other = lab.parent / "other.npz"
    other.write_bytes(b"not a recording")
    assert "is not a recording" in refusal("--recording", other)
    assert "No such file" in refusal("--recording", lab.parent / "nothing.npz")
    assert "no robot 'r7'" in refusal("--robots", "r7", "--lockstep")
    assert "Not a directory" in refusal("--lockstep", "--out", lab / "out")
    assert "'r2' did not drive" in refusal("--recording", recorded, "--robots", "r2")
    stranger = RobotDrive(**{**vars(worn), "robot": "r9"})
    drive_file.save(other, [worn, stranger])
    assert "has no such robot" in refusal("--recording", other)
    still = RobotDrive(**{**vars(worn), "poses": np.tile(worn.poses[:1], (len(worn.poses), 1)), "robot": "r2"})
    drive_file.save(other, [worn, still])
    assert refusal("--recording", other).startswith("r2: it was told to move and did not")


@pytest.mark.slow
def test_another_file_of_that_name_is_not_written_over(calibrate: Calibrate, lab: Path, recorded: Path) -> None:
    file = lab.parent / "robots" / "r1.yaml"
    file.parent.mkdir()
    vehicle = (ROOT / "configs" / "robots" / "gternal.yaml").read_bytes()
    file.write_bytes(vehicle)
    assert str(file) in refused(calibrate("latency", lab, "--recording", recorded))
    assert file.read_bytes() == vehicle

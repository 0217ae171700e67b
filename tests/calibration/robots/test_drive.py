"""A drive through the fleet's own processes in lockstep: kept, read again, and worth a calibration."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA, POSES, STATUS, TRUTH, key
from robofleet.bus.messages import FLEET_POSES
from robofleet.calibration.robots import drive, drive_file, latency, offsets
from robofleet.calibration.store import CalibrationError
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration, TagOffset
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.recording.run import Recording, Run
from robofleet.reports.metrics import summary
from robofleet.runs.lockstep import Lockstep
from robofleet.tracking.offset import tag_from_centre
from tests.shipped import PLATOON

from .conftest import found as found_in

pytestmark = pytest.mark.slow

LATE_S, LAG_S = 0.031, 0.06
EXCITED = "groups.0.robots=[r3]", "groups.0.behaviour=excitation", "groups.0.settings={}"


@pytest.fixture(scope="module")
def late_platoon(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the shipped platoon, seen without pixels, with robots that are later than believed."""
    file = tmp_path_factory.mktemp("late") / "late.yaml"
    poses = "truth: {position_noise_m: 0.00003, heading_noise_rad: 0.0009, dropout: 0.02}"
    text = PLATOON.read_text().replace("source: camera", "source: truth")
    before, _, after = text.partition("  truth: {")
    file.write_text(f"{before}  {poses}\n{after.partition(chr(10))[2]}")
    robot = (PLATOON.parent / "robots" / "gternal.yaml").read_text()
    late = robot.replace("  motor_lag_s: 0.08", f"  motor_lag_s: {LAG_S}\n  actuation_delay_s: {LATE_S}")
    (file.parent / "robots").mkdir()
    (file.parent / "robots" / "gternal.yaml").write_text(late)
    return file


@pytest.fixture(scope="module")
def recording(late_platoon: Path) -> Recording:
    config, count = drive.configure(late_platoon, ["r3"], lockstep=True)
    assert count == 1
    return drive.run(config, late_platoon.parent, lambda _: None, lockstep=True)


@pytest.fixture(scope="module")
def kept(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("kept") / drive_file.FILE
    drive_file.save(file, drive.extract(recording, [0]))
    return file


def test_only_those_that_were_asked_drive_and_nobody_is_touched(recording: Recording) -> None:
    config = recording.config
    assert config.groups[0].robots == ("r3", "r1", "r2", "r4")
    began_ns = int(Run(recording).ticks["stamp_ns"][0])  # the checks before move every robot
    for robot in config.robots:
        statuses = recording.of_robot(STATUS, robot.id)
        speeds = statuses["left_rad_s"][statuses["stamp_ns"] > began_ns]
        assert (np.abs(speeds).max() > 4.0) == (robot.id == "r3")
    figures = summary(recording, name="drive", mode="lockstep", outcome="completed", cause=None)
    assert figures["min_gap_mm"] > 10.0
    assert not any(figures["rejected"].values())
    assert figures["stops"] == []


def test_what_is_kept_is_what_was_driven(recording: Recording, kept: Path) -> None:
    (driven,), (read,) = drive.extract(recording, [0]), drive_file.load(kept)
    for name, value in vars(driven).items():
        assert np.array_equal(getattr(read, name), value), name
    assert len(read.poses_s) > 0.85 * len(read.commands_s) > 1000
    assert len(read.encoders_s) > 1.5 * len(read.commands_s)


def test_poses_are_measured_ones_at_their_own_instants_and_of_the_tag(recording: Recording) -> None:
    """A rolling shutter's instants count; what is coasted does not; an offset that was in force is taken back."""
    config = recording.config
    offset = TagOffset(forward_m=0.01, left_m=0.02, heading_deg=30.0)
    calibrated = [
        robot.model_copy(update={"calibration": RobotCalibration(robot=robot.id, tag_offset=offset)})
        for robot in config.robots
    ]
    other = Recording(config.model_copy(update={"robots": tuple(calibrated)}), recording.messages.copy())
    full = key(config.arena.name, POSES, CAMERA)
    changed = []
    for k, payload in enumerate(recording.messages[full]):
        frame = FLEET_POSES.decode(payload)
        assert frame is not None
        poses = tuple(pose._replace(after_ns=5_000_000, coasted_ns=int(k % 4 == 0)) for pose in frame.poses)
        since_ns = frame.since_tick_ns - 5_000_000
        changed.append(FLEET_POSES.encode(frame._replace(since_tick_ns=since_ns, poses=poses)))
    other.messages[full] = changed
    (whole,), (part,) = drive.extract(recording, [0]), drive.extract(other, [0])
    assert len(part.poses_s) == pytest.approx(0.75 * len(whole.poses_s), rel=0.02)
    at = np.searchsorted(whole.poses_s, part.poses_s - 1e-7)
    assert part.poses_s == pytest.approx(whole.poses_s[at], abs=1e-9)
    for seen, centre in zip(part.poses.tolist(), whole.poses[at].tolist(), strict=True):
        x, y, psi = centre
        assert seen == pytest.approx(tag_from_centre(x, y, psi, offset))


def test_delay_and_lag_are_those_of_the_simulated_robot(late_platoon: Path, kept: Path) -> None:
    found = latency.of(found_in(drive_file.load(kept)[0]))
    bus_s = load_config(late_platoon).lockstep.bus_delay_s
    assert found.delay_s == pytest.approx(bus_s + LATE_S, abs=0.001)
    assert found.motor_lag_s == pytest.approx(LAG_S, abs=0.001)


def test_offsets_are_those_of_the_simulated_robot(late_platoon: Path, kept: Path) -> None:
    config = load_config(late_platoon)
    robot = config.robot("r3")
    found = offsets.of(found_in(drive_file.load(kept)[0]))
    assert np.abs(found.values[:2]).max() < 0.00004  # its tag is in the middle
    assert abs(found.values[2]) < 0.03
    left, right, base = slices.generator(config.run.seed, "plant", "r3").uniform(-1.0, 1.0, 3)
    spread = robot.vehicle.simulated
    radius_m = robot.vehicle.wheel_radius_m * (1 + spread.wheel_gain_spread * (left + right) / 2)
    assert found.values[3] == pytest.approx(radius_m, rel=0.001)
    base_m = robot.vehicle.wheel_base_m * (1 + spread.wheel_base_spread * base)
    assert found.values[4] == pytest.approx(base_m, rel=0.005)


def _unlimited(config: Config) -> Config:
    """Return it with gates that let jumps of the commands pass: what they do to jumps is not the robot's delay."""
    quick = {"max_wheel_acceleration_rad_s2": 1e4}
    robots = [r.model_copy(update={"vehicle": r.vehicle.model_copy(update=quick)}) for r in config.robots]
    return config.model_copy(update={"robots": tuple(robots)})


@pytest.mark.long
def test_with_its_calibration_the_filter_knows_where_the_robot_is(late_platoon: Path, kept: Path) -> None:
    """The delay that was found is the one that the filter predicts with."""

    def pose_error_mm(*overrides: str) -> float:
        config: Config = _unlimited(
            load_config(late_platoon, [*EXCITED, "run.seed=5", "run.duration_s=40", *overrides])
        )
        run = Lockstep(config)
        outcome, cause = run.run()
        figures = summary(run.recording, name="late", mode="lockstep", outcome=outcome, cause=cause)
        assert outcome == "completed"
        rms: float = figures["pose_error"]["rms_mm"]
        return rms

    found = latency.of(found_in(drive_file.load(kept)[0]))
    measured = f"{{robot: r3, delay_s: {found.delay_s:.6f}, motor_lag_s: {found.motor_lag_s:.6f}}}"
    believed, calibrated = pose_error_mm(), pose_error_mm(f"robots.2.calibration={measured}")
    assert calibrated < 0.1
    assert calibrated < believed / 3


def test_what_is_believed_of_a_simulated_robot_does_not_change_it(late_platoon: Path) -> None:
    def end(*overrides: str) -> bytes:
        run = Lockstep(load_config(late_platoon, [*EXCITED, "run.duration_s=3", *overrides]))
        assert run.run() == ("completed", None)
        return run.recording.of_robot(TRUTH, "r3")[-1].tobytes()

    assert end("robots.2.calibration={robot: r3, wheel_radius_m: 0.0172, wheel_base_m: 0.1}") == end()


def test_a_drive_that_breaks_off_says_why(late_platoon: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config, _ = drive.configure(late_platoon, ["r3"], lockstep=True)
    monkeypatch.setattr(Lockstep, "run", lambda _self, _watch: ("fault", "the driver went silent: r4"))
    with pytest.raises(CalibrationError, match="did not come to its end: the driver went silent: r4"):
        drive.run(config, late_platoon.parent, lambda _: None, lockstep=True)


Spoil = Callable[[dict[str, Any]], object]
SPOILT: list[tuple[Spoil, str]] = [
    (lambda a: a.update(version=np.array(1)), "version 1, this reads 3"),
    (lambda a: a.pop("version"), "is not a recording"),
    (lambda a: a.pop("robots"), "is not a recording"),
    (lambda a: a.pop("r3/poses"), "r3/poses is missing"),
    (lambda a: a.update({"r3/poses": a["r3/poses"][:, :2]}), "r3/poses has shape"),
    (lambda a: a.update({"r3/poses_s": a["r3/poses_s"][::-1]}), "r3/poses_s has shape"),
    (lambda a: a.update({"r3/commands_rad_s": a["r3/commands_rad_s"][:-1]}), "r3/commands_rad_s has shape"),
    (lambda a: a.update({"r3/poses": np.full_like(a["r3/poses"], np.nan)}), "r3/poses is missing or not a finite"),
    (lambda a: a.update({"r3/encoders_rad": a["r3/encoders_rad"].astype(str)}), "r3/encoders_rad is missing or not"),
    (lambda a: a.update(robots=np.array(["r3", "r4"])), "r4/commands_s is missing"),
]


@pytest.mark.parametrize(("spoil", "says"), SPOILT)
def test_a_spoilt_recording_is_refused(kept: Path, tmp_path: Path, spoil: Spoil, says: str) -> None:
    with np.load(kept) as archive:
        arrays = dict(archive)
    spoil(arrays)
    file = tmp_path / "spoilt.npz"
    np.savez(file, **arrays)
    with pytest.raises(CalibrationError) as refused:
        drive_file.load(file)
    (line,) = refused.value.faults
    assert line.startswith(f"{file}: ")
    assert says in line


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"robots: [r1]\n", b"\x93NUMPY\x01\x00", None])
def test_what_is_no_recording_is_refused(kept: Path, tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "other.npz"
    file.write_bytes(kept.read_bytes()[:5000] if content is None else content)
    with pytest.raises(CalibrationError, match=r"other\.npz: "):
        drive_file.load(file)


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    file = tmp_path / "evil.npz"
    np.savez(file, version=np.array(drive_file.VERSION), robots=np.array([{"a": 1}], dtype=object))
    with pytest.raises(CalibrationError, match="is not a recording"):
        drive_file.load(file)

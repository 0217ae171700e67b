"""Robots' models from recordings whose truth is known: found, with the sigma that they deserve, or refused."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from robofleet import cli
from robofleet.behaviours import described
from robofleet.bus.keys import TICK, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.calibration.robots import inputs
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.shooting import Noise, Wheels
from robofleet.calibration.store import CalibrationError, load, save
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config
from robofleet.config.plant_errors import PlantErrors
from robofleet.core.arrays import Array
from robofleet.recording.log import RunLog
from robofleet.recording.reading import read
from robofleet.vehicles.plant import built
from tests.robots import GTERNAL
from tests.shipped import PLATOON

from .conftest import LATE, OFFSET, Make, shots
from .conftest import found as found_in

RECORDED = Path(__file__).parents[2] / "recordings"

NOISE = Noise(position=0.1, heading=math.radians(0.05) / 0.004)  # of conftest's poses, against an unknown covariance


def true(seed: int) -> Wheels:
    """Return the model of the simulated robot of a seed."""
    build = built(GTERNAL, LATE, np.random.default_rng(seed))
    return Wheels(
        left_radius_m=build.wheel_radius * build.left_gain,
        right_radius_m=build.wheel_radius * build.right_gain,
        wheel_base_m=build.wheel_base,
        motor_lag_s=build.motor_lag,
        stop_lag_s=build.stop_lag,
        delay_s=build.delay_ns * 1e-9,
        deadband_rad_s=build.deadband,
        breakaway_rad_s=build.breakaway,
        top_speed_rad_s=build.max_wheel_speed,
        top_speed_sag=build.top_speed_sag,
        slip_s_per_rad=build.slip,
        tag_forward_m=OFFSET.forward_m,
        tag_left_m=OFFSET.left_m,
        tag_heading_rad=math.radians(OFFSET.heading_deg),
        left_encoder=1.0,
        right_encoder=1.0,
        encoder_offset_s=0.0,
    )


def mean_square(drive: RobotDrive, model: Wheels) -> float:
    own = shots(drive)
    e, _ = own.residuals(model, NOISE, own.motion(model), np.ones(len(own.at_s), dtype=np.bool_))
    return float((e[e.any(axis=1)] ** 2).mean())


def test_the_true_model_leaves_noise_and_a_wrong_one_more(worn: RobotDrive) -> None:
    right = true(1)
    assert mean_square(worn, right) == pytest.approx(1.0, abs=0.25)
    assert mean_square(worn, replace(right, wheel_base_m=1.01 * right.wheel_base_m)) > 1.5
    assert mean_square(worn, replace(right, motor_lag_s=right.motor_lag_s + 0.005)) > 1.5
    assert mean_square(worn, replace(right, delay_s=right.delay_s + 0.003)) > 1.5


def turned(at_s: Array, speeds: Array, when_s: Array) -> Array:
    """Return the angles (M, 2) of wheels whose speeds (K, 2) begin at instants (K,)."""
    begun = np.vstack([np.zeros(2), np.cumsum(speeds[:-1] * np.diff(at_s)[:, None], axis=0)])
    k = np.searchsorted(at_s, when_s, side="right") - 1
    return np.where(k[:, None] >= 0, begun[k] + speeds[k] * (when_s - at_s[k])[:, None], 0.0)


def test_inputs_turn_as_far_as_the_gate_told(worn: RobotDrive) -> None:
    """Between two statuses the gate was closed, which no command says."""
    angles_rad = worn.told_rad.copy()
    closed = slice(600, 700)
    angles_rad[601:] -= (worn.told_rad[closed.stop] - worn.told_rad[closed.start]) * np.clip(
        (worn.told_s[601:] - worn.told_s[600]) / (worn.told_s[700] - worn.told_s[600]), 0.0, 1.0
    )[:, None]
    stopped = replace(worn, told_rad=angles_rad)
    at_s, outputs = inputs.as_told(stopped, *inputs.through_gate(stopped))
    travel = turned(at_s, outputs, stopped.told_s)
    assert np.abs((travel - travel[0]) - (angles_rad - angles_rad[0])).max() < 1e-3


def test_inputs_of_late_commands_are_late(worn: RobotDrive) -> None:
    """What is told late acts late: it is not a slow speed before, which a wheel's dead band would swallow."""
    commands = np.repeat(((0.0, 0.0), (4.0, -6.0), (0.0, 0.0)), 20, axis=0)
    commands_s, told_s = 0.033 * np.arange(60), 0.02 * np.arange(90)
    late_s = commands_s + 0.011 * (np.arange(60) == 40)  # the stop is
    angles_rad = turned(late_s, commands, told_s)
    drive = replace(worn, commands_s=commands_s, commands_rad_s=commands, told_s=told_s, told_rad=angles_rad)
    at_s, outputs = inputs.as_told(drive, *inputs.through_gate(drive))
    grid_s = np.arange(0.0, 1.7, 0.0005)
    speeds = outputs[np.searchsorted(at_s, grid_s, side="right") - 1]
    expected = commands[np.searchsorted(late_s, grid_s, side="right") - 1]
    assert (np.abs(speeds - expected).max(axis=1) > 1e-9).mean() < 0.002


@pytest.mark.slow
def test_an_excitation_tells_the_model(driven: Make) -> None:
    drive = driven()
    found, right = found_in(drive), true(1)
    for name in ("left_radius_m", "right_radius_m", "wheel_base_m"):
        assert getattr(found.wheels, name) == pytest.approx(getattr(right, name), rel=0.002)
    assert found.wheels.motor_lag_s == pytest.approx(right.motor_lag_s, abs=0.001)
    assert found.wheels.delay_s == pytest.approx(right.delay_s, abs=0.001)
    assert found.wheels.deadband_rad_s == pytest.approx(right.deadband_rad_s, rel=0.05)
    assert found.wheels.tag_heading_rad == pytest.approx(right.tag_heading_rad, abs=0.001)
    assert "top_speed_sag" in found.undetermined
    for name in found.determined:
        assert abs(getattr(found.wheels, name) - getattr(right, name)) < 4.0 * found.sigma[name], name
    assert found.held_out_chi_square == pytest.approx(1.0, abs=0.4)
    assert abs(found.correlation) < 0.15


@pytest.mark.slow
def test_a_robot_without_dead_band_has_none_and_bends_nothing_else(smooth: RobotDrive) -> None:
    found = found_in(smooth)
    assert found.wheels.deadband_rad_s < 0.1
    assert found.wheels.wheel_base_m == pytest.approx(GTERNAL.wheel_base, rel=0.002)
    assert abs(found.wheels.slip_s_per_rad) < 3.0 * found.sigma["slip_s_per_rad"]


@pytest.mark.slow
def test_outliers_are_left_out(worn: RobotDrive) -> None:
    rng, poses = np.random.default_rng(3), worn.poses.copy()
    wrong = rng.choice(len(poses), 25, replace=False)
    poses[wrong] += rng.normal(size=(25, 3)) * (0.02, 0.02, 0.5)
    found = found_in(replace(worn, poses=poses))
    assert 20 <= found.left_out <= 40
    assert found.wheels.left_radius_m == pytest.approx(true(1).left_radius_m, rel=0.002)


def test_a_recording_that_says_too_little_is_refused(worn: RobotDrive) -> None:
    short = replace(worn, poses_s=worn.poses_s[:50], poses=worn.poses[:50])
    with pytest.raises(CalibrationError, match=r"r1: it was seen in 50 images .* 100 are needed: record longer"):
        found_in(short)
    still = replace(worn, poses=np.tile(worn.poses[0], (len(worn.poses), 1)))
    with pytest.raises(CalibrationError, match=r"r1: it drove 0.00 m and turned 0.0 rad, .* with curves"):
        found_in(still)


def test_a_simulated_robot_is_as_the_identified_one() -> None:
    config = load_config(PLATOON)
    robot = config.robots[0]
    assert robot.vehicle.simulated is not None
    errors = robot.vehicle.simulated.model_copy(
        update={
            "wheel_gain_spread": 0.0, "wheel_base_spread": 0.0, "wheel_gain_error": 0.01, "wheel_base_error": -0.02,
            "wheel_gain_difference": 0.004, "top_speed_error": -0.1,
        }
    )  # fmt: skip
    like = robot.model_copy(update={"calibration": RobotCalibration(robot="r1", simulated=errors)})
    simulation = slices.simulation(config, like, None)
    build = built(simulation.drive, simulation.imperfections, simulation.rng)
    assert (build.left_gain, build.right_gain) == pytest.approx((1.008, 1.012))
    assert build.wheel_base == pytest.approx(0.98 * 0.105)
    assert build.max_wheel_speed == pytest.approx(0.9 * 12.5)


def stilled(file: Path, robots: Sequence[str]) -> Path:
    """Write the recording of an excitation in which some robots were never commanded to move, and return its file."""
    recording = read(RECORDED / "excitation.mcap")
    config, full = recording.config, key(recording.config.arena.name, TICK)
    dtype = TICK_RECORD.dtype(len(config.members), described.size(recording.groups, len(config.camera_names)))
    ticks = np.frombuffer(b"".join(recording.messages[full]), dtype=dtype).copy()
    rows = [k for k, robot in enumerate(config.members) if robot.id in robots]
    for side in ("left_rad_s", "right_rad_s"):
        ticks["items"][side][:, rows] = 0.0
    recording.messages[full] = [tick.tobytes() for tick in ticks]
    with RunLog(file, config, drawn=False) as log:
        for name, payloads in recording.messages.items():
            log.add_all(((name, payload) for payload in payloads), 0)
    return file


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., Result]:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(cli.app, [*map(str, arguments)])


def test_bad_input_is_a_line_exit_2_and_nothing_is_written(run: Callable[..., Result], tmp_path: Path) -> None:
    def refusal(*arguments: object) -> str:
        done = run(*arguments, "--configs", tmp_path)
        assert done.exit_code == 2
        assert list(tmp_path.iterdir()) == []
        return " ".join(done.stderr.split())

    assert "'r9' was not driven in" in refusal("identify", RECORDED / "platoon.mcap", "--robots", "r9")
    assert "there is no such recording" in refusal("identify", tmp_path / "nothing")
    assert "with curves" in refusal("identify", RECORDED / "platoon.mcap", "--robots", "r2")
    still = stilled(tmp_path.with_name("still.mcap"), ["r2"])
    assert f"{still}: r2: it was never commanded to move" in refusal("identify", still, "--robots", "r2")
    assert "there is no such recording" in refusal("gap", tmp_path / "nothing")


@pytest.mark.slow
def test_a_recording_becomes_files_and_a_simulation_that_agrees(run: Callable[..., Result], tmp_path: Path) -> None:
    """The plant's own recording: the identified robots are those that it had; the file before is kept."""
    settings = (
        "run.duration_s=45",
        "tracker.source=truth",
        "tracker.truth.position_noise_m=0.00003",
    )
    flags = [flag for setting in (*settings, "run.bounds.gap=1.3") for flag in ("--set", setting)]
    assert run("run", PLATOON, "--lockstep", "--out", "made", *flags).exit_code == 0
    before = RobotCalibration(robot="r1", tag_height_m=0.08)
    save(tmp_path / "robots" / "r1.yaml", before)
    still = stilled(tmp_path / "still.mcap", ["r2"])
    done = run("identify", "made", still, "--configs", tmp_path, "--report", "page.html")
    assert done.exit_code == 0, done.output
    assert f"{still}: left out: r2: it was never commanded to move" in " ".join(done.stderr.split())
    assert done.stderr.count("left out") == 1
    assert (tmp_path / "page.html").read_text().count("<svg") == 8
    assert len(list((tmp_path / "robots" / "earlier").glob("r1-*.yaml"))) == 1
    found = load(tmp_path / "robots" / "r1.yaml", RobotCalibration)
    assert found.tag_height_m == 0.08
    assert isinstance(found.simulated, PlantErrors)
    config = load_config(PLATOON)
    simulation = slices.simulation(config, config.robots[0], None)
    build = built(simulation.drive, simulation.imperfections, simulation.rng)
    assert found.wheel_radius_m == pytest.approx(
        build.wheel_radius * (build.left_gain + build.right_gain) / 2, rel=1e-3
    )
    done = run("gap", "made", "--configs", tmp_path)
    assert done.exit_code == 0, done.output
    assert "Predicted and observed" in (tmp_path / "made" / "report.html").read_text()
    (tmp_path / "made").rename(tmp_path / "again")  # what was compared with these files is not simulated again
    done = run("gap", "again", "again", "--configs", tmp_path, "--report", "days.html")
    assert done.exit_code == 0, done.output
    assert "no robot's predictions grew worse" in done.stdout
    assert (tmp_path / "days.html").read_text().count("<svg") == 1

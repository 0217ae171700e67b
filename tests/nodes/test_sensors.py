"""What robots sense, from a run's bus to its file."""

import math
from pathlib import Path

import numpy as np
import pytest

from robofleet.bus.keys import SENSORS, STATUS, TRUTH, key
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.recording import sensors
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from tests.process_fixtures import PLATOON

DRIVEN_S = 2.0
ALL = tuple(f"robots.{row}.sensors=true" for row in range(4))
EXACT = tuple(f"robots.{row}.vehicle=ideal" for row in range(4))


def config_of(*changes: str) -> Config:
    return load_config(PLATOON, ["tracker.source=truth", *changes])


def driven(*changes: str, log: RunLog | None = None) -> Recording:
    """Return a run of some seconds."""
    run = Lockstep(config_of(*changes), log=log)
    run.request(b"start")
    run.advance(30.0, lambda: run.status.phase is Phase.RUNNING)
    run.advance(DRIVEN_S)
    run.close()
    assert run.status.phase is Phase.RUNNING
    return run.recording


def test_who_is_asked_tells_and_nobody_else() -> None:
    recording = driven("robots.1.sensors=true", "robots.3.sensors=true")
    for robot in ("r2", "r4"):
        values = sensors.columns(recording, robot)
        assert values.gyro.shape == (len(values.stamp_ns), 3)
        assert values.distances.shape == (len(values.stamp_ns), 7)
        assert np.isfinite(values.accelerometer).all()
        periods = np.diff(values.stamp_ns) * 1e-9
        assert periods.mean() == pytest.approx(0.033, rel=0.01)
        assert periods.max() < 0.041  # it is told in a loop of 10 ms
    assert not len(sensors.columns(recording, "r1").stamp_ns)


def test_sensors_say_what_is_true() -> None:
    """Of robots without errors, at the instants of the truth: heading, turning, and the nearest robot."""
    recording = driven(*ALL, *EXACT)
    for robot, before in (("r2", "r1"), ("r3", "r2")):
        values, truth = sensors.columns(recording, robot), recording.of_robot(TRUTH, robot)
        psi = np.interp(values.stamp_ns, truth["stamp_ns"], np.unwrap(truth["psi_rad"]))
        off = (values.heading - psi + math.pi) % math.tau - math.pi
        assert np.abs(off).max() < 0.01 and np.median(np.abs(off)) < 1e-4  # between two truths it is interpolated
        turned = np.cumsum(values.gyro[1:, 2] * np.diff(values.stamp_ns) * 1e-9)
        assert turned == pytest.approx(psi[1:] - psi[0], abs=0.01)
        ahead = recording.of_robot(TRUTH, before)[-1]
        gap = math.hypot(ahead["x_m"] - truth[-1]["x_m"], ahead["y_m"] - truth[-1]["y_m"])
        # The robot before is within the beams of its three front sensors, or beside them.
        assert np.nanmin(values.distances[-1, 2:5]) > gap - 0.055 - 0.07


@pytest.mark.slow
def test_a_run_without_sensors_is_the_run_that_it_was() -> None:
    """What a kind could sense changes neither a message nor the number of the configuration."""
    plain = config_of()
    without = config_of(*(f"robots.{row}.vehicle.sensors=null" for row in range(4)))
    walled = config_of("arena.walls=[[0, 0, 1, 1]]")
    with_sensors = config_of(*ALL)
    assert slices.build(plain) == slices.build(without) == slices.build(walled) != slices.build(with_sensors)
    assert slices.build(with_sensors) != slices.build(config_of(*ALL, "arena.walls=[]"))
    recording = driven()
    assert not any(full.endswith("/sensors") for full in recording.messages)
    status = key(recording.config.arena.name, STATUS, "r1")
    sensing = driven(*ALL)
    assert len(sensing.messages[status][0]) == len(recording.messages[status][0])


@pytest.mark.slow
def test_the_same_run_again_has_the_same_noise_and_another_seed_another() -> None:
    once, again, other = driven(*ALL), driven(*ALL), driven(*ALL, "run.seed=2")
    assert once.trace_hash == again.trace_hash
    gyros = [sensors.columns(recording, "r1").gyro[:50] for recording in (once, other)]
    assert np.abs(gyros[0] - gyros[1]).min() > 0.0


@pytest.mark.slow
def test_robots_see_walls_and_each_other() -> None:
    """Walls of one's own stand in the place of the edge; without any, robots see robots alone."""
    none, cell = driven(*ALL, *EXACT, "arena.walls=[]"), driven(*ALL, *EXACT)
    front = [sensors.columns(recording, "r2").distances for recording in (none, cell)]
    # One that sees a wall beside sees nothing without it; who is ahead is seen either way.
    assert np.isfinite(front[1]).sum() > np.isfinite(front[0]).sum() > 0
    both = np.isfinite(front[0])
    assert (front[1][both] <= front[0][both] + 1e-9).all()


@pytest.mark.slow
def test_the_file_of_a_run_has_them(tmp_path: Path) -> None:
    config = config_of(*ALL)
    with RunLog(tmp_path / FILE, config) as log:
        recording = driven(*ALL, log=log)
    kept = read(tmp_path)
    for mine, live in zip(sensors.columns(kept, "r3"), sensors.columns(recording, "r3"), strict=True):
        np.testing.assert_array_equal(mine, live)
    sensors.write_csv(kept, tmp_path / sensors.CSV)
    head, *rows = (tmp_path / sensors.CSV).read_text().splitlines()
    names = head.split(",")
    assert names[:3] == ["robot", "stamp_s", "gyro_x_rad_s"] and names[-1] == "distance_7_m"
    assert {len(row.split(",")) for row in rows} == {len(names)}
    assert len(rows) == sum(len(sensors.columns(kept, f"r{number}").stamp_ns) for number in range(1, 5))
    assert key(config.arena.name, SENSORS, "r1") in kept.messages

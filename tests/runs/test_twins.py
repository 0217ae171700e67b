"""The twins' process: its ports, the truth that it tells, and what is left when somebody dies."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from robofleet.bus.arena_file import twin_port
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import STATE, TRUTH
from robofleet.bus.messages import RUN_STATE, RunState
from robofleet.config.load import ConfigError, load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.node import LineWaker
from robofleet.recording.reading import read
from robofleet.runs.check import load_checked
from robofleet.runs.twins import Twins
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Phase
from robofleet.simulation.faults import Schedule
from robofleet.simulation.faulty_bus import FaultyBus
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth
from tests.runs.realrun import PLATOON, RealRun, of_robots

FAKE = "tests.simulation.fake_firmware:FakeFirmware"
A_TWIN = ("--set", "robots.0.driver=gternal", "--set", "robots.0.twin=gternal")


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Config:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return load_config(PLATOON, ["drivers.robots_per_process=1"] + [f"robots.{row}.twin={FAKE}" for row in (0, 2)])


def port_of(config: Config, robot: str) -> Path:
    return twin_port(config.arena.name, robot)


def test_there_are_ports_from_the_beginning_to_the_end(config: Config) -> None:
    clock = SimulatedClock()
    twins = Twins(config, MemoryBus(config.arena.name, clock, 0), clock, LineWaker(), None)
    assert [robot.id for robot in config.robots if port_of(config, robot.id).is_char_device()] == ["r1", "r3"]
    twins.close()
    twins.close()
    assert not any(port_of(config, robot.id).is_symlink() for robot in config.robots)


def test_it_tells_the_truth_about_each_fifty_times_a_second(config: Config) -> None:
    clock = SimulatedClock()
    bus = MemoryBus(config.arena.name, clock, 0)
    truths: dict[str, list[Truth]] = {robot.id: [] for robot in config.robots}

    def hear(message: tuple[str, bytes]) -> None:
        truth = TRUTH_LAYOUT.decode(message[1])
        assert truth is not None
        truths[message[0].split("/")[-2]].append(truth)

    bus.tap(hear)
    twins = Twins(config, bus, clock, LineWaker(), None)
    while clock.now_ns() < S:
        clock.advance_to(twins.step(clock.now_ns()))
    twins.close()
    for robot in config.robots:
        stamps = [truth.stamp_ns for truth in truths[robot.id]]
        assert stamps == ([20 * MS * k for k in range(50)] if robot.twin else [])
    assert (truths["r3"][-1].x_m, truths["r3"][-1].y_m) == (config.robots[2].start.x_m, config.robots[2].start.y_m)


def test_its_faults_begin_when_the_fleet_runs(config: Config) -> None:
    clock = SimulatedClock()
    fault = "{kind: unplugged, robot: r3, at_s: 0.5}"
    config = load_config(PLATOON, ["drivers.robots_per_process=1", f"robots.2.twin={FAKE}", f"faults=[{fault}]"])
    plain, schedule = MemoryBus(config.arena.name, clock, 0), Schedule(config, clock)
    twins = Twins(config, FaultyBus(plain, schedule, "twins", clock), clock, LineWaker(), schedule)
    targets = []
    for phase in (Phase.ARMED, Phase.RUNNING):
        plain.publisher(STATE)(RUN_STATE.encode(RunState(1, 1, phase, 0, NOBODY, 0.0, 0, ())))
        for _ in range(60):
            clock.advance_to(clock.now_ns() + 10 * MS)
            twins.step(clock.now_ns())
            targets.append(port_of(config, "r3").is_char_device())
    twins.close()
    assert targets == [True] * 109 + [False] * 11


REFUSED = [
    ((*A_TWIN[1::2], "faults=[{kind: bumper_hit, robot: r2}]"), "faults.0.robot: r2 has no twin: bumper_hit is for r1"),
    ((*A_TWIN[1::2], "faults=[{kind: line_cut, robot: r2}]"), "faults.0.robot: r2 has no twin: line_cut is for r1"),
    (("faults=[{kind: line_late}]",), "faults.0.kind: no robot has a twin: line_late is for one"),
    ((A_TWIN[1], "robots.0.twin=gternl"), "robots.0.twin: there is no twin 'gternl': did you mean 'gternal'?"),
]


@pytest.mark.parametrize(("changes", "complaint"), REFUSED)
def test_what_only_a_twin_can_have_or_no_twin_is_refused(changes: tuple[str, ...], complaint: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(complaint)):
        load_checked(PLATOON, ["tracker.source=truth", *changes])


def test_a_twins_body_can_be_stuck_as_any_simulated_one_and_lockstep_waits_for_no_serial_line() -> None:
    changes = ["tracker.source=truth", *A_TWIN[1::2], "faults=[{kind: motor_stuck, robot: r1}]"]
    assert load_checked(PLATOON, changes).faults
    with pytest.raises(ConfigError, match=r"robots\.0\.driver: .* run without --lockstep"):
        load_checked(PLATOON, changes, lockstep=True)


def test_a_twins_port_has_no_place_where_the_runtime_folder_is_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match=r"robots\.0\.twin: .*Not a directory: set XDG_RUNTIME_DIR"):
        load_checked(PLATOON, ["tracker.source=truth", *A_TWIN[1::2]])


@pytest.mark.long
def test_twins_that_are_killed_end_the_run_and_leave_no_port(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*of_robots("r1"), *A_TWIN)
    run.wait_until_running()
    (port,) = (run.folder.parent / "rt").glob("**/*.tty")
    assert port.is_char_device()
    run.kill("twins")
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert run.summary["cause"] == "the twins was killed by SIGKILL"
    assert not port.is_symlink()


@pytest.mark.long
def test_a_driver_that_is_killed_leaves_its_twin_to_its_firmware(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*of_robots("r1"), *A_TWIN, "--set", "faults=[{kind: killed, process: driver-r1, at_s: 1.0}]")
    run.wait_until_running()
    assert run.ended() == 1
    assert run.nothing_is_left()
    assert "r1: the driver went silent" in run.summary["cause"]
    truths = read(run.folder).of_robot(TRUTH, "r1")
    fastest = truths["v_m_s"].max()
    assert fastest > 0.05
    assert truths["v_m_s"][-1] < 0.5 * fastest  # its watchdog, half a second after the last word


def of_a_create2(*more: str) -> list[str]:
    """Return the options of a run of one Create 2, answered by its twin."""
    robot: dict[str, Any] = yaml.safe_load(PLATOON.read_text())["robots"][0]
    robot |= {"driver": "create2", "twin": "create2", "vehicle": "create2"}
    keys = ["tracker.source=truth", "arena.size_m=[3.5, 2.3]", "groups.0.settings.spacing_m=0.48", "run.duration_s=3"]
    keys += [f"robots={json.dumps([robot])}", 'groups.0.robots=["r1"]', *more]
    return [word for key in keys for word in ("--set", key)]


@pytest.mark.long
def test_a_run_ends_by_the_cables_name_and_the_next_one_drives_after_a_reset(real_run: Callable[..., RealRun]) -> None:
    pulled = real_run(*of_a_create2("faults=[{kind: unplugged, robot: r1, at_s: 1.0, duration_s: 0.5}]"))
    assert pulled.ended() == 1
    (stop,) = pulled.summary["stops"]
    for cause in (pulled.summary["cause"], stop["cause"], pulled.said):
        assert "its driver has lost the connection to it (unplugged?)" in cause
    assert pulled.summary["outcome"] == "fault"
    log = (pulled.folder / "log" / "driver-r1.log").read_text()
    assert "platoon-r1.tty: the line is gone: plug it in again" in log
    assert "Traceback" not in log
    assert pulled.latched() == {"r1": Latch.DRIVER_FAILED}
    latched = real_run(*of_a_create2(), name="latched")
    assert latched.ended() == 1
    assert "robofleet run CONFIG --reset" in latched.summary["cause"]
    again = real_run(*of_a_create2(), "--reset", name="again")
    assert again.ended() == 0, again.said
    assert again.summary["outcome"] == "completed"

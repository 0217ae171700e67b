"""Runs in real time, with every process of theirs: they work, they end, and nothing is left of them."""

import signal
from collections.abc import Callable

import psutil
import pytest

from robofleet.bus.keys import STATUS
from robofleet.config.load import load_config
from robofleet.recording.reading import read
from robofleet.safety.latches import GateStatus
from tests.runs.realrun import ALONE, RealRun
from tests.shipped import PLATOON
from tools.measure.runs.busy_machine import busy_loops

ROBOTS = ["r1", "r2", "r3", "r4"]
LONG_VICTIMS = "router", "recorder", "controller", "tracker", "supervisor"


def libraries(process: psutil.Process) -> str:
    return "\n".join(mapped.path for mapped in process.memory_maps())


@pytest.mark.slow
def test_a_run_in_real_time_with_the_camera(real_run: Callable[..., RealRun]) -> None:
    run = real_run("--duration", "3")
    run.wait_until_running()
    assert len(run.children()) == 6
    (driver,) = run.children("driver", ",".join(ROBOTS))
    loaded = libraries(driver)
    assert "zenoh" in loaded
    assert "cv2" not in loaded
    assert "cv2" in libraries(run.children("tracker")[0])
    assert run.ended() == 0
    assert run.children() == []

    s = run.summary
    assert (s["outcome"], s["cause"], s["mode"]) == ("completed", None, "realtime")
    assert s["stops"] == [] or s["busy_machine"], "a machine that was too slow for the gates says so"
    assert s["duration_s"] == pytest.approx(3, abs=0.2)
    assert s["tracker"]["false_ids"] == 0
    if s["tick"]["overruns"] <= 5 and not s["busy_machine"]:  # the figures of another run are the machine's
        assert s["real_time_factor"] == pytest.approx(1, abs=0.1)
        assert s["rejected"] == dict.fromkeys(ROBOTS, 0)
        assert s["control_error_mm"]["mean"] <= 1.5
        assert s["tracker"]["measured_fraction"] > 0.95
        assert 10 < s["latency_ms"]["exposure_to_wheel"]["p50"] < 25
        assert s["pose_error"]["rms_mm"] < 1.0

    recording = read(run.folder)
    assert (recording.outcome, recording.cause, recording.dropped) == ("completed", None, 0)
    assert s["recording"] == {"messages": recording.count, "dropped": 0}
    for robot in ROBOTS:
        statuses = recording.of_robot(STATUS, robot)
        assert statuses["gate"].max() == GateStatus.NO_LEASE, "before the controller came"
        assert statuses["left_output_rad_s"].any()
        assert (statuses["gate"][-1] != GateStatus.OPEN) and not statuses["left_rad_s"][-1], "the stop is in the file"

    replayed, configured = load_config(run.folder / "config.yaml"), load_config(PLATOON, ["run.duration_s=3"])
    assert not replayed.bus.endpoint.endswith(":0")
    assert replayed.model_copy(update={"bus": configured.bus}) == configured
    for log in (run.folder / "log").iterdir():
        assert "Traceback" not in log.read_text(), log.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "victim", ["driver-r1", *(pytest.param(name, marks=pytest.mark.long) for name in LONG_VICTIMS)]
)
def test_a_run_ends_when_one_of_its_processes_is_killed(real_run: Callable[..., RealRun], victim: str) -> None:
    run = real_run(*ALONE)
    run.wait_until_running()
    run.kill(*victim.split("-"))
    assert run.nothing_is_left()
    assert run.ended() == 1
    cause = f"the {victim} was killed by SIGKILL"
    assert (run.summary["outcome"], run.summary["cause"]) == ("fault", cause)
    assert cause in run.said
    assert run.summary["recording"]["messages"] > 300, "it is made from what was recorded until then"


@pytest.mark.long
@pytest.mark.parametrize("running", [True, False], ids=["running", "still starting"])
def test_ctrl_c_is_a_controlled_stop(real_run: Callable[..., RealRun], running: bool) -> None:
    run = real_run(*ALONE)
    run.wait_until_running() if running else run.wait_for(run.children)
    run.launcher.send_signal(signal.SIGINT)
    assert run.nothing_is_left()
    assert run.ended() == 1
    assert (run.summary["outcome"], run.summary["cause"]) == ("stopped", "the operator interrupted")
    assert (run.summary["ticks"] > 0, "running" in run.said) == (running, running)
    if not running:
        assert len(list((run.folder / "log").iterdir())) < 5, "nobody else is started then"


@pytest.mark.long
def test_a_run_whose_folder_is_renamed_goes_on_and_says_where_it_is_not(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*ALONE, "--duration", "2")
    run.wait_until_running()
    moved = run.folder.rename(run.folder.with_name("moved"))
    assert run.ended() == 1, "a completed run whose figures are lost met none of its bounds"
    assert "results are lost" in run.said
    assert f"{run.folder}" in run.said
    assert not run.folder.exists()
    assert (read(moved).outcome, read(moved).trouble) == ("completed", None)
    assert "Traceback" not in (moved / "log" / "supervisor.log").read_text()


@pytest.mark.long
def test_no_load_explains_the_silence_of_a_driver_that_somebody_stops(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*ALONE)
    run.wait_until_running()
    (driver,) = run.children("driver")
    with busy_loops(4):
        driver.send_signal(signal.SIGSTOP)
        assert run.ended() == 1
    assert "the driver went silent" in run.summary["cause"]
    assert run.summary["outcome"] == "fault"

"""A run on a simulated clock with its gateway in one process: a user drives in the time that ``/clock`` tells."""

import json
import os
import re
import signal
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.command import robofleet
from tests.runs.realrun import own_folders

CONFIG = Path(__file__).parents[3] / "configs" / "ros2.yaml"
WITHIN_S = 120.0

needs_ros = pytest.mark.skipif(
    find_spec("rclpy") is None, reason="NO ROS 2: pip install -e '.[ros2]' on Python 3.11, or source your own"
)


@pytest.mark.slow
@needs_ros
def test_a_node_drives_in_simulated_time_until_the_run_in_the_background_is_interrupted(tmp_path: Path) -> None:
    environment = own_folders(tmp_path) | {
        "ROS_DOMAIN_ID": str(101 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path),
    }  # fmt: skip
    user = [sys.executable, "-m", "tests.gateways.ros2.user", "clock"]
    gateway = [sys.executable, "-m", "robofleet", "ros2", str(CONFIG), "--lockstep", "--out", str(tmp_path / "run")]
    background = ["env", "--ignore-signal=INT", *gateway, "--set", "tracker.source=truth"]  # as a shell's `&` does
    with subprocess.Popen(background, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        try:
            node = subprocess.run(user, env=environment, capture_output=True, text=True, timeout=WITHIN_S, check=False)
            run.send_signal(signal.SIGINT)
            _, output = run.communicate(timeout=WITHIN_S)
        finally:
            run.kill()
    assert node.returncode == 0, (node.stderr, output.decode())
    counts = json.loads(node.stdout)
    assert counts["moved_m"] == pytest.approx(2 * 0.12, abs=0.05), "less the motors' lag"
    assert 0.0 < counts["clock_s"] < 1000.0 and counts["rises"], "a clock of its own"
    assert abs(counts["odom_late_s"]) < 0.1
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["mode"], summary["outcome"]) == ("lockstep", "stopped")


@needs_ros
@pytest.mark.parametrize(
    ("arguments", "refusal"),
    [
        (["--lockstep"], "name a configuration"),
        (["lab", "--lockstep"], "name a configuration"),
        ([str(CONFIG)], "start `robofleet run"),
        ([str(CONFIG), "--lockstep", "--speed", "0"], "--speed 0: must be"),
        ([str(CONFIG), "--lockstep", "--set", "groups.0.settings.silent_s=no"], "silent_s"),
        ([str(CONFIG), "--lockstep", "--namespace", "1 bad"], "--namespace 1 bad: "),
        (["nowhere"], "robofleet run|has no run"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(
    arguments: list[str], refusal: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    done = robofleet("ros2", *arguments)
    assert done.exit_code == 2 and done.stdout == ""
    assert re.search(refusal, done.stderr) and len(done.stderr.strip().splitlines()) == 1
    assert not any(tmp_path.iterdir()), "nothing has begun"


@needs_ros
@pytest.mark.parametrize(("variable", "value"), [("ROS_DOMAIN_ID", "abc"), ("RMW_IMPLEMENTATION", "rmw_nowhere_cpp")])
def test_what_ros_does_not_start_with_is_said_in_a_line(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(variable, value)
    done = robofleet("ros2", CONFIG, "--lockstep", "--out", tmp_path / "run")
    assert done.exit_code == 2 and done.stdout == ""
    assert variable in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@needs_ros
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of ROS's own packages
@pytest.mark.parametrize("end", ["accomplished", "parked"])
def test_a_run_that_has_done_what_it_should_has_completed(
    end: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By itself, as the behaviour go_to does; and where the robots park after the run's duration."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(101 + os.getpid() % 100))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    near = {"x_m": -0.8, "y_m": 0.5, "heading_deg": 0}
    robot = {"id": "r1", "tag": 1, "vehicle": "gternal", "start": near | {"x_m": -0.9}, "park": near}
    group = {"behaviour": "go_to", "robots": ["r1"], "settings": {"goals": {"r1": near}}}
    changes = {"tracker.source": "truth", "robots": json.dumps([robot])}
    if end == "accomplished":
        changes["groups"] = json.dumps([group])
    else:
        changes |= {"groups.0.robots": "[r1]", "run.end": "park", "run.duration_s": "1"}
    sets = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
    command = ["ros2", str(CONFIG), "--lockstep", "--speed", "100", "--out", str(tmp_path / "run"), *sets]
    done = robofleet(*command)
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["outcome"] == "completed" and summary["duration_s"] < 60.0

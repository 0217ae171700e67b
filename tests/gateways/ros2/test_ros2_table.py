"""The table of the ROS 2 graph as people read it; names that ROS takes; what is said where ROS 2 is missing."""

import re
import runpy
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import yaml

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.ros2 import command, topics
from tests.command import robofleet

SHARE = Path(topics.__file__).parent / "share"
README = Path(topics.__file__).parent / "README.md"
TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def test_the_readme_has_the_table() -> None:
    lines = [line for line in README.read_text().splitlines() if line.startswith("| `")]
    rows = [[cell.strip().replace("`", "") for cell in line.strip("|").split("|")] for line in lines]
    table = [[row.name, row.type, row.frame, str(row.quality), row.rate.replace("`", "")] for row in topics.TOPICS]
    assert [row for row in rows if len(row) == 5] == table
    services = [row[0].split(", ") for row in rows if len(row) == 3 and row[1] == topics.SERVICE]
    assert sorted(name for names in services for name in names) == sorted(SERVICES)


@pytest.mark.parametrize("namespace", ["", "lab", "/a/b"])
@pytest.mark.parametrize("name", ["ros2", "two-cameras"])
def test_rviz_shows_what_is_said(name: str, namespace: str) -> None:
    """Each display's topic is a row that it can hear; every latched row and image are shown, frames, and distances."""
    changes = ["--set", "robots.0.sensors=true"]
    file = str(SHIPPED / f"{name}.yaml")
    done = robofleet("ros2", file, "--rviz", "--namespace", namespace, *changes)
    assert done.exit_code == 0, done.output
    shown, config = yaml.safe_load(done.stdout)["Visualization Manager"], load_config(SHIPPED / f"{name}.yaml")
    prefix = namespace.strip("/") + "/" if namespace else ""
    assert shown["Global Options"]["Fixed Frame"] == shown["Views"]["Current"]["Target Frame"] == f"{prefix}map"
    sensors = config.robot("r1").vehicle.sensors
    assert sensors is not None and sensors.distances is not None
    rows = {
        "map": topics.FLOOR,
        "markers": topics.MARKERS,
        **{f"{camera}/image": topics.IMAGE for camera in config.camera_names},
    }
    rows |= {f"r1/range_{number}": topics.RANGE for number in range(len(sensors.distances.places))}
    models = [display for display in shown["Displays"] if display["Class"].endswith("/RobotModel")]
    assert [display["Description Topic"]["Value"] for display in models] == [
        f"/{prefix}{r}/robot_description" for r in config.ids
    ]
    assert [display["TF Prefix"] for display in models] == [f"{prefix}{robot}" for robot in config.ids]
    displays = {display["Topic"]["Value"]: display for display in shown["Displays"] if "Topic" in display}
    assert set(displays) == {f"/{prefix}{topic}" for topic in rows}
    for topic, row in rows.items():
        display = displays[f"/{prefix}{topic}"]
        assert display["Class"].rpartition("/")[2] == row.type.rpartition("/")[2].replace("OccupancyGrid", "Map")
        assert display["Topic"]["Reliability Policy"] == ("Reliable" if row.quality.reliable else "Best Effort")
        assert display["Topic"]["Durability Policy"] == ("Transient Local" if row.quality.latched else "Volatile")
    assert {display["Name"] for display in shown["Displays"] if "Topic" not in display} == {
        "Grid",
        "Frames",
        *config.ids,
    }
    assert all(display["Enabled"] for display in shown["Displays"])


@pytest.mark.parametrize("rviz", ["true", "false"])
def test_the_launch_file_starts_the_gateway_and_rviz(
    rviz: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without ROS 2's ``launch`` it is read with a stand-in, which keeps what would be started."""
    started: list[dict[str, Any]] = []
    program = tmp_path / "robofleet"
    program.write_text('#!/bin/sh\necho "$@"\n')
    program.chmod(0o755)
    given = {"arena": "lab", "namespace": "ns", "rviz": rviz, "robofleet": str(program)}

    def keep(kind: str) -> Callable[..., Any]:
        return lambda *arguments, **options: started.append({"kind": kind, "arguments": arguments, **options})

    def chosen(name: str) -> Any:
        return SimpleNamespace(perform=lambda _: given[name])

    for module, names in {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess", "OpaqueFunction"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros.actions": ["Node"],
    }.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, chosen if name == "LaunchConfiguration" else keep(name))
        monkeypatch.setitem(sys.modules, module, stand_in)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    runpy.run_path(str(SHARE / "robofleet.launch.py"))["generate_launch_description"]()
    (function,) = (topic["function"] for topic in started if topic["kind"] == "OpaqueFunction")
    function(None)
    declared = {topic["arguments"][0] for topic in started if topic["kind"] == "DeclareLaunchArgument"}
    assert declared == set(given)
    (gateway,) = (topic for topic in started if topic["kind"] == "ExecuteProcess")
    assert gateway["cmd"] == [str(program), "ros2", "lab", "--namespace", "ns"]
    shown = [topic for topic in started if topic["kind"] == "Node"]
    assert len(shown) == (rviz == "true")
    for topic in shown:
        assert (topic["package"], topic["arguments"][0]) == ("rviz2", "-d")
        assert Path(topic["arguments"][1]).read_text() == "ros2 lab --namespace ns --rviz\n"


@pytest.mark.parametrize("name", ["r1", "robot-1", "1st", "a_b", "camera.7"])
def test_names_are_names_of_ros(name: str) -> None:
    assert TOKEN.fullmatch(topics.ros_name(name))
    assert topics.ros_name("r1") == "r1"


def test_two_robots_with_one_name_are_refused() -> None:
    with pytest.raises(topics.NamesError, match="a-b and a_b are both called a_b"):
        topics.ros_names(["a-b", "r1", "a_b"])


def test_without_rclpy_a_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    find_spec = command.find_spec
    monkeypatch.setattr(command, "find_spec", lambda name: None if name in ("rclpy", "nav_msgs") else find_spec(name))
    done = robofleet("ros2")
    assert done.exit_code == 2 and done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("this needs nav_msgs") and "rclpy" in line and "[ros2]" in line


@pytest.mark.parametrize("package", ["rclpy", "std_srvs"])
def test_every_package_that_is_missing_is_named(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    find_spec = command.find_spec
    monkeypatch.setattr(command, "find_spec", lambda name: None if name == package else find_spec(name) or name)
    done = robofleet("ros2")
    assert (done.exit_code, done.stdout) == (2, "") and f"this needs {package} of ROS 2" in done.stderr


def test_rclpy_of_another_python_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("raise ImportError('built for another\\nPython')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    monkeypatch.setattr(command, "find_spec", lambda name: name)
    done = robofleet("ros2")
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert "rclpy" in line and "built for another Python" in line

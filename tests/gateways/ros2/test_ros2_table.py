"""The table of the ROS 2 graph as people read it; names that ROS takes; what is said where ROS 2 is missing."""

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.comms.keys import CAMERA
from robofleet.gateways.asking import SERVICES
from robofleet.gateways.ros2 import command, topics

SHARE = Path(topics.__file__).parent / "share"
README = Path(topics.__file__).parent / "README.md"
TOKEN = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def test_the_readme_has_the_table() -> None:
    lines = [line for line in README.read_text().splitlines() if line.startswith("| `")]
    rows = [[cell.strip().replace("`", "") for cell in line.strip("|").split("|")] for line in lines]
    told = [[row.name, row.type, row.frame, str(row.quality), row.rate.replace("`", "")] for row in topics.TOPICS]
    assert [row for row in rows if len(row) == 5] == told
    services = [row[0].split(", ") for row in rows if len(row) == 3 and row[1] == topics.SERVICE]
    assert sorted(name for names in services for name in names) == sorted(SERVICES)


def test_rviz_shows_what_is_said() -> None:
    """Each display's topic is a row that it can hear; every latched row and the image are shown, and the frames."""
    shown = yaml.safe_load((SHARE / "robofleet.rviz").read_text())["Visualization Manager"]
    assert shown["Global Options"]["Fixed Frame"] == topics.MAP
    displays = {one["Class"].rpartition("/")[2]: one for one in shown["Displays"]}
    rows = {"MarkerArray": topics.MARKERS, "Image": topics.IMAGE}
    for kind, row in rows.items():
        its = displays[kind]["Topic"]
        assert its["Value"].lstrip("/") == row.name.format(topics.ros_name(CAMERA)) and row.type.endswith(kind)
        assert its["Reliability Policy"] == ("Reliable" if row.quality.reliable else "Best Effort")
        assert its["Durability Policy"] == ("Transient Local" if row.quality.latched else "Volatile")
    assert set(displays) == {*rows, "TF", "Grid"} and all(one["Enabled"] for one in displays.values())


def test_the_launch_file_starts_the_gateway_and_rviz(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without ROS 2's ``launch`` it is read with a stand-in, which keeps what would be started."""
    started: list[dict[str, Any]] = []

    def keep(kind: str) -> Callable[..., Any]:
        return lambda *arguments, **told: started.append({"kind": kind, "arguments": arguments, **told})

    for module, names in {
        "launch": ["LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "ExecuteProcess"],
        "launch.conditions": ["IfCondition"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros.actions": ["Node"],
    }.items():
        stand_in = ModuleType(module)
        for name in names:
            setattr(stand_in, name, str if name == "LaunchConfiguration" else keep(name))
        monkeypatch.setitem(sys.modules, module, stand_in)
    runpy.run_path(str(SHARE / "robofleet.launch.py"))["generate_launch_description"]()
    (gateway,) = (one for one in started if one["kind"] == "ExecuteProcess")
    (rviz,) = (one for one in started if one["kind"] == "Node")
    declared = {one["arguments"][0] for one in started if one["kind"] == "DeclareLaunchArgument"}
    assert gateway["cmd"] == ["robofleet", "ros2", "arena"] and {"robofleet", "arena", "rviz"} == declared
    assert (rviz["package"], rviz["arguments"][0]) == ("rviz2", "-d") and Path(rviz["arguments"][1]).is_file()


@pytest.mark.parametrize("name", ["r1", "robot-1", "1st", "a_b", "camera.7"])
def test_names_are_names_of_ros(name: str) -> None:
    assert TOKEN.fullmatch(topics.ros_name(name))
    assert topics.ros_name("r1") == "r1"


def test_two_robots_with_one_name_are_refused() -> None:
    with pytest.raises(topics.NamesError, match="a-b and a_b are both called a_b"):
        topics.ros_names(["a-b", "r1", "a_b"])


def test_without_rclpy_a_line_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    there = command.find_spec
    monkeypatch.setattr(command, "find_spec", lambda name: None if name in ("rclpy", "nav_msgs") else there(name))
    done = CliRunner().invoke(app, ["ros2"])
    assert done.exit_code == 2 and done.stdout == ""
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("this needs nav_msgs") and "rclpy" in line and "[ros2]" in line


def test_rclpy_of_another_python_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("raise ImportError('built for another\\nPython')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    monkeypatch.setattr(command, "find_spec", lambda name: name)
    done = CliRunner().invoke(app, ["ros2"])
    assert done.exit_code == 2
    (line,) = done.stderr.strip().splitlines()
    assert "rclpy" in line and "built for another Python" in line

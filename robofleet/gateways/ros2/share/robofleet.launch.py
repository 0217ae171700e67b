"""The gateway of a run that is on, and RViz with everything shown.

    ros2 launch ./robofleet.launch.py arena:=lab

Arguments: ``arena``: whose run, empty: the only one; ``namespace``: of the run's topics and frames; ``rviz``: whether
RViz is started; ``robofleet``: the program.
"""

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

_ARGUMENTS = {
    "arena": ("", "Whose run; empty: the only one."),
    "namespace": ("", "ROS namespace of the run's topics and frames."),
    "rviz": ("true", "Whether RViz is started."),
    "robofleet": ("robofleet", "Path of the program."),
}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=what) for name, (value, what) in _ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_started)])


def _started(context: Any) -> list[Any]:
    """Return the gateway, and RViz with a configuration of this run's robots and cameras."""
    arena, namespace, rviz, program = (LaunchConfiguration(name).perform(context) for name in _ARGUMENTS)
    gateway = [program, "ros2", arena, "--namespace", namespace]
    started = [ExecuteProcess(cmd=gateway, output="screen")]
    if rviz.lower() in ("true", "1"):
        shown = subprocess.run([*gateway, "--rviz"], stdout=subprocess.PIPE, check=False)
        if shown.returncode == 0:  # else it has said why
            file = Path(tempfile.mkdtemp(prefix="robofleet-")) / "robofleet.rviz"
            file.write_bytes(shown.stdout)
            started.append(Node(package="rviz2", executable="rviz2", arguments=["-d", str(file)]))
    return started

"""The gateway of a run, and RViz with everything shown.

    ros2 launch ./robofleet.launch.py arena:=lab

Arguments: ``arena``: whose run, empty: the only one; ``rviz``: whether RViz is started; ``robofleet``: the program.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

_RVIZ = Path(__file__).parent / "robofleet.rviz"


def generate_launch_description() -> LaunchDescription:
    """Return what is started."""
    arena, program = LaunchConfiguration("arena"), LaunchConfiguration("robofleet")
    return LaunchDescription(
        [
            DeclareLaunchArgument("arena", default_value="", description="Whose run; empty: the only one."),
            DeclareLaunchArgument("rviz", default_value="true", description="Whether RViz is started."),
            DeclareLaunchArgument("robofleet", default_value="robofleet", description="Path of the program."),
            ExecuteProcess(cmd=[program, "ros2", arena], output="screen"),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(_RVIZ)],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )

"""The table of the ROS 2 graph: name, type, frame and quality of service of each topic and service.

``{}`` in a name is a robot, or a camera; after ``range_`` it is a sensor's number. The README has the same table, and
a test holds it against a live graph.
"""

import re
from collections.abc import Iterable
from importlib import import_module
from typing import Any, Literal, NamedTuple

from robofleet.core.errors import RobofleetError

MAP = "map"  # the world frame of robofleet: the arena's centre on the floor
_TOKEN = re.compile(r"[^A-Za-z0-9_]")


class Quality(NamedTuple):
    """Quality of service of a topic; the history keeps the last ``depth``."""

    reliable: bool
    latched: bool  # transient local: who comes later hears the newest one
    depth: int

    def __str__(self) -> str:
        words = ["reliable" if self.reliable else "best effort", "transient local" if self.latched else "volatile"]
        return f"{', '.join(words)}, {self.depth}"


SENSOR = Quality(reliable=False, latched=False, depth=5)
PLAIN = Quality(reliable=True, latched=False, depth=10)
MANY = Quality(reliable=True, latched=False, depth=100)
NEWEST = Quality(reliable=False, latched=False, depth=1)
LATCHED = Quality(reliable=True, latched=True, depth=1)


class Topic(NamedTuple):
    """A row."""

    name: str
    type: str  # as ROS writes it; of ``cmd_vel`` both types
    frame: str  # frame_id, or of transforms parent -> child; empty: it has none
    quality: Quality
    rate: str  # when it is said
    flow: Literal["out", "in"] = "out"


POSE = Topic("{}/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", MAP, PLAIN, "each image that shows the robot")
ODOM = Topic("{}/odom", "nav_msgs/msg/Odometry", "{}/odom -> {}/base_link", PLAIN, "each status, 20 ms")
JOINTS = Topic("{}/joint_states", "sensor_msgs/msg/JointState", "{}/base_link", PLAIN, "each status, 20 ms")
BATTERY = Topic("{}/battery_state", "sensor_msgs/msg/BatteryState", "{}/base_link", PLAIN, "1 s")
IMU = Topic("{}/imu/data_raw", "sensor_msgs/msg/Imu", "{}/base_link", SENSOR, "each reading with it")
MAGNETIC = Topic("{}/imu/mag", "sensor_msgs/msg/MagneticField", "{}/base_link", SENSOR, "each reading with it")
RANGE = Topic("{}/range_{}", "sensor_msgs/msg/Range", "{}/range_{}", SENSOR, "each reading with it")
COMMAND = Topic(
    "{}/cmd_vel", "geometry_msgs/msg/TwistStamped or geometry_msgs/msg/Twist", "{}/base_link", NEWEST, "yours", "in"
)
DESCRIPTION = Topic("{}/robot_description", "std_msgs/msg/String", "{}/base_link", LATCHED, "once: its URDF")
TRANSFORMS = Topic(
    "/tf", "tf2_msgs/msg/TFMessage", "map -> {}/odom -> {}/base_link -> {}/left_wheel_link, {}/right_wheel_link", MANY,
    "each status, 20 ms",
)  # fmt: skip
FLOOR = Topic("map", "nav_msgs/msg/OccupancyGrid", MAP, LATCHED, "once: floor and obstacles")
FIXED = Topic(
    "/tf_static", "tf2_msgs/msg/TFMessage", "map -> {}_optical_frame, {}/base_link -> {}/range_{}", LATCHED, "once"
)
IMAGE = Topic("{}/image", "sensor_msgs/msg/Image", "{}_optical_frame", SENSOR, "5 Hz while somebody looks")
COMPRESSED = Topic(
    "{}/image/compressed", "sensor_msgs/msg/CompressedImage", "{}_optical_frame", SENSOR, "5 Hz while somebody looks"
)
CAMERA_INFO = Topic("{}/camera_info", "sensor_msgs/msg/CameraInfo", "{}_optical_frame", SENSOR, "with each image")
MARKERS = Topic("markers", "visualization_msgs/msg/MarkerArray", "map, {}/base_link", LATCHED, "once")
STATE = Topic("state", "std_msgs/msg/String", "", LATCHED, "each change")
DIAGNOSTICS = Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "", PLAIN, "1 s")
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", "", SENSOR, "5 ms of simulated time, with `--lockstep`")

OF_ROBOTS = POSE, ODOM, JOINTS, BATTERY, DESCRIPTION, COMMAND
OF_SENSORS = IMU, MAGNETIC, RANGE
OF_CAMERAS = IMAGE, COMPRESSED, CAMERA_INFO
OF_RUN = TRANSFORMS, FIXED, FLOOR, MARKERS, STATE, DIAGNOSTICS, CLOCK
TOPICS = (*OF_ROBOTS, *OF_SENSORS, *OF_CAMERAS, *OF_RUN)

SERVICE = "std_srvs/srv/Trigger"


class NamesError(RobofleetError):
    """Raised where two names would be one name in ROS. The message is a line."""


def ros_name(name: str) -> str:
    """Return a robot's or camera's name as a part of ROS names: letters, digits and _, no digit first."""
    token = _TOKEN.sub("_", name)
    return f"_{token}" if token[0].isdigit() else token


def ros_names(robots: Iterable[str]) -> dict[str, str]:
    """Return the robots' names as ROS has them; NamesError where two would be one."""
    names: dict[str, str] = {}
    for robot in robots:
        for other, taken in names.items():
            if taken == ros_name(robot):
                raise NamesError(f"the robots {other} and {robot} are both called {taken} in ROS: rename one")
        names[robot] = ros_name(robot)
    return names


class Frames:
    """The frames of a run: with its namespace in front, so several arenas share one tree of frames."""

    def __init__(self, namespace: str = "") -> None:
        self._prefix = f"{namespace.strip('/')}/".lstrip("/")
        self.map = f"{self._prefix}{MAP}"

    def link(self, robot: str, name: str) -> str:
        """Return a frame of a robot, as its URDF names it; ``odom`` is where its odometry is continuous.

        ``base_link`` is on the floor under the middle of its axle, x ahead, y to the left, z up. The x axis of
        ``range_N`` is the direction in which the distance sensor looks.
        """
        return f"{self._prefix}{robot}/{name}"

    def optical(self, camera: str) -> str:
        """Return a camera's frame: x to the right of the image, y down, z ahead."""
        return f"{self._prefix}{camera}_optical_frame"


def load(name: str) -> Any:
    """Return a type of messages or services by its name; ModuleNotFoundError where its package is missing."""
    package, kind, title = name.split("/")
    return getattr(import_module(f"{package}.{kind}"), title)

"""What is said of each robot: its pose as the tracker measures it, its odometry, its wheels, its battery."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.keys import POSES, STATUS
from robofleet.bus.messages import FLEET_POSES, UNIT_STATUS, FleetPoses, TagPose, UnitStatus
from robofleet.bus.observer import Observer, Source
from robofleet.bus.ticks import TickFollower
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph, Transforms, single, wanted
from robofleet.gateways.ros2.odometry import Odometry
from robofleet.gateways.urdf import BASE, WHEELS
from robofleet.tracking.filter.estimator import rows_of
from robofleet.vehicles.differential_drive import DifferentialDrive

_JOINTS = [f"{wheel}_joint" for wheel in WHEELS]
_BATTERY_PERIOD_NS = S
_COVARIANCE = tuple(TagPose._fields[6:])
_COVARIANCE_INDICES = 0, 1, 7, 5, 11, 35  # of xx, xy, yy, xpsi, ypsi, psipsi in ROS's 6 x 6: x, y, z, roll, pitch, yaw
_MIRRORED = {1: 6, 5: 30, 11: 31}


class Robots:
    """All robots of a run."""

    def __init__(
        self, graph: Graph, config: Config, names: dict[str, str], observer: Observer, ticks: TickFollower
    ) -> None:
        self._graph, self._ticks, self._observer = graph, ticks, observer
        transforms = Transforms(graph)
        self._units = {
            unit: _Unit(graph, config, [(robot, names[robot]) for robot in robots], transforms)
            for unit, robots in config.units.items()
        }
        for unit, robots in config.units.items():
            observer.declare([(STATUS, unit)], partial(_view, len(robots)))
        observer.declare([(POSES, camera) for camera in config.camera_names], FLEET_POSES.view)
        own = {robot: (unit, row) for unit in self._units.values() for row, robot in enumerate(unit.robots)}
        self._owners = [own[robot.id] for robot in config.bodies]
        self._rows = rows_of({robot.tag: row for row, robot in enumerate(config.bodies)})
        self._behind_ns = dict.fromkeys(config.camera_names, 0)  # each tracker's clock, behind ours

    def exposed_ns(self, camera: str, exposure_ns: int) -> int:
        """Convert an instant of a tracker's clock to this clock, by the tracker's newest poses."""
        return exposure_ns + self._behind_ns[camera]

    def step(self, now_ns: int, updated: set[Source]) -> None:
        for name, unit in self._units.items():
            if (source := (STATUS, name)) in updated:
                unit.say(self._observer.arrival_ns(source), now_ns, *self._observer[source])
        for camera in self._behind_ns:
            if self._ticks.newest and (POSES, camera) in updated:
                self._seen(camera, *self._observer[POSES, camera])

    def _seen(self, camera: str, image: FleetPoses, poses: NDArray[Any]) -> None:
        """Publish the poses of robots that an image shows; a predicted pose is not measured."""
        if not image.echo_tick:
            return
        exposure_ns = self._ticks.instant(image.echo_tick) + image.since_tick_ns
        self._behind_ns[camera] = exposure_ns - image.exposure_ns
        for tag_pose in poses[poses["coasted_ns"] == 0]:
            row = int(self._rows[tag_pose["tag"]])
            if row >= 0:
                unit, index = self._owners[row]
                unit.seen(index, exposure_ns + int(tag_pose["after_ns"]), tag_pose)


def _view(robots: int, payload: bytes) -> tuple[UnitStatus, NDArray[Any]] | None:
    """Return a status of a unit of so many robots."""
    message = UNIT_STATUS.view(payload)
    return message if message is not None and len(message[1]) == robots else None


class _Unit:
    """The robots of one driver process, which tell together."""

    def __init__(self, graph: Graph, config: Config, robots: Sequence[tuple[str, str]], transforms: Transforms) -> None:
        self.robots = [robot for robot, _ in robots]
        self._graph, self._transforms = graph, transforms
        drives = [slices.drive(config.robot(robot)) for robot in self.robots]
        self._odometry = Odometry(drives)
        self._robots = [_Robot(graph, name, drive) for (_, name), drive in zip(robots, drives, strict=True)]
        self._battery_ns = 0

    def say(self, at_ns: int, now_ns: int, status: UnitStatus, items: NDArray[Any]) -> None:
        angles = np.column_stack([items["left_angle_rad"], items["right_angle_rad"]])
        speeds = np.column_stack([items["left_rad_s"], items["right_rad_s"]])
        odometry, stamp = self._odometry, self._graph.stamp(at_ns)
        odometry.turned(at_ns, status.boot_id, angles, speeds)
        moved = list[Any]()
        tells = now_ns - self._battery_ns >= _BATTERY_PERIOD_NS
        for row, robot in enumerate(self._robots):
            pose = odometry.poses[row].tolist()
            robot.say_odometry(stamp, pose, odometry.twists[row].tolist())
            robot.say_wheels(stamp, angles[row].tolist(), speeds[row].tolist())
            if tells:
                robot.say_battery(stamp, float(items["battery"][row]))
            if self._transforms.wanted:
                correction = odometry.corrections[row].tolist() if odometry.corrected[row] else None
                moved += robot.transforms(stamp, correction, pose, angles[row].tolist())
        if tells:
            self._battery_ns = now_ns
        self._transforms.say(moved)

    def seen(self, row: int, at_ns: int, tag_pose: Any) -> None:
        """Take where the tracker saw a robot, as TagPose."""
        pose = np.array([tag_pose["x_m"], tag_pose["y_m"], tag_pose["psi_rad"]])
        self._odometry.seen(row, at_ns, pose)
        self._robots[row].say_pose(
            self._graph.stamp(at_ns), pose.tolist(), [float(tag_pose[name]) for name in _COVARIANCE]
        )


class _Robot:
    """One robot's publishers, and the messages that it says again and again."""

    def __init__(self, graph: Graph, name: str, drive: DifferentialDrive) -> None:
        frames, messages = graph.frames, graph.messages
        odom, base = frames.link(name, "odom"), frames.link(name, BASE)
        self._pose = graph.publisher(topics.POSE, name)
        self._odom = graph.publisher(topics.ODOM, name)
        self._joints = graph.publisher(topics.JOINTS, name)
        self._battery = graph.publisher(topics.BATTERY, name)
        self._seen = messages.PoseWithCovarianceStamped()
        self._seen.header.frame_id = frames.map
        self._moved = messages.Odometry(child_frame_id=base)
        self._moved.header.frame_id = odom
        self._turned = messages.JointState(name=_JOINTS)
        self._turned.header.frame_id = base
        self._charged = messages.BatteryState(
            present=True, voltage=math.nan, current=math.nan, charge=math.nan, capacity=math.nan,
            design_capacity=math.nan, temperature=math.nan,
        )  # fmt: skip
        self._charged.header.frame_id = base
        self._from_map, self._from_odom = (messages.TransformStamped(child_frame_id=frame) for frame in (odom, base))
        self._from_map.header.frame_id, self._from_odom.header.frame_id = frames.map, odom
        self._wheels = [
            messages.TransformStamped(child_frame_id=frames.link(name, f"{wheel}_link")) for wheel in WHEELS
        ]
        for wheel, side in zip(self._wheels, (0.5, -0.5), strict=True):
            wheel.header.frame_id = base
            wheel.transform.translation.y = side * drive.wheel_base
            wheel.transform.translation.z = drive.wheel_radius

    def say_pose(self, stamp: Any, pose: Sequence[float], covariance: Sequence[float]) -> None:
        message, whole = self._seen, np.zeros(36)
        message.header.stamp = stamp
        _place(message.pose.pose, pose)
        for index, value in zip(_COVARIANCE_INDICES, covariance, strict=True):
            whole[index] = whole[_MIRRORED.get(index, index)] = value
        message.pose.covariance = whole
        self._pose.publish(message)

    def say_odometry(self, stamp: Any, pose: Sequence[float], twist: Sequence[float]) -> None:
        if wanted(self._odom):
            message = self._moved
            message.header.stamp = stamp
            _place(message.pose.pose, pose)
            message.twist.twist.linear.x, message.twist.twist.angular.z = twist
            self._odom.publish(message)

    def say_wheels(self, stamp: Any, angles: Sequence[float], speeds: Sequence[float]) -> None:
        if wanted(self._joints):
            message = self._turned
            message.header.stamp = stamp
            message.position, message.velocity = angles, speeds
            self._joints.publish(message)

    def say_battery(self, stamp: Any, charge: float) -> None:
        message = self._charged
        message.header.stamp = stamp
        message.percentage = math.nan if charge < 0.0 else single(charge)
        self._battery.publish(message)

    def transforms(
        self, stamp: Any, correction: Sequence[float] | None, pose: Sequence[float], angles: Sequence[float]
    ) -> tuple[Any, ...]:
        """Return odom -> base_link -> wheels, and where the tracker has seen the robot map -> odom."""
        for wheel, angle in zip(self._wheels, angles, strict=True):
            wheel.header.stamp = stamp
            wheel.transform.rotation.y, wheel.transform.rotation.w = math.sin(angle / 2.0), math.cos(angle / 2.0)
        moved = _transform(self._from_odom, stamp, pose), *self._wheels
        return moved if correction is None else (_transform(self._from_map, stamp, correction), *moved)


def _place(message: Any, pose: Sequence[float]) -> None:
    message.position.x, message.position.y, psi = pose
    message.orientation.z, message.orientation.w = math.sin(psi / 2.0), math.cos(psi / 2.0)


def _transform(message: Any, stamp: Any, pose: Sequence[float]) -> Any:
    message.header.stamp = stamp
    way, turn = message.transform.translation, message.transform.rotation
    way.x, way.y, psi = pose
    turn.z, turn.w = math.sin(psi / 2.0), math.cos(psi / 2.0)
    return message

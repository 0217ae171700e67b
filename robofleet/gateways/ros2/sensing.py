"""What robots sense beside their wheels, of those that tell it (``robots[].sensors``)."""

import math
from typing import Any

import numpy as np

from robofleet.bus import sensors
from robofleet.bus.keys import SENSORS
from robofleet.bus.observer import Observer, Source
from robofleet.config.robots import Robot
from robofleet.config.sensors import SensorSettings
from robofleet.config.tree import Config
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph, single
from robofleet.gateways.urdf import BASE
from robofleet.vehicles.readings import SensorReading

_NOT_MEASURED_COVARIANCE = -1.0  # its first element: sensor_msgs/Imu
_MICROTESLA_T = 1e-6


class Sensing:
    """All robots that tell of their sensors."""

    def __init__(self, graph: Graph, config: Config, names: dict[str, str], observer: Observer) -> None:
        self._graph, self._observer = graph, observer
        observer.declare([(SENSORS, unit) for unit in config.sensing], sensors.decoded)
        self._units = {
            unit: {
                index: _Sensors(graph, names[robot], config.robot(robot))
                for index, robot in enumerate(config.units[unit])
                if config.robot(robot).sensors
            }
            for unit in config.sensing
        }

    def step(self, _now_ns: int, updated: set[Source]) -> None:
        for unit, robots in self._units.items():
            if (source := (SENSORS, unit)) in updated:
                stamp = self._graph.stamp(self._observer.arrival_ns(source))
                for index, reading in self._observer[source][1].items():
                    if index in robots:
                        robots[index].say(stamp, reading)


class _Sensors:
    """One robot's. What of it there is, its kind of robot says."""

    def __init__(self, graph: Graph, name: str, robot: Robot) -> None:
        kind = robot.vehicle.sensors
        assert kind is not None
        self._kind, self._base, self._messages = kind, graph.frames.link(name, BASE), graph.messages
        self._imu = graph.publisher(topics.IMU, name) if kind.gyro or kind.accelerometer else None
        self._magnetic = graph.publisher(topics.MAGNETIC, name) if kind.magnetometer else None
        self._field = _field(graph, kind, self._base)
        self._ranges = [
            (graph.publisher(topics.RANGE, name, number), message)
            for number, message in enumerate(_ranges(graph, kind, name))
        ]

    def say(self, stamp: Any, reading: SensorReading) -> None:
        if self._imu is not None and not (reading.gyro is None and reading.accelerometer is None):
            imu = _imu(self._messages.Imu(), self._kind, reading)
            imu.header.stamp, imu.header.frame_id = stamp, self._base
            self._imu.publish(imu)
        if self._magnetic is not None and reading.magnetometer is not None:
            self._field.header.stamp, field = stamp, self._field.magnetic_field
            field.x, field.y, field.z = reading.magnetometer
            self._magnetic.publish(self._field)
        for (publisher, imu), distance in zip(self._ranges, reading.distances or (), strict=False):
            imu.header.stamp = stamp
            imu.range = math.inf if math.isnan(distance) else single(distance)  # REP 117: it sees nothing
            publisher.publish(imu)


def _imu(message: Any, kind: SensorSettings, reading: SensorReading) -> Any:
    """Fill in what a reading tells; a part that it does not tell is not measured."""
    message.orientation_covariance[0] = _NOT_MEASURED_COVARIANCE
    if reading.gyro is None:
        message.angular_velocity_covariance[0] = _NOT_MEASURED_COVARIANCE
    else:
        turning = message.angular_velocity
        turning.x, turning.y, turning.z = reading.gyro
        if kind.gyro is not None:
            message.angular_velocity_covariance[:] = np.diag(np.square(kind.gyro.noise_rad_s)).ravel()
    if reading.accelerometer is None:
        message.linear_acceleration_covariance[0] = _NOT_MEASURED_COVARIANCE
    else:
        force = message.linear_acceleration
        force.x, force.y, force.z = reading.accelerometer
        if kind.accelerometer is not None:
            message.linear_acceleration_covariance[:] = np.diag(np.square(kind.accelerometer.noise_m_s2)).ravel()
    return message


def _field(graph: Graph, kind: SensorSettings, frame: str) -> Any:
    message = graph.messages.MagneticField()
    message.header.frame_id = frame
    if kind.magnetometer is not None:
        noise_t = _MICROTESLA_T * np.array(kind.magnetometer.noise_ut)
        message.magnetic_field_covariance[:] = np.diag(np.square(noise_t)).ravel()
    return message


def _ranges(graph: Graph, kind: SensorSettings, name: str) -> list[Any]:
    """Return a message of each distance sensor: a ray."""
    if kind.distances is None:
        return []
    found, kind_of_message = [], graph.messages.Range
    for number in range(len(kind.distances.places)):
        message = kind_of_message(radiation_type=kind_of_message.INFRARED, max_range=kind.distances.range_m)
        message.header.frame_id = graph.frames.link(name, f"range_{number}")
        found.append(message)
    return found


def places(graph: Graph, robot: Robot, name: str, stamp: Any) -> list[Any]:
    """Return where a robot's distance sensors are."""
    kind = robot.vehicle.sensors
    if kind is None or kind.distances is None or not robot.sensors:
        return []
    found, frames = [], graph.frames
    for number, at in enumerate(kind.distances.places):
        message = graph.messages.TransformStamped(child_frame_id=frames.link(name, f"range_{number}"))
        message.header.stamp, message.header.frame_id = stamp, frames.link(name, BASE)
        message.transform.translation.x, message.transform.translation.y = at.x_m, at.y_m
        turn, half = message.transform.rotation, math.radians(at.heading_deg) / 2.0
        turn.z, turn.w = math.sin(half), math.cos(half)
        found.append(message)
    return found

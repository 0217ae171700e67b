"""What a run's robots measured with their sensors, in columns: ``sensors.csv``."""

from io import BufferedWriter, TextIOWrapper
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus import sensors
from robofleet.bus.keys import SENSORS, key
from robofleet.core.arrays import Array
from robofleet.core.files import replaced
from robofleet.recording.run import Recording

CSV = "sensors.csv"
_AXES = "xyz"


class SensorColumns(NamedTuple):
    """The readings (K,) of one robot; NaN: it has no such sensor, or a distance sensor saw nothing.

    Robot frame: x ahead, y to the left, z up.
    """

    stamp_ns: NDArray[np.int64]  # (K,) [unit's clock]
    gyro: Array  # (K, 3) [rad/s]
    accelerometer: Array  # (K, 3) [m/s^2]; at rest z is +9.8
    magnetometer: Array  # (K, 3) [T]
    heading: Array  # (K,) [rad; CCW +, from a zero of its own]
    distances: Array  # (K, M) [m]


def columns(recording: Recording, robot: str) -> SensorColumns:
    """Return what a robot's sensors measured; nothing (K = 0) of a robot whose sensors were not read."""
    config = recording.config
    unit = config.unit_of[robot]
    index = config.units[unit].index(robot)
    payloads = recording.messages.get(key(config.arena.name, SENSORS, unit), ())
    decoded = [message for payload in payloads if (message := sensors.decoded(payload)) is not None]
    own = [(stamp_ns, readings[index]) for stamp_ns, readings in decoded if index in readings]
    most = max((len(reading.distances or ()) for _, reading in own), default=0)

    def rows(part: str, count: int) -> Array:
        filled = np.full((len(own), count), np.nan)
        for row, (_, reading) in zip(filled, own, strict=True):
            if (values := getattr(reading, part)) is not None:
                row[: np.size(values)] = values
        return filled

    return SensorColumns(
        np.array([stamp_ns for stamp_ns, _ in own], np.int64), rows("gyro", 3), rows("accelerometer", 3),
        rows("magnetometer", 3), rows("heading", 1)[:, 0], rows("distances", most),
    )  # fmt: skip


def write_csv(recording: Recording, file: Path) -> None:
    """Write one row a reading, robot after robot; what was not measured is empty."""
    config = recording.config
    robot_columns = {robot.id: columns(recording, robot.id) for robot in config.robots if robot.sensors}
    most = max((column.distances.shape[1] for column in robot_columns.values()), default=0)
    units = ("gyro", "rad_s"), ("accelerometer", "m_s2"), ("magnetometer", "t")
    names = [f"{part}_{axis}_{unit}" for part, unit in units for axis in _AXES]
    distances = [f"distance_{number}_m" for number in range(1, most + 1)]
    with replaced(file) as stream, TextIOWrapper(BufferedWriter(stream), encoding="ascii") as out:
        out.write(",".join(["robot", "stamp_s", *names, "heading_rad", *distances]) + "\n")
        for robot, column in robot_columns.items():
            unseen = np.full((len(column.heading), most - column.distances.shape[1]), np.nan)
            values = np.column_stack([*column[1:], unseen])
            for stamp_ns, row in zip(column.stamp_ns.tolist(), values.tolist(), strict=True):
                numbers = ",".join("" if number != number else f"{number:.6g}" for number in row)  # noqa: PLR0124
                out.write(f"{robot},{stamp_ns * 1e-9:.3f},{numbers}\n")

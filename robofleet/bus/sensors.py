"""What a unit says of its robots' sensors, and what that means."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import UNIT_SENSORS
from robofleet.vehicles.readings import SensorReading
from robofleet.vehicles.sensors import numbers, packed, unpacked

SensorMessage = tuple[NDArray[Any], NDArray[np.float64]]  # whose numbers they are (n,), as RobotSensors; the numbers


def said(readings: Iterable[tuple[int, SensorReading]]) -> SensorMessage:
    robots, values = [], list[float]()
    for index, reading in readings:
        parts, distances, own = packed(reading)
        robots.append((index, parts, distances))
        values += own
    return np.array(robots, UNIT_SENSORS.item_dtype), np.array(values, np.float64)


def encoded(seq: int, stamp_ns: int, message: SensorMessage) -> bytes:
    robots, values = message
    return UNIT_SENSORS.encode_array((seq, stamp_ns), robots, values.astype("<f8", copy=False).tobytes())


def decoded(payload: bytes) -> tuple[int, dict[int, SensorReading]] | None:
    """Return the instant [ns; unit's clock], and the readings by the robots' places; None of what says nothing."""
    message = UNIT_SENSORS.decode(payload)
    if message is None:
        return None
    readings, at = {}, 0
    for index, parts, distances in message.robots:
        count = numbers(parts, distances)
        if at + count > len(message.numbers):
            return None
        readings[index] = unpacked(parts, distances, message.numbers[at : at + count])
        at += count
    return (message.stamp_ns, readings) if at == len(message.numbers) else None

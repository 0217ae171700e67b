"""The bytes that a microcontroller reads and writes: changing one of these needs a new version."""

import struct
from typing import Any

import pytest

from robofleet.bus import keys, sensors
from robofleet.bus import messages as m
from robofleet.bus.keys import TOPICS, key
from robofleet.bus.layouts import VERSION, ListLayout
from robofleet.core.settings import ROBOTS
from robofleet.safety.gate import LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.readings import SensorReading

MOST = 2**64 - 1
APPLIED = (*range(7, 16), -17, -18, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, -1.0)
OTHERS = (*range(27, 36), -37, -38, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9)
SENSED = m.UnitSensors(2, -3, (m.RobotSensors(4, 9, 1), m.RobotSensors(5, 0, 2)), (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7))
MESSAGES: list[tuple[Any, Any, str]] = [  # a layout, a message, and its form as ``struct`` has it after the version
    (m.UNIT_COMMAND, m.UnitCommand(2, 3, MOST, 4, -5, (m.WheelCommand(6, 1.5, -2.5), m.WheelCommand(MOST, 0.0, 3.5))),
     "QQQqq H QddQdd"),
    (m.UNIT_ENABLE, m.UnitEnable(2, 3, -4, 5, (m.Enable(6, 7, 8, 9.5), m.Enable(10, 11, 12, 13.5))), "QQqB H QBQdQBQd"),
    (m.UNIT_STATUS, m.UnitStatus(2, 3, 4, -5, -6, 1, (m.RobotStatus(*APPLIED), m.RobotStatus(*OTHERS))),
     "QIQqqB H" + 2 * "QQqqQBBQIqqddddddddd"),
    (m.UNIT_TRUTH, m.UnitTruth(2, -3, (m.Truth(4, 0.1, 0.2, 0.3, 0.4, 0.5), m.Truth(6, 1.1, 1.2, 1.3, 1.4, 1.5))),
     "Qq H HdddddHddddd"),
    (m.UNIT_SENSORS, SENSED, "Qq H HBBHBB 7d"),
    (m.LEASE_REQUEST, m.LeaseRequest(MOST, 1), "QB"),
    (m.UNIT_LEASES, m.UnitLeases((m.LeaseAnswer(1, 3, MOST), m.LeaseAnswer(0, 4, 5))), " H BQQBQQ"),
    (m.RUN_STATE, m.RunState(2, 3, 4, 5, 6, 7.5, 8, (m.RobotState(1, 0, 11, 1), m.RobotState(0, 1, 12, 2))),
     "IQBHHdB H BBHBBBHB"),
    (m.BUSY_MACHINE, m.BusyMachine(2, 3, 4, 1, 5, 6, 7, 8.5, (m.Late(9, 10, -1),)), "IQHBIIHd H Hqq"),
]  # fmt: skip


@pytest.mark.parametrize(("layout", "message", "form"), MESSAGES, ids=lambda value: type(value).__name__)
def test_a_message_has_these_bytes(layout: Any, message: Any, form: str) -> None:
    numbers: list[float] = []
    for value in message:
        rows = value if isinstance(value, tuple) else None
        if rows is None:
            numbers.append(value)
        elif rows and not isinstance(rows[0], tuple):
            numbers += rows  # after all items
        else:
            numbers += [len(rows), *(number for row in rows for number in row)]
    assert VERSION == 6
    assert layout.encode(message) == struct.pack(f"<B{form}", 6, *numbers)


def test_what_sensors_say() -> None:
    payload = m.UNIT_SENSORS.encode(SENSED)
    first = SensorReading(gyro=(0.1, 0.2, 0.3), heading=0.4, distances=(0.5,))
    assert sensors.decoded(payload) == (-3, {4: first, 5: SensorReading(distances=(0.6, 0.7))})
    assert sensors.encoded(2, -3, sensors.said([(4, first), (5, SensorReading(distances=(0.6, 0.7)))])) == payload
    assert sensors.decoded(payload[:-8]) is sensors.decoded(payload + bytes(8)) is None


def test_what_a_gate_says_in_numbers() -> None:
    """They are on the wire, and on the disk: a number that was given is never given again."""
    assert [(status.name, status.value) for status in GateStatus] == [
        ("OPEN", 0), ("NO_COMMAND", 1), ("NO_ENABLE", 2), ("LATCHED", 3), ("NO_LEASE", 4),
    ]  # fmt: skip
    assert [(latch.name, latch.value) for latch in Latch] == [
        ("NONE", 0), ("DRILL", 1), ("EMERGENCY_STOP", 2), ("WIRED_STOP", 3), ("DRIVER_FAILED", 4), ("MEMORY_LOST", 5),
        ("ROBOT_FAULT", 6), ("RUNAWAY", 7),
    ]  # fmt: skip
    assert [(action.name, action.value) for action in LeaseAction] == [("ACQUIRE", 1), ("TAKE_OVER", 2), ("RELEASE", 3)]


KEYS = {
    keys.COMMAND: "unit/r1/cmd", keys.STATUS: "unit/r1/status", keys.ENABLE: "unit/r1/enable",
    keys.LEASE: "unit/r1/lease", keys.POSES: "poses/r1", keys.TICK: "tick", keys.STATE: "state",
    keys.TRUTH: "sim/r1/truth", keys.REQUEST: "request/r1", keys.ALIVE: "alive/r1",
}  # fmt: skip


def test_keys() -> None:
    assert {topic: key("lab", topic, "r1") for topic in KEYS} == {t: f"rf/lab/{tail}" for t, tail in KEYS.items()}


def test_two_names_never_share_a_key() -> None:
    keys = {key(arena, topic, name) for topic in TOPICS for arena in ("a", "b") for name in ("r1", "r2")}
    unnamed = sum("{}" not in topic.key for topic in TOPICS)
    assert len(keys) == 2 * (2 * (len(TOPICS) - unnamed) + unnamed)


def test_only_what_is_rare_may_be_reliable() -> None:
    """The control path drops what is late."""
    assert [topic for topic in KEYS if topic.reliable] == [keys.LEASE, keys.STATE, keys.REQUEST, keys.ALIVE]


def test_the_largest_fleet_fits_into_every_message() -> None:
    for topic in TOPICS:
        if isinstance(topic.layout, ListLayout):
            assert topic.layout.dtype(ROBOTS).itemsize <= topic.largest, topic.key

"""The bytes that a microcontroller reads and writes: changing one of these needs a new version."""

import struct

from robofleet.bus import sensors
from robofleet.bus.keys import ALIVE, COMMAND, ENABLE, LEASE, POSES, REQUEST, STATE, STATUS, TICK, TOPICS, TRUTH, key
from robofleet.bus.layouts import ListLayout
from robofleet.bus.messages import (
    BUSY_MACHINE,
    LEASE_REQUEST,
    RUN_STATE,
    UNIT_COMMAND,
    UNIT_ENABLE,
    UNIT_LEASES,
    UNIT_SENSORS,
    UNIT_STATUS,
    UNIT_TRUTH,
    BusyMachine,
    Enable,
    Late,
    LeaseAnswer,
    LeaseRequest,
    RobotSensors,
    RobotState,
    RobotStatus,
    RunState,
    Truth,
    UnitCommand,
    UnitEnable,
    UnitLeases,
    UnitSensors,
    UnitStatus,
    UnitTruth,
    WheelCommand,
)
from robofleet.core.settings import ROBOTS
from robofleet.safety.gate import LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.readings import SensorReading


def test_a_command() -> None:
    message = UnitCommand(2, 3, 2**64 - 1, 4, -5, (WheelCommand(6, 1.5, -2.5), WheelCommand(2**64 - 1, 0.0, 3.5)))
    head = struct.pack("<BQQQqqH", 6, 2, 3, 2**64 - 1, 4, -5, 2)
    assert UNIT_COMMAND.encode(message) == head + struct.pack("<QddQdd", 6, 1.5, -2.5, 2**64 - 1, 0.0, 3.5)


def test_an_enable() -> None:
    message = UnitEnable(2, 3, -4, 5, (Enable(6, 7, 8, 9.5), Enable(10, 11, 12, 13.5)))
    head = struct.pack("<BQQqBH", 6, 2, 3, -4, 5, 2)
    assert UNIT_ENABLE.encode(message) == head + struct.pack("<QBQdQBQd", 6, 7, 8, 9.5, 10, 11, 12, 13.5)


def test_a_status() -> None:
    values = (*range(7, 16), -17, -18, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, -1.0)
    others = (*range(27, 36), -37, -38, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9)
    message = UnitStatus(2, 3, 4, -5, -6, 1, (RobotStatus(*values), RobotStatus(*others)))
    head, item = struct.pack("<BQIQqqBH", 6, 2, 3, 4, -5, -6, 1, 2), "<QQqqQBBQIqqddddddddd"
    assert UNIT_STATUS.encode(message) == head + struct.pack(item, *values) + struct.pack(item, *others)


def test_a_truth() -> None:
    message = UnitTruth(2, -3, (Truth(4, 0.1, 0.2, 0.3, 0.4, 0.5), Truth(6, 1.1, 1.2, 1.3, 1.4, 1.5)))
    items = struct.pack("<HdddddHddddd", 4, 0.1, 0.2, 0.3, 0.4, 0.5, 6, 1.1, 1.2, 1.3, 1.4, 1.5)
    assert UNIT_TRUTH.encode(message) == struct.pack("<BQqH", 6, 2, -3, 2) + items


def test_what_sensors_say() -> None:
    message = UnitSensors(2, -3, (RobotSensors(4, 9, 1), RobotSensors(5, 0, 2)), (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7))
    items = struct.pack("<HBBHBB", 4, 9, 1, 5, 0, 2)
    payload = struct.pack("<BQqH", 6, 2, -3, 2) + items + struct.pack("<7d", *message.numbers)
    assert UNIT_SENSORS.encode(message) == payload
    first = SensorReading(gyro=(0.1, 0.2, 0.3), heading=0.4, distances=(0.5,))
    assert sensors.decoded(payload) == (-3, {4: first, 5: SensorReading(distances=(0.6, 0.7))})
    assert sensors.encoded(2, -3, sensors.said([(4, first), (5, SensorReading(distances=(0.6, 0.7)))])) == payload
    assert sensors.decoded(payload[:-8]) is None
    assert sensors.decoded(payload + bytes(8)) is None


def test_a_lease() -> None:
    assert LEASE_REQUEST.encode(LeaseRequest(2**64 - 1, 1)) == struct.pack("<BQB", 6, 2**64 - 1, 1)
    answer = UnitLeases((LeaseAnswer(1, 3, 2**64 - 1), LeaseAnswer(0, 4, 5)))
    assert UNIT_LEASES.encode(answer) == struct.pack("<BHBQQBQQ", 6, 2, 1, 3, 2**64 - 1, 0, 4, 5)


def test_a_run_state() -> None:
    message = RunState(2, 3, 4, 5, 6, 7.5, 8, (RobotState(1, 0, 11, 1), RobotState(0, 1, 12, 2)))
    head = struct.pack("<BIQBHHdBH", 6, 2, 3, 4, 5, 6, 7.5, 8, 2)
    assert RUN_STATE.encode(message) == head + struct.pack("<BBHBBBHB", 1, 0, 11, 1, 0, 1, 12, 2)


def test_a_busy_machine() -> None:
    message = BusyMachine(2, 3, 4, 1, 5, 6, 7, 8.5, (Late(9, 10, -1),))
    assert BUSY_MACHINE.encode(message) == struct.pack("<BIQHBIIHdHHqq", 6, 2, 3, 4, 1, 5, 6, 7, 8.5, 1, 9, 10, -1)


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


def test_keys() -> None:
    assert key("lab", COMMAND, "r1") == "rf/lab/unit/r1/cmd"
    assert key("lab", STATUS, "r1") == "rf/lab/unit/r1/status"
    assert key("lab", ENABLE, "r1") == "rf/lab/unit/r1/enable"
    assert key("lab", LEASE, "r1") == "rf/lab/unit/r1/lease"
    assert key("lab", POSES, "overhead") == "rf/lab/poses/overhead"
    assert key("lab", TICK) == "rf/lab/tick"
    assert key("lab", STATE) == "rf/lab/state"
    assert key("lab", TRUTH, "r1") == "rf/lab/sim/r1/truth"
    assert key("lab", REQUEST, "supervisor") == "rf/lab/request/supervisor"
    assert key("lab", ALIVE, "driver/1f") == "rf/lab/alive/driver/1f"


def test_two_names_never_share_a_key() -> None:
    keys = {key(arena, topic, name) for topic in TOPICS for arena in ("a", "b") for name in ("r1", "r2")}
    unnamed = sum("{}" not in topic.key for topic in TOPICS)
    assert len(keys) == 2 * (2 * (len(TOPICS) - unnamed) + unnamed)


def test_only_what_is_rare_may_be_reliable() -> None:
    """The control path drops what is late."""
    assert not any(topic.reliable for topic in (COMMAND, STATUS, ENABLE, POSES, TICK, TRUTH))
    assert STATE.reliable
    assert REQUEST.reliable
    assert LEASE.reliable


def test_the_largest_fleet_fits_into_every_message() -> None:
    for topic in TOPICS:
        if isinstance(topic.layout, ListLayout):
            assert topic.layout.dtype(ROBOTS).itemsize <= topic.largest, topic.key

"""The bytes that a microcontroller reads and writes: changing one of these needs a new version."""

import struct

from robofleet.comms.keys import (
    ALIVE,
    COMMAND,
    ENABLE,
    LEASE,
    POSES,
    REQUEST,
    STATE,
    STATUS,
    TICK,
    TOPICS,
    TRUTH,
    key,
)
from robofleet.comms.messages import (
    BUSY_MACHINE,
    LEASE_ANSWER,
    LEASE_REQUEST,
    ROBOT_STATUS,
    RUN_STATE,
    WHEEL_COMMAND,
    BusyMachine,
    Enable,
    Late,
    LeaseAnswer,
    LeaseRequest,
    RobotState,
    RobotStatus,
    RunState,
    WheelCommand,
)
from robofleet.comms.messages import (
    ENABLE as ENABLE_LAYOUT,
)
from robofleet.safety.gate import GateStatus, Latch, LeaseAction


def test_a_wheel_command() -> None:
    message = WheelCommand(2, 3, 4, 2**64 - 1, 5, -6, 1.5, -2.5)
    assert WHEEL_COMMAND.encode(message) == struct.pack("<BQQQQQqdd", 5, 2, 3, 4, 2**64 - 1, 5, -6, 1.5, -2.5)


def test_an_enable() -> None:
    values = (2, 3, 4, 5, 6, 7, 8, 9.5)
    assert ENABLE_LAYOUT.encode(Enable(*values)) == struct.pack("<BQQQQBBQd", 5, *values)


def test_a_status() -> None:
    values = (*range(2, 17), -17, -18, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, -1.0)
    assert ROBOT_STATUS.encode(RobotStatus(*values)) == struct.pack("<BQQIQQQqqqQBBQBIqqddddddddd", 5, *values)


def test_a_lease() -> None:
    assert LEASE_REQUEST.encode(LeaseRequest(2**64 - 1, 1)) == struct.pack("<BQB", 5, 2**64 - 1, 1)
    assert LEASE_ANSWER.encode(LeaseAnswer(1, 3, 2**64 - 1)) == struct.pack("<BBQQ", 5, 1, 3, 2**64 - 1)


def test_a_run_state() -> None:
    message = RunState(2, 3, 4, 5, 6, 7.5, 8, (RobotState(1, 0, 11, 1), RobotState(0, 1, 12, 2)))
    head = struct.pack("<BIQBHHdBH", 5, 2, 3, 4, 5, 6, 7.5, 8, 2)
    assert RUN_STATE.encode(message) == head + struct.pack("<BBHBBBHB", 1, 0, 11, 1, 0, 1, 12, 2)


def test_a_busy_machine() -> None:
    message = BusyMachine(2, 3, 4, 1, 5, 6, 7, 8.5, (Late(9, 10, -1),))
    assert BUSY_MACHINE.encode(message) == struct.pack("<BIQHBIIHdHHqq", 5, 2, 3, 4, 1, 5, 6, 7, 8.5, 1, 9, 10, -1)


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
    assert key("lab", COMMAND, "r1") == "rf/lab/robot/r1/cmd"
    assert key("lab", STATUS, "r1") == "rf/lab/robot/r1/status"
    assert key("lab", ENABLE, "r1") == "rf/lab/robot/r1/enable"
    assert key("lab", LEASE, "r1") == "rf/lab/robot/r1/lease"
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

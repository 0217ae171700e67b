"""The bytes that a microcontroller reads and writes: changing one of these needs a new version."""

import struct

from robofleet.comms.keys import (
    ALIVE,
    COMMAND,
    ENABLE,
    POSES,
    REQUEST,
    STATE,
    STATUS,
    TICK,
    TOPICS,
    TRUTH,
    everything,
    key,
)
from robofleet.comms.messages import (
    ENABLE as ENABLE_LAYOUT,
)
from robofleet.comms.messages import (
    ROBOT_STATUS,
    WHEEL_COMMAND,
    Enable,
    RobotStatus,
    WheelCommand,
)


def test_a_wheel_command() -> None:
    message = WheelCommand(2, 3, 2**64 - 1, 5, -6, 1.5, -2.5)
    assert WHEEL_COMMAND.encode(message) == struct.pack("<BIIQQqdd", 1, 2, 3, 2**64 - 1, 5, -6, 1.5, -2.5)


def test_an_enable() -> None:
    assert ENABLE_LAYOUT.encode(Enable(2, 3, 4, 5, 6)) == struct.pack("<BIIQQB", 1, 2, 3, 4, 5, 6)


def test_a_status() -> None:
    values = (2, 3, 4, 5, 6, 7, 8, 9, 1, 11, 0.1, 0.2, 0.3, 0.4, -1.0)
    assert ROBOT_STATUS.encode(RobotStatus(*values)) == struct.pack("<BIIQQqqqIBIddddd", 1, *values)


def test_keys() -> None:
    assert key("lab", COMMAND, "r1") == "rf/lab/robot/r1/cmd"
    assert key("lab", STATUS, "r1") == "rf/lab/robot/r1/status"
    assert key("lab", ENABLE, "r1") == "rf/lab/robot/r1/enable"
    assert key("lab", POSES, "overhead") == "rf/lab/poses/overhead"
    assert key("lab", TICK) == "rf/lab/tick"
    assert key("lab", STATE) == "rf/lab/state"
    assert key("lab", TRUTH, "r1") == "rf/lab/sim/r1/truth"
    assert key("lab", REQUEST, "supervisor") == "rf/lab/request/supervisor"
    assert key("lab", ALIVE, "driver/1f") == "rf/lab/alive/driver/1f"
    assert everything("lab") == "rf/lab/**"


def test_two_names_never_share_a_key() -> None:
    keys = {key(arena, topic, name) for topic in TOPICS for arena in ("a", "b") for name in ("r1", "r2")}
    unnamed = sum("{}" not in topic.key for topic in TOPICS)
    assert len(keys) == 2 * (2 * (len(TOPICS) - unnamed) + unnamed)


def test_only_what_is_rare_may_be_reliable() -> None:
    """The control path drops what is late."""
    assert not any(topic.reliable for topic in (COMMAND, STATUS, ENABLE, POSES, TICK, TRUTH))
    assert STATE.reliable
    assert REQUEST.reliable

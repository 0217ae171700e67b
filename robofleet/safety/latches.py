"""The status and the latches of a gate. This module does not import numpy, so that `robofleet stop` starts fast."""

from enum import IntEnum


class GateStatus(IntEnum):
    """Why the wheels may move, or why they may not."""

    OPEN = 0
    NO_COMMAND = 1
    NO_ENABLE = 2
    LATCHED = 3
    NO_LEASE = 4


class Latch(IntEnum):
    """What holds a gate closed until somebody who may clears it."""

    NONE = 0
    DRILL = 1  # the e-stop, tried before a run; a restart of the driver forgets it
    EMERGENCY_STOP = 2
    WIRED_STOP = 3  # the robot's own e-stop input
    DRIVER_FAILED = 4  # the robot could not be written to or read from
    MEMORY_LOST = 5  # nobody knows what held it before its driver was started again
    ROBOT_FAULT = 6  # the robot says what is wrong with it
    RUNAWAY = 7  # a wheel turns that is told to stand

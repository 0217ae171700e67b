"""The last gate before a robot's wheels. It allows or refuses; it never repairs.

Freshness without comparing clocks: a driver's status carries a nonce (its own clock's reading, opaque to everybody
else) and the boot id that it drew when it started. Commands and enables echo both. What is accepted is valid until
its nonce is 120 ms old, whenever it arrived: a network that stops and resumes delivers nothing old. A refused
message changes a counter and feeds no watchdog.
"""

import math
from enum import IntEnum
from typing import NamedTuple

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds

VALID_NS = 120_000_000
_TOLERANCE = 1.01  # of a limit; more is refused, not clamped


class GateStatus(IntEnum):
    """Why the wheels may move, or why they may not."""

    OPEN = 0
    NO_COMMAND = 1
    NO_ENABLE = 2


class Command(NamedTuple):
    """A decoded motion command."""

    boot_id: int
    nonce: int
    wheels: WheelSpeeds


class Permission(NamedTuple):
    """A decoded enable."""

    boot_id: int
    nonce: int
    running: bool


class GateState(NamedTuple):
    """What the gate remembers: the newest command and until when it and the permission hold [driver's clock, ns]."""

    boot_id: int
    wheels: WheelSpeeds = STOP
    command_until_ns: int = 0
    enable_until_ns: int = 0
    refused: int = 0


class GateOutput(NamedTuple):
    """What goes to the wheels, why, and when the gate must be asked again at the latest."""

    target: WheelSpeeds
    status: GateStatus
    deadline_ns: int | None


def step(
    state: GateState,
    drive: DifferentialDrive,
    command: Command | None,
    permission: Permission | None,
    now_ns: int,
) -> tuple[GateState, GateOutput]:
    """Take what arrived since the last step and return the wheel speeds that are allowed now."""
    if command is not None:
        if _fresh(state, command.boot_id, command.nonce, now_ns) and _within(drive, command.wheels):
            state = state._replace(wheels=command.wheels, command_until_ns=command.nonce + VALID_NS)
        else:
            state = state._replace(refused=state.refused + 1)
    if permission is not None:
        if _fresh(state, permission.boot_id, permission.nonce, now_ns):
            until = permission.nonce + VALID_NS if permission.running else 0
            state = state._replace(enable_until_ns=until)
        else:
            state = state._replace(refused=state.refused + 1)
    return state, _output(state, now_ns)


def _output(state: GateState, now_ns: int) -> GateOutput:
    if now_ns >= state.enable_until_ns:
        return GateOutput(STOP, GateStatus.NO_ENABLE, None)
    if now_ns >= state.command_until_ns:
        return GateOutput(STOP, GateStatus.NO_COMMAND, None)
    return GateOutput(state.wheels, GateStatus.OPEN, min(state.enable_until_ns, state.command_until_ns))


def _fresh(state: GateState, boot_id: int, nonce: int, now_ns: int) -> bool:
    return boot_id == state.boot_id and nonce <= now_ns < nonce + VALID_NS


def _within(drive: DifferentialDrive, wheels: WheelSpeeds) -> bool:
    left, right = wheels
    if not (math.isfinite(left) and math.isfinite(right)):
        return False
    if max(abs(left), abs(right)) > _TOLERANCE * drive.max_wheel_speed:
        return False
    return drive.wheel_radius * abs(left + right) / 2.0 <= _TOLERANCE * drive.max_speed

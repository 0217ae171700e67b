"""The last gate before a robot's wheels. It allows or refuses; it never repairs.

Freshness without comparing clocks: a driver's status carries a nonce (its own clock's reading, opaque to everybody
else) and the boot id that it drew when it started. Commands and enables echo both. What is accepted is valid until
its nonce is 120 ms old, whenever it arrived: a network that stops and resumes delivers nothing old. A refused
message changes a counter and feeds no watchdog.

The target is what is allowed now: the command, or zero. The output, which is what the wheels are given, follows it
with limited acceleration, along the straight line between the two: towards zero both wheels fall by one ratio, so a
robot that stops stays on its arc and neither wheel reverses.
"""

from enum import IntEnum
from typing import NamedTuple

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds

VALID_NS = 120_000_000
LAPSE_NS = 1_000_000_000  # a lease whose holder gave no command for so long is free, if the robot is at rest
RAMP_NS = 5_000_000  # while the output is on its way it is renewed so often
_LONGEST_RAMP_NS = 20_000_000  # what a process that was held up may catch up with in one step
_TOLERANCE = 1.01  # of a limit; more is refused, not clamped
_NEVER = -1


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


class LeaseAction(IntEnum):
    """What a controller asks of a driver."""

    ACQUIRE = 1
    TAKE_OVER = 2  # also from a controller that is alive
    RELEASE = 3


class Refusal(IntEnum):
    """Why a message was refused."""

    NOTHING = 0
    BOOT = 1  # it answers another start of this driver
    STALE = 2  # its nonce is too old, or of the future
    EPOCH = 3  # of another lease
    SESSION = 4  # of a controller that has no lease
    SEQUENCE = 5  # not above the last
    LIMIT = 6  # faster than the robot may go


class Command(NamedTuple):
    """A decoded motion command."""

    epoch: int
    session: int
    seq: int
    boot_id: int
    nonce: int
    wheels: WheelSpeeds


class Permission(NamedTuple):
    """A decoded enable."""

    epoch: int
    seq: int
    boot_id: int
    nonce: int
    latch: Latch
    clear: int  # latch id
    limit: float  # fastest wheel [rad/s]; 0: none


class Inputs(NamedTuple):
    """What came since the last step."""

    command: Command | None = None
    permission: Permission | None = None
    lease: tuple[int, LeaseAction] | None = None  # a session, and what it asks
    latch: Latch = Latch.NONE  # the robot's own reason to stop
    turning: bool = False  # a wheel turns, as measured


class GateState(NamedTuple):
    """What the gate remembers. Instants and nonces [driver's clock, ns]; wheels [rad/s]."""

    boot_id: int
    epoch: int = 0  # of the lease; survives a restart
    latch: Latch = Latch.NONE  # survives a restart, but for a drill
    latch_id: int = 0  # survives a restart
    session: int = 0  # of the controller that holds the lease; 0: nobody
    heard_ns: int = 0  # when the holder was granted the lease, or gave a command
    seq: int = 0  # of the command accepted last, in this epoch
    command_nonce: int = _NEVER
    wheels: WheelSpeeds = STOP
    enabled: tuple[int, int] = (_NEVER, 0)  # nonce and sequence number of the permission accepted last
    limit: float = 0.0
    output: WheelSpeeds = STOP
    at_ns: int = 0  # of the last step
    moving: bool = False  # the target was not zero in the last step
    target_after_ns: int = _NEVER  # last stop: nonce's issue to zero target
    output_after_ns: int = _NEVER  # and to zero output
    refused: int = 0
    why: Refusal = Refusal.NOTHING  # of the newest refusal


class GateOutput(NamedTuple):
    """What the wheels are given, and why; what to keep and to answer; when to ask again at the latest."""

    output: WheelSpeeds
    target: WheelSpeeds
    status: GateStatus
    applied: bool  # the command of this step was accepted and is the target
    granted: bool | None  # the answer to a lease request; None: there was none
    keep: bool  # epoch or latch changed: they must be on disk before an answer goes out
    deadline_ns: int | None


def step(state: GateState, drive: DifferentialDrive, inputs: Inputs, now_ns: int) -> tuple[GateState, GateOutput]:
    """Take what arrived since the last step and return the wheel speeds that are allowed now."""
    before = state
    if now_ns < state.at_ns:  # time ran backwards: nothing that was said counts any more
        state = state._replace(boot_id=state.boot_id + 1, command_nonce=_NEVER, enabled=(_NEVER, 0), limit=0.0)
    if inputs.latch:
        state = _latched(state, inputs.latch)
    if inputs.permission is not None:
        state = _take_permission(state, inputs.permission, inputs.turning, now_ns)
    granted = None
    if inputs.lease is not None:
        state, granted = _take_lease(state, *inputs.lease, inputs.turning, now_ns)
    seq = state.seq
    if inputs.command is not None:
        state = _take_command(state, drive, inputs.command, now_ns)
    target, status = _target(state, now_ns)
    state = _follow(state, target, drive.max_wheel_acceleration, now_ns)
    keep = (state.epoch, state.latch_id, state.latch) != (before.epoch, before.latch_id, before.latch)
    applied = status is GateStatus.OPEN and state.seq != seq
    return state, GateOutput(state.output, target, status, applied, granted, keep, _deadline(state, target, now_ns))


def _latched(state: GateState, latch: Latch) -> GateState:
    """Latch, unless something at least as grave holds the gate already."""
    if latch <= state.latch:
        return state
    return state._replace(latch=latch, latch_id=state.latch_id + 1)


def _take_permission(state: GateState, permission: Permission, turning: bool, now_ns: int) -> GateState:
    why = _stale(state, permission.boot_id, permission.nonce, now_ns)
    if not why and (permission.nonce, permission.seq) <= state.enabled:
        why = Refusal.SEQUENCE
    if not why and permission.epoch != state.epoch and not permission.latch:  # an e-stop needs no lease
        why = Refusal.EPOCH
    if why:
        return state._replace(refused=state.refused + 1, why=why)
    state = state._replace(enabled=(permission.nonce, permission.seq), limit=permission.limit)
    if permission.latch:
        return _latched(state, permission.latch)._replace(limit=0.0)
    if state.latch and permission.clear == state.latch_id and state.output == STOP and not turning:
        return state._replace(latch=Latch.NONE)
    return state


def _take_lease(
    state: GateState, session: int, action: LeaseAction, turning: bool, now_ns: int
) -> tuple[GateState, bool]:
    if action is LeaseAction.RELEASE:
        if session == state.session != 0:
            return state._replace(session=0, command_nonce=_NEVER), True
        return state, False
    if session == state.session != 0:
        return state, True
    lapsed = now_ns - state.heard_ns >= LAPSE_NS
    at_rest = state.output == STOP and not turning
    if session == 0 or not at_rest or not (state.session == 0 or lapsed or action is LeaseAction.TAKE_OVER):
        return state, False
    state = state._replace(
        epoch=state.epoch + 1, session=session, heard_ns=now_ns, seq=0, command_nonce=_NEVER, limit=0.0
    )
    return state, True


def _take_command(state: GateState, drive: DifferentialDrive, command: Command, now_ns: int) -> GateState:
    why = _stale(state, command.boot_id, command.nonce, now_ns)
    if not why and command.epoch != state.epoch:
        why = Refusal.EPOCH
    if not why and (command.session != state.session or command.session == 0):
        why = Refusal.SESSION
    if not why and command.seq <= state.seq:
        why = Refusal.SEQUENCE
    if not why and not _within(drive, command.wheels):
        why = Refusal.LIMIT
    if why:
        return state._replace(refused=state.refused + 1, why=why)
    return state._replace(seq=command.seq, command_nonce=command.nonce, wheels=command.wheels, heard_ns=now_ns)


def _stale(state: GateState, boot_id: int, nonce: int, now_ns: int) -> Refusal:
    if boot_id != state.boot_id:
        return Refusal.BOOT
    return Refusal.NOTHING if 0 <= nonce <= now_ns < nonce + VALID_NS else Refusal.STALE


def _within(drive: DifferentialDrive, wheels: WheelSpeeds) -> bool:
    left, right = wheels
    if not max(abs(left), abs(right)) <= _TOLERANCE * drive.max_wheel_speed:  # a NaN is refused too
        return False
    return drive.wheel_radius * abs(left + right) / 2.0 <= _TOLERANCE * drive.max_speed


def _target(state: GateState, now_ns: int) -> tuple[WheelSpeeds, GateStatus]:
    if state.latch:
        return STOP, GateStatus.LATCHED
    if state.session == 0:
        return STOP, GateStatus.NO_LEASE
    enabled = state.enabled[0] != _NEVER and now_ns < state.enabled[0] + VALID_NS
    if not enabled or not state.limit > 0.0:
        return STOP, GateStatus.NO_ENABLE
    if state.command_nonce == _NEVER or now_ns >= state.command_nonce + VALID_NS:
        return STOP, GateStatus.NO_COMMAND
    if max(abs(state.wheels.left), abs(state.wheels.right)) > _TOLERANCE * state.limit:
        return STOP, GateStatus.NO_ENABLE
    return state.wheels, GateStatus.OPEN


def _follow(state: GateState, target: WheelSpeeds, acceleration: float, now_ns: int) -> GateState:
    """Move the output towards the target, and time a stop."""
    left, right = target.left - state.output.left, target.right - state.output.right
    furthest = max(abs(left), abs(right))
    reach = acceleration * max(0, min(now_ns - state.at_ns, _LONGEST_RAMP_NS)) * 1e-9
    output = target
    if furthest > reach:
        ratio = reach / furthest
        output = WheelSpeeds(state.output.left + ratio * left, state.output.right + ratio * right)
    moving = target != STOP
    since_ns = now_ns - min(state.command_nonce, state.enabled[0])
    return state._replace(
        output=output,
        at_ns=now_ns,
        moving=moving,
        target_after_ns=since_ns if state.moving and not moving else state.target_after_ns,
        output_after_ns=since_ns if state.output != STOP == output and not moving else state.output_after_ns,
    )


def _deadline(state: GateState, target: WheelSpeeds, now_ns: int) -> int | None:
    if state.output != target:
        return now_ns + RAMP_NS
    return None if target == STOP else min(state.command_nonce, state.enabled[0]) + VALID_NS

"""The last gate before a robot's wheels. It allows or refuses; it never repairs.

Freshness without comparing clocks: a driver's status carries a nonce (its own clock's reading, opaque to everybody
else) and the boot id that it drew when it started. Commands and enables echo both. What is accepted is valid until
its nonce is 120 ms old, whenever it arrived: a network that stops and resumes delivers nothing old. So commands
and enables are the heartbeat that keeps a robot driving. A refused message changes a counter and feeds no watchdog.

The target is what is allowed now: the command, or zero. The output, which is what the wheels are given, follows it
with limited acceleration, along the straight line between the two: towards zero both wheels fall by one ratio, so a
robot that stops stays on its arc and neither wheel reverses.

A gate that let its wheels turn and was then not stepped for 120 ms does not go on from there: its robot has long been
stopped by other means. Its output is zero at once, and what was issued before counts no more.
"""

import math
from enum import IntEnum
from typing import NamedTuple

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import STOP, WheelSpeeds

VALID_NS = 120_000_000
LAPSE_NS = 1_000_000_000  # a lease whose holder gave no command for so long is free, if the robot is at rest
RAMP_NS = 5_000_000  # while the output is on its way it is renewed so often
UNKNOWN = -1  # a stop's figure before the first stop, or when the clock was set back
LONGEST_RAMP_NS = 20_000_000  # what a process that was held up may catch up with in one step
TOLERANCE = 1.01  # of a limit; more is refused, not clamped
NEVER = -VALID_NS  # as a nonce: too old at every instant


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


class LeaseAction(IntEnum):
    """What a controller asks of a driver."""

    ACQUIRE = 1
    TAKE_OVER = 2  # also from a controller that is alive
    RELEASE = 3


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
    latch: Latch = Latch.NONE  # the robot's own reason to stop, while it lasts
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
    command_nonce: int = NEVER
    wheels: WheelSpeeds = STOP
    enabled: tuple[int, int] = (NEVER, 0)  # nonce and sequence number of the permission accepted last
    limit: float = 0.0
    target: WheelSpeeds = STOP
    output: WheelSpeeds = STOP
    at_ns: int = 0  # of the last step
    since_ns: int = NEVER  # what was issued before counts no more: the gate was held up
    moved_by: int = NEVER  # older one of the two nonces by which the target was last not zero
    target_after_ns: int = UNKNOWN  # last stop: that nonce's issue to zero target
    output_after_ns: int = UNKNOWN  # and to zero output
    refused: int = 0


class GateOutput(NamedTuple):
    """What the wheels are given, and why; what to answer; when to ask again at the latest."""

    output: WheelSpeeds
    target: WheelSpeeds
    status: GateStatus
    granted: bool | None  # the answer to a lease request; None: there was none
    deadline_ns: int | None  # nothing changes before, unless something comes


def step(state: GateState, drive: DifferentialDrive, inputs: Inputs, now_ns: int) -> tuple[GateState, GateOutput]:
    """Take what arrived since the last step and return the wheel speeds that are allowed now."""
    if now_ns < state.at_ns:
        state = _started_anew(state, now_ns)
    elif now_ns - state.at_ns > VALID_NS and not state.output == STOP == state.target:
        state = _held_up(state, now_ns)
    at_rest = state.output == STOP and not inputs.turning
    if inputs.latch:
        state = _latched(state, inputs.latch)
    if inputs.permission is not None:
        state = _take_permission(state, inputs.permission, at_rest and not inputs.latch, now_ns)
    granted = None
    if inputs.lease is not None:
        state, granted = _take_lease(state, inputs.lease, at_rest, now_ns)
    if inputs.command is not None:
        state = _take_command(state, drive, inputs.command, now_ns)
    target, status, until_ns = _target(state, now_ns)
    state = _follow(state, target, drive.max_wheel_acceleration, now_ns)
    if state.output != target:
        until_ns = now_ns + RAMP_NS if until_ns is None else min(now_ns + RAMP_NS, until_ns)
    return state, GateOutput(state.output, target, status, granted, until_ns)


def _started_anew(state: GateState, now_ns: int) -> GateState:
    """The clock was set back: no nonce that was given out before says anything any more."""
    forgetting = state._replace(
        boot_id=state.boot_id + 1, heard_ns=now_ns, command_nonce=NEVER, enabled=(NEVER, 0), moved_by=NEVER
    )
    return forgetting._replace(since_ns=NEVER)


def _held_up(state: GateState, now_ns: int) -> GateState:
    """Nobody asked the gate while it let its wheels turn: they stand now, and no nonce of before is valid."""
    return _follow(state, STOP, math.inf, now_ns)._replace(since_ns=now_ns)


def _latched(state: GateState, latch: Latch) -> GateState:
    """Latch, unless something at least as grave holds the gate already."""
    return state if latch <= state.latch else state._replace(latch=latch, latch_id=state.latch_id + 1)


def _take_permission(state: GateState, permission: Permission, clearable: bool, now_ns: int) -> GateState:
    accepted = (
        _fresh(state, permission, now_ns)
        and (permission.epoch == state.epoch or permission.latch)  # an e-stop needs no lease
        and (permission.nonce, permission.seq) > state.enabled
    )
    if not accepted:
        return state._replace(refused=state.refused + 1)
    state = state._replace(enabled=(permission.nonce, permission.seq), limit=permission.limit)
    if permission.latch:
        return _latched(state, permission.latch)._replace(limit=0.0)
    if state.latch and clearable and permission.clear and permission.clear == state.latch_id:
        return state._replace(latch=Latch.NONE, limit=0.0)  # a reset moves nothing: that takes another permission
    return state


def _take_lease(state: GateState, lease: tuple[int, LeaseAction], at_rest: bool, now_ns: int) -> tuple[GateState, bool]:
    session, action = lease
    if session == 0:
        return state, False
    if action is LeaseAction.RELEASE:
        return (state._replace(session=0), True) if session == state.session else (state, False)
    if session == state.session:
        return state, True
    lapsed = now_ns - state.heard_ns >= LAPSE_NS
    if not (at_rest and (state.session == 0 or lapsed or action is LeaseAction.TAKE_OVER)):
        return state, False
    epoch = state.epoch + 1
    own = state._replace(epoch=epoch, session=session, heard_ns=now_ns, seq=0, command_nonce=NEVER, limit=0.0)
    return own, True


def _take_command(state: GateState, drive: DifferentialDrive, command: Command, now_ns: int) -> GateState:
    accepted = (
        _fresh(state, command, now_ns)
        and command.epoch == state.epoch
        and command.session == state.session != 0
        and command.seq > state.seq
        and _within(drive, command.wheels)
    )
    if not accepted:
        return state._replace(refused=state.refused + 1)
    return state._replace(seq=command.seq, command_nonce=command.nonce, wheels=command.wheels, heard_ns=now_ns)


def _fresh(state: GateState, message: Command | Permission, now_ns: int) -> bool:
    newest = state.since_ns <= message.nonce <= now_ns < message.nonce + VALID_NS
    return message.boot_id == state.boot_id and newest


def _within(drive: DifferentialDrive, wheels: WheelSpeeds) -> bool:
    """Return whether the robot can do that; it cannot do what is not a number."""
    body = drive.wheel_radius * abs(wheels.left + wheels.right) / 2.0
    fastest = TOLERANCE * drive.max_wheel_speed
    return body <= TOLERANCE * drive.max_speed and abs(wheels.left) <= fastest and abs(wheels.right) <= fastest


def _target(state: GateState, now_ns: int) -> tuple[WheelSpeeds, GateStatus, int | None]:
    """Return what is allowed now, why, and until when that holds."""
    if state.latch:
        return STOP, GateStatus.LATCHED, None
    if state.session == 0:
        return STOP, GateStatus.NO_LEASE, None
    enabled_until_ns = state.enabled[0] + VALID_NS
    if now_ns >= enabled_until_ns or not state.limit > 0.0:
        return STOP, GateStatus.NO_ENABLE, None
    command_until_ns = state.command_nonce + VALID_NS
    if now_ns >= command_until_ns:
        return STOP, GateStatus.NO_COMMAND, enabled_until_ns
    until_ns = min(enabled_until_ns, command_until_ns)
    if max(abs(state.wheels.left), abs(state.wheels.right)) > TOLERANCE * state.limit:
        return STOP, GateStatus.NO_ENABLE, until_ns
    return state.wheels, GateStatus.OPEN, until_ns


def _follow(state: GateState, target: WheelSpeeds, acceleration: float, now_ns: int) -> GateState:
    """Move the output towards the target, and time a stop."""
    # on its way it catches up with time that was lost; at rest on its target it had nothing to catch up with
    longest_ns = RAMP_NS if state.output == state.target else LONGEST_RAMP_NS
    reach = acceleration * max(0, min(now_ns - state.at_ns, longest_ns)) * 1e-9
    left, right = target.left - state.output.left, target.right - state.output.right
    furthest = max(abs(left), abs(right))
    output = target
    if furthest > reach:
        ratio = reach / furthest
        output = WheelSpeeds(state.output.left + ratio * left, state.output.right + ratio * right)
    if target != STOP:
        moved_by = min(state.command_nonce, state.enabled[0])
        return state._replace(target=target, output=output, at_ns=now_ns, moved_by=moved_by)
    moved = state._replace(target=target, output=output, at_ns=now_ns)
    after_ns = UNKNOWN if state.moved_by == NEVER else now_ns - state.moved_by
    if state.target != STOP:
        moved = moved._replace(target_after_ns=after_ns, output_after_ns=UNKNOWN)
    if output == STOP and not state.target == STOP == state.output:
        moved = moved._replace(output_after_ns=after_ns)
    return moved

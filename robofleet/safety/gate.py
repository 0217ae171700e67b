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

``step`` is plain Python: a robot's small computer runs it on a ``GateState`` and needs no numba. Simulated robots run
the same source on rows of arrays, compiled. There what a gate counts (boot id, epoch, latch id) is
signed, also in messages, since numba turns both numbers into floats where an unsigned one meets a signed one. A forged
one of 2^63 or more is negative there, and equals no count. Sessions and sequence numbers are unsigned everywhere.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

from robofleet.core.rows import Unsigned, row_type
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import WheelSpeeds

VALID_NS = 120_000_000
LAPSE_NS = 1_000_000_000  # a lease whose holder gave no command for so long is free, if the robot is at rest
RAMP_NS = 5_000_000  # while the output is on its way it is renewed so often
UNKNOWN = -1  # a stop's figure before the first stop, or when the clock was set back
LONGEST_RAMP_NS = 20_000_000  # what a process that was held up may catch up with in one step
TOLERANCE = 1.01  # of a limit; more is refused, not clamped
NEVER = -VALID_NS  # as a nonce: too old at every instant
NEVER_NS = (1 << 63) - 1  # as a deadline: none
NOT_ASKED = -1  # as the answer to a lease request: there was none


class LeaseAction(IntEnum):
    """What a controller asks of a driver."""

    ACQUIRE = 1
    TAKE_OVER = 2  # also from a controller that is alive
    RELEASE = 3


@dataclass(slots=True, kw_only=True)
class Inputs:
    """What came since the last step; a flag says whether there is a command, a permission, a lease request."""

    command: bool = False
    command_epoch: int = 0
    command_session: Unsigned = 0
    command_seq: Unsigned = 0
    command_boot_id: int = 0
    command_nonce: int = 0
    command_left: float = 0.0
    command_right: float = 0.0
    permission: bool = False
    permission_epoch: int = 0
    permission_seq: Unsigned = 0
    permission_boot_id: int = 0
    permission_nonce: int = 0
    permission_latch: int = Latch.NONE
    permission_clear: int = 0  # latch id
    permission_limit: float = 0.0  # fastest wheel [rad/s]; 0: none
    lease: bool = False
    lease_session: Unsigned = 0
    lease_action: int = LeaseAction.ACQUIRE
    latch: int = Latch.NONE  # the robot's own reason to stop, while it lasts
    turning: bool = False  # a wheel turns, as measured


@dataclass(slots=True, kw_only=True)
class GateState:
    """What the gate remembers, and what it decided last. Instants and nonces [driver's clock, ns]; wheels [rad/s].

    It is not frozen: a step changes it in place, as it changes a row of an array.
    """

    boot_id: int
    epoch: int = 0  # of the lease; survives a restart
    latch: int = Latch.NONE  # survives a restart, but for a drill
    latch_id: int = 0  # survives a restart
    session: Unsigned = 0  # of the controller that holds the lease; 0: nobody
    heard_ns: int = 0  # when the holder was granted the lease, or gave a command
    seq: Unsigned = 0  # of the command accepted last, in this epoch
    command_nonce: int = NEVER
    left: float = 0.0
    right: float = 0.0
    enabled_nonce: int = NEVER  # of the permission accepted last
    enabled_seq: Unsigned = 0
    limit: float = 0.0
    target_left: float = 0.0
    target_right: float = 0.0
    output_left: float = 0.0
    output_right: float = 0.0
    at_ns: int = 0  # of the last step
    since_ns: int = NEVER  # what was issued before counts no more: the gate was held up
    moved_by: int = NEVER  # older one of the two nonces by which the target was last not zero
    target_after_ns: int = UNKNOWN  # last stop: that nonce's issue to zero target
    output_after_ns: int = UNKNOWN  # and to zero output
    refused: int = 0
    status: int = GateStatus.NO_LEASE
    deadline_ns: int = 0  # nothing changes before, unless something comes

    @property
    def wheels(self) -> WheelSpeeds:
        """Return the command accepted last."""
        return WheelSpeeds(self.left, self.right)

    @property
    def target(self) -> WheelSpeeds:
        """Return what is allowed now."""
        return WheelSpeeds(self.target_left, self.target_right)

    @property
    def output(self) -> WheelSpeeds:
        """Return what the wheels are given."""
        return WheelSpeeds(self.output_left, self.output_right)


INPUT, GATE, DRIVE = row_type(Inputs), row_type(GateState), row_type(DifferentialDrive)


def step(g: GateState, drive: DifferentialDrive, i: Inputs, now_ns: int) -> int:
    """Take what arrived since the last step, and decide what the wheels are given now.

    Returns:
        Whether a lease was granted, 1 or 0; NOT_ASKED where none was asked for.
    """
    if now_ns < g.at_ns:
        _start_anew(g, now_ns)
    elif now_ns - g.at_ns > VALID_NS and not (_at_zero(g) and g.target_left == 0.0 and g.target_right == 0.0):
        _stop_held_up(g, now_ns)
    at_rest = _at_zero(g) and not i.turning
    if i.latch:
        _close(g, i.latch)
    if i.permission:
        _take_permission(g, i, at_rest and not i.latch, now_ns)
    granted = NOT_ASKED
    if i.lease:
        granted = int(_take_lease(g, i.lease_session, i.lease_action, at_rest, now_ns))
    if i.command:
        _take_command(g, drive, i, now_ns)
    left, right, g.status, g.deadline_ns = _target(g, now_ns)
    follow(g, left, right, drive.max_wheel_acceleration, now_ns)
    if g.output_left != left or g.output_right != right:
        g.deadline_ns = min(now_ns + RAMP_NS, g.deadline_ns)
    return granted


def _at_zero(g: GateState) -> bool:
    return g.output_left == 0.0 and g.output_right == 0.0


def _start_anew(g: GateState, now_ns: int) -> None:
    """The clock was set back: no nonce that was given out before says anything any more."""
    g.boot_id += 1
    g.heard_ns = now_ns
    g.command_nonce = g.enabled_nonce = g.moved_by = g.since_ns = NEVER
    g.enabled_seq = 0


def _stop_held_up(g: GateState, now_ns: int) -> None:
    """Nobody asked the gate while it let its wheels turn: they stand now, and no nonce of before is valid."""
    follow(g, 0.0, 0.0, math.inf, now_ns)
    g.since_ns = now_ns


def _close(g: GateState, latch: int) -> None:
    """Latch, unless something at least as grave holds the gate already."""
    if latch > g.latch:
        g.latch = latch
        g.latch_id += 1


def _take_permission(g: GateState, i: Inputs, clearable: bool, now_ns: int) -> None:
    if not (
        _fresh(g, i.permission_boot_id, i.permission_nonce, now_ns)
        and (i.permission_epoch == g.epoch or i.permission_latch)  # an e-stop needs no lease
        and (i.permission_nonce, i.permission_seq) > (g.enabled_nonce, g.enabled_seq)
    ):
        g.refused += 1
        return
    g.enabled_nonce, g.enabled_seq, g.limit = i.permission_nonce, i.permission_seq, i.permission_limit
    if i.permission_latch:
        _close(g, i.permission_latch)
        g.limit = 0.0
    elif g.latch and clearable and i.permission_clear and i.permission_clear == g.latch_id:
        g.latch, g.limit = Latch.NONE, 0.0  # a reset moves nothing: that takes another permission


def _take_lease(g: GateState, session: int, action: int, at_rest: bool, now_ns: int) -> bool:
    if session == 0:
        return False
    if action == LeaseAction.RELEASE:
        if session != g.session:
            return False
        g.session = 0
        return True
    if session == g.session:
        return True
    lapsed = now_ns - g.heard_ns >= LAPSE_NS
    if not (at_rest and (g.session == 0 or lapsed or action == LeaseAction.TAKE_OVER)):
        return False
    g.epoch += 1
    g.session, g.heard_ns, g.seq, g.command_nonce, g.limit = session, now_ns, 0, NEVER, 0.0
    return True


def _take_command(g: GateState, drive: DifferentialDrive, i: Inputs, now_ns: int) -> None:
    if not (
        _fresh(g, i.command_boot_id, i.command_nonce, now_ns)
        and i.command_epoch == g.epoch
        and i.command_session == g.session
        and g.session != 0
        and i.command_seq > g.seq
        and _within(drive, i.command_left, i.command_right)
    ):
        g.refused += 1
        return
    g.seq, g.command_nonce, g.heard_ns = i.command_seq, i.command_nonce, now_ns
    g.left, g.right = i.command_left, i.command_right


def _fresh(g: GateState, boot_id: int, nonce: int, now_ns: int) -> bool:
    return boot_id == g.boot_id and g.since_ns <= nonce <= now_ns < nonce + VALID_NS


def _within(drive: DifferentialDrive, left: float, right: float) -> bool:
    """Return whether the robot can do that; it cannot do what is not a number."""
    body = drive.wheel_radius * abs(left + right) / 2.0
    fastest = TOLERANCE * drive.max_wheel_speed
    return body <= TOLERANCE * drive.max_speed and abs(left) <= fastest and abs(right) <= fastest


def _target(g: GateState, now_ns: int) -> tuple[float, float, GateStatus, int]:
    """Return what is allowed now (left, right), why, and until when that holds."""
    if g.latch:
        return 0.0, 0.0, GateStatus.LATCHED, NEVER_NS
    if g.session == 0:
        return 0.0, 0.0, GateStatus.NO_LEASE, NEVER_NS
    enabled_until_ns = g.enabled_nonce + VALID_NS
    if now_ns >= enabled_until_ns or not g.limit > 0.0:
        return 0.0, 0.0, GateStatus.NO_ENABLE, NEVER_NS
    command_until_ns = g.command_nonce + VALID_NS
    if now_ns >= command_until_ns:
        return 0.0, 0.0, GateStatus.NO_COMMAND, enabled_until_ns
    until_ns = min(enabled_until_ns, command_until_ns)
    if max(abs(g.left), abs(g.right)) > TOLERANCE * g.limit:
        return 0.0, 0.0, GateStatus.NO_ENABLE, until_ns
    return g.left, g.right, GateStatus.OPEN, until_ns


def follow(g: GateState, target_left: float, target_right: float, acceleration: float, now_ns: int) -> None:
    """Move the output towards the target, and time a stop."""
    # on its way it catches up with time that was lost; at rest on its target it had nothing to catch up with
    on_target = g.output_left == g.target_left and g.output_right == g.target_right
    longest_ns = RAMP_NS if on_target else LONGEST_RAMP_NS
    reach = acceleration * max(0, min(now_ns - g.at_ns, longest_ns)) * 1e-9
    left, right = target_left - g.output_left, target_right - g.output_right
    furthest = max(abs(left), abs(right))
    stood = g.target_left == 0.0 and g.target_right == 0.0
    rested = stood and _at_zero(g)
    if furthest > reach:
        ratio = reach / furthest
        g.output_left, g.output_right = g.output_left + ratio * left, g.output_right + ratio * right
    else:
        g.output_left, g.output_right = target_left, target_right
    g.target_left, g.target_right, g.at_ns = target_left, target_right, now_ns
    if target_left != 0.0 or target_right != 0.0:
        g.moved_by = min(g.command_nonce, g.enabled_nonce)
        return
    after_ns = UNKNOWN if g.moved_by == NEVER else now_ns - g.moved_by
    if not stood:
        g.target_after_ns, g.output_after_ns = after_ns, UNKNOWN
    if _at_zero(g) and not rested:
        g.output_after_ns = after_ns

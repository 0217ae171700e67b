"""What a driver process knows of one robot beside its gate, and the rules that it follows. Each rule stands here once.

The functions are plain Python: for real robots they run on a ``GateState`` and a ``Link``, and need no numba.
``simulated_robots.py`` compiles the same functions for rows of arrays.
"""

import math
from copy import copy
from dataclasses import dataclass
from typing import Any

from robofleet.bus.messages import Enable, LeaseAnswer, UnitCommand, UnitEnable, WheelCommand
from robofleet.core.clock import MS, S
from robofleet.nodes.unit.state_store import RobotState, kept
from robofleet.safety import gate, runaway
from robofleet.safety.gate import GateState, Inputs, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import RobotFault

TURNING_RAD_S = 0.05  # a wheel that is measured faster than this is not at rest
# In health a gate lives on nonces of up to 60 ms: a status every 20 ms, an enable every 40 ms.
BAD_LINK_NS = 70 * MS
NO_LINK_NS = S // 2  # it is not a bad one
HURRY_NS = 60 * S
LOOK_NS = gate.VALID_NS // 2  # so often a gate is stepped while it changes: twice that, and it was held up
NEW_LATCH, TO_STORE, HURRIES, NEW_RUNAWAY = 1, 2, 4, 8  # bits of what ``settle`` returns

_NO_EXPOSURE = -1  # no command waits to reach the wheels
_NONE, _DRILL, _EMERGENCY_STOP = int(Latch.NONE), int(Latch.DRILL), int(Latch.EMERGENCY_STOP)
_GRAVEST = max(map(int, Latch))
_PRESSED, _UNREACHABLE = int(RobotFault.WIRED_STOP), int(RobotFault.UNREACHABLE)


@dataclass(slots=True, kw_only=True)
class Link:
    """What is known of a robot. Instants [driver's clock, ns]; angles [rad]; speeds [rad/s].

    It is not frozen: the rules change it in place, as they change a row of an array.
    """

    # The newest reading.
    left_angle: float = 0.0
    right_angle: float = 0.0
    left_speed: float = 0.0
    right_speed: float = 0.0
    battery: float = math.nan
    faults: int = 0
    failed: bool = False  # it could not be written to or read from, in this loop or since
    # What is wrong with it.
    retry: bool = False  # it failed in the last loop: what it was commanded may not have reached it
    latch: int = Latch.NONE  # its own reason to stop, while it lasts
    felt: int = 0  # faults since the gate was latched
    left_direction: int = 0  # of a wheel that turns by itself, as safety.runaway judges it
    right_direction: int = 0
    left_turning_since_ns: int
    right_turning_since_ns: int
    looked_ns: int  # when that was looked at last
    runaway: int = 0  # 1: since this look a wheel turns by itself; 2: it did before
    # What its wheels were given.
    left_written: float = math.nan  # NaN: nothing, or nobody knows
    right_written: float = math.nan
    left_output: float = 0.0  # of the gate
    right_output: float = 0.0
    output_ns: int = 0  # since when
    left_commanded: float = 0.0  # the output before, added up over time
    right_commanded: float = 0.0
    accepted_exposure_ns: int = _NO_EXPOSURE  # of a command that has not reached the wheels yet
    applied_exposure_ns: int = 0  # of the newest one that has
    applied_ns: int = 0  # when it did
    # What was told of its gate.
    stepped: bool = False  # the newest pass asked the gate
    opened: bool = False  # the gate was open: before, late messages are those of processes that start
    hurry_until_ns: int = 0  # the link was bad a short while ago
    reported_latch: int  # in the newest status
    reported_latch_id: int
    stored_epoch: int
    stored_latch: int
    stored_latch_id: int


def new_link(g: GateState, now_ns: int) -> Link:
    """Return the link of a robot whose gate begins with what was stored."""
    return Link(
        left_turning_since_ns=now_ns, right_turning_since_ns=now_ns, looked_ns=now_ns,
        reported_latch=g.latch, reported_latch_id=g.latch_id,
        stored_epoch=g.epoch, stored_latch=g.latch, stored_latch_id=g.latch_id,
    )  # fmt: skip


def look(g: GateState, l: Link, now_ns: int) -> bool:
    """Judge the newest reading, or that there was none.

    Returns:
        Whether to command the robot again to stand: that may have been lost on its way.
    """
    if not l.failed:
        l.felt = l.faults | (l.felt if g.latch else 0)
    left = 0 if l.failed else runaway.direction(g.output_left, l.left_speed)
    right = 0 if l.failed else runaway.direction(g.output_right, l.right_speed)
    l.left_turning_since_ns = runaway.turning_since_ns(
        l.left_turning_since_ns, l.looked_ns, l.left_direction, left, now_ns
    )
    l.right_turning_since_ns = runaway.turning_since_ns(
        l.right_turning_since_ns, l.looked_ns, l.right_direction, right, now_ns
    )
    l.left_direction, l.right_direction, l.looked_ns = left, right, now_ns
    if not runaway.runs(min(l.left_turning_since_ns, l.right_turning_since_ns), now_ns):
        l.runaway = 0
    else:
        l.runaway = 2 if l.runaway else 1
    l.latch = _reason_to_stop(l)
    return g.output_left == 0.0 and g.output_right == 0.0 and g.status != GateStatus.OPEN


def fail(l: Link) -> None:
    """Note that the robot could not be written to or read from."""
    l.failed = True
    l.latch = _reason_to_stop(l)


def runaway_complaint(l: Link) -> str:
    """Return what the log says of a robot of which a wheel turns by itself."""
    left = l.left_turning_since_ns <= l.right_turning_since_ns
    wheel, speed = ("left", l.left_speed) if left else ("right", l.right_speed)
    return f"its {wheel} wheel turns by itself, at {speed:.1f} rad/s: switch off its power"


def put_command(i: Inputs, message: UnitCommand, wheels: WheelCommand) -> None:
    """Give a robot's gate its part of a unit's command."""
    if wheels.epoch:
        i.command = True
        i.command_epoch, i.command_session, i.command_seq = wheels.epoch, message.session, message.seq
        i.command_boot_id, i.command_nonce = message.boot_id, message.nonce
        i.command_left, i.command_right = wheels.left_rad_s, wheels.right_rad_s


def put_permission(i: Inputs, message: UnitEnable, permission: Enable) -> None:
    """Give a robot's gate its part of a unit's permission; a latch of another version is the emergency stop."""
    i.permission = True
    i.permission_epoch, i.permission_seq = permission.epoch, message.seq
    i.permission_boot_id, i.permission_nonce = message.boot_id, message.nonce
    i.permission_latch = permission.latch if permission.latch <= _GRAVEST else _EMERGENCY_STOP
    i.permission_clear, i.permission_limit = permission.clear, permission.limit_rad_s


def pass_on(g: GateState, l: Link, drive: DifferentialDrive, i: Inputs, exposure_ns: int, now_ns: int) -> bool:
    """Let the gate decide on what arrived, if there is something to decide.

    Args:
        g: The robot's gate.
        l: Its link.
        drive: Its wheels and limits.
        i: What arrived.
        exposure_ns: Exposure of the image behind a command [ns].
        now_ns: The instant [ns].

    Returns:
        Whether the wheels must now be given the gate's output.
    """
    timed = g.deadline_ns != gate.NEVER_NS and now_ns >= min(g.deadline_ns, g.at_ns + LOOK_NS)
    arrived = i.command or i.permission or l.retry or l.latch > g.latch
    l.stepped = arrived or timed or now_ns < g.at_ns
    if not l.stepped:
        return False
    l.opened = l.opened or g.status == GateStatus.OPEN
    age_ns = now_ns - min(g.command_nonce, g.enabled_nonce)
    if l.opened and BAD_LINK_NS < age_ns < NO_LINK_NS:
        l.hurry_until_ns = now_ns + HURRY_NS
    seq = g.seq
    step(g, l, drive, i, now_ns)
    if i.command and exposure_ns != l.applied_exposure_ns and g.seq != seq:
        l.accepted_exposure_ns = exposure_ns
    again = i.command or l.retry
    l.retry = False
    return take_output(g, l, again, now_ns)


def step(g: GateState, l: Link, drive: DifferentialDrive, i: Inputs, now_ns: int) -> int:
    """Step the gate with what arrived and with the robot's own state; return its answer to a lease request."""
    i.latch = l.latch
    i.turning = max(abs(l.left_speed), abs(l.right_speed)) > TURNING_RAD_S
    return gate.step(g, drive, i, now_ns)


def take_output(g: GateState, l: Link, again: bool, now_ns: int) -> bool:
    """Return whether the wheels must be given the gate's output; ``again``: also what they were given before."""
    if not again and g.output_left == l.left_written and g.output_right == l.right_written:
        return False
    since_s = (now_ns - l.output_ns) * 1e-9
    l.left_commanded += l.left_output * since_s
    l.right_commanded += l.right_output * since_s
    l.output_ns, l.left_output, l.right_output = now_ns, g.output_left, g.output_right
    return True


def settle(g: GateState, l: Link, now_ns: int) -> int:
    """Note which command has reached the wheels, after they were written; return what is still to do, as bits."""
    if l.accepted_exposure_ns != _NO_EXPOSURE and g.status == GateStatus.OPEN:
        l.applied_exposure_ns, l.applied_ns, l.accepted_exposure_ns = l.accepted_exposure_ns, now_ns, _NO_EXPOSURE
    pending = 0
    if g.latch != l.reported_latch or g.latch_id != l.reported_latch_id:
        pending |= NEW_LATCH
    lasting = _NONE if g.latch == _DRILL else g.latch
    if g.epoch != l.stored_epoch or lasting != l.stored_latch or g.latch_id != l.stored_latch_id:
        pending |= TO_STORE
    if g.at_ns < l.hurry_until_ns:
        pending |= HURRIES
    if l.runaway == 1:
        pending |= NEW_RUNAWAY
    return pending


def fill_status(s: Any, g: GateState, l: Link, now_ns: int, refused: int) -> None:
    """Fill in a robot's part of a status, as ``RobotStatus``; ``refused``: messages of the unit that nobody could read.

    Its faults are those that last, and those that it felt since its gate was latched. Its own e-stop is not among the
    latter: that has a latch of its own.
    """
    felt = l.felt & ~_PRESSED if g.latch else 0
    since_s = (now_ns - l.output_ns) * 1e-9
    s.epoch, s.session = g.epoch, g.session
    s.applied_exposure_ns, s.applied_ns, s.rejected = l.applied_exposure_ns, l.applied_ns, g.refused + refused
    s.gate, s.latch, s.latch_id = g.status, g.latch, g.latch_id
    s.faults = l.faults | felt | (_UNREACHABLE if l.failed else 0)
    s.target_after_ns, s.output_after_ns = g.target_after_ns, g.output_after_ns
    s.left_angle_rad, s.right_angle_rad, s.left_rad_s, s.right_rad_s = (
        l.left_angle, l.right_angle, l.left_speed, l.right_speed,
    )  # fmt: skip
    s.left_output_rad_s, s.right_output_rad_s = g.output_left, g.output_right
    s.left_told_rad = l.left_commanded + l.left_output * since_s
    s.right_told_rad = l.right_commanded + l.right_output * since_s
    s.battery = l.battery if math.isfinite(l.battery) else -1.0
    l.reported_latch, l.reported_latch_id = g.latch, g.latch_id


def take_lease(
    g: GateState, l: Link, drive: DifferentialDrive, memory: RobotState, session: int, action: LeaseAction, now_ns: int
) -> tuple[Inputs, GateState, LeaseAnswer]:
    """Ask a gate for its lease; an epoch that a restart would give out again is not given out.

    Returns:
        What the gate got, the gate afterwards, and the answer. The gate is ``g`` itself where its epoch could not be
        stored: then nothing has happened.
    """
    inputs, after = Inputs(lease=True, lease_session=session, lease_action=action), copy(g)
    granted = step(after, l, drive, inputs, now_ns)
    if after.epoch != g.epoch and not memory.save(kept(after)):
        return inputs, g, LeaseAnswer(0, g.epoch, g.session)
    return inputs, after, LeaseAnswer(granted, after.epoch, after.session)


def store(g: GateState, l: Link, memory: RobotState, *, due: bool) -> None:
    """Store what must be stored of a gate; ``due``: try again what could not be stored before."""
    memory.keep(kept(g), due=due)
    l.stored_epoch, l.stored_latch, l.stored_latch_id = memory.kept


def _reason_to_stop(l: Link) -> Latch:
    if l.failed:
        return Latch.DRIVER_FAILED
    if l.runaway:
        return Latch.RUNAWAY
    if not l.faults:
        return Latch.NONE
    return Latch.WIRED_STOP if l.faults & _PRESSED else Latch.ROBOT_FAULT

"""The gates of many simulated robots at once: ``gate.step`` over arrays, compiled.

A robot that exists has the gate of ``gate.py``, whose process needs no numba. Both say the same to the last bit:
``tests/safety/test_gates.py`` compares them over whole runs and over states that no run reaches.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.core.kernels import kernel
from robofleet.safety import gate
from robofleet.safety.gate import GateOutput, GateState, GateStatus, Inputs, Latch, LeaseAction
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import WheelSpeeds

NEVER_NS = (1 << 63) - 1  # as a deadline: none
NOT_ASKED = -1  # as the answer to a lease request: there was none

_IDS, _INSTANTS, _FLOATS = "<u8", "<i8", "<f8"

# The fields are those of gate.GateState; pairs have two.
GATE = np.dtype(
    [
        *((name, _IDS) for name in ("boot_id", "epoch", "latch_id", "session", "seq", "enabled_seq")),
        *(
            (name, _INSTANTS)
            for name in (
                "latch", "heard_ns", "command_nonce", "enabled_nonce", "at_ns", "since_ns", "moved_by",
                "target_after_ns", "output_after_ns", "refused",
                "status", "deadline_ns",  # of the newest gate.GateOutput
            )
        ),
        *(
            (name, _FLOATS)
            for name in (
                "left", "right", "limit", "target_left", "target_right", "output_left", "output_right",
            )
        ),
    ]
)  # fmt: skip

# The fields are those of gate.Inputs; a flag says whether there is a command, a permission, a lease request.
INPUT = np.dtype(
    [
        *(
            (name, _IDS)
            for name in (
                "command_epoch", "command_session", "command_seq", "command_boot_id",
                "permission_epoch", "permission_seq", "permission_boot_id", "permission_clear", "lease_session",
            )
        ),
        *(
            (name, _INSTANTS)
            for name in (
                "command", "command_nonce", "permission", "permission_nonce", "permission_latch", "lease",
                "lease_action", "latch", "turning",
            )
        ),
        *((name, _FLOATS) for name in ("command_left", "command_right", "permission_limit")),
    ]
)  # fmt: skip

# What a gate knows of its robot.
LIMITS = np.dtype([(name, _FLOATS) for name in ("wheel_radius", "max_wheel_speed", "max_speed", "acceleration")])

_VALID_NS, _LAPSE_NS, _RAMP_NS, _LONGEST_RAMP_NS = gate.VALID_NS, gate.LAPSE_NS, gate.RAMP_NS, gate.LONGEST_RAMP_NS
_NEVER, _UNKNOWN, _TOLERANCE = gate.NEVER, gate.UNKNOWN, gate.TOLERANCE
_NONE = int(Latch.NONE)
_OPEN, _NO_COMMAND, _NO_ENABLE = int(GateStatus.OPEN), int(GateStatus.NO_COMMAND), int(GateStatus.NO_ENABLE)
_LATCHED, _NO_LEASE = int(GateStatus.LATCHED), int(GateStatus.NO_LEASE)
_RELEASE, _TAKE_OVER = int(LeaseAction.RELEASE), int(LeaseAction.TAKE_OVER)
_ONE, _NOBODY = np.uint64(1), np.uint64(0)


def limits(drives: list[DifferentialDrive]) -> NDArray[Any]:
    """Return what the gates of robots (N,) know of them."""
    rows = [(d.wheel_radius, d.max_wheel_speed, d.max_speed, d.max_wheel_acceleration) for d in drives]
    return np.array(rows, LIMITS)


@kernel
def step(g, limit, i, now_ns):  # type: ignore[no-untyped-def]  # records of GATE, LIMITS and INPUT
    """Let one gate take what arrived, as ``gate.step``; returns whether a lease was granted, or NOT_ASKED."""
    if now_ns < g.at_ns:
        started_anew(g, now_ns)
    elif now_ns - g.at_ns > _VALID_NS and not (
        g.output_left == 0.0 and g.output_right == 0.0 and g.target_left == 0.0 and g.target_right == 0.0
    ):
        _follow(g, 0.0, 0.0, math.inf, now_ns)
        g.since_ns = now_ns
    at_rest = g.output_left == 0.0 and g.output_right == 0.0 and not i.turning
    if i.latch:
        _latch(g, i.latch)
    if i.permission:
        _take_permission(g, i, at_rest and not i.latch, now_ns)
    granted = NOT_ASKED
    if i.lease:
        granted = _take_lease(g, i.lease_session, i.lease_action, at_rest, now_ns)
    if i.command:
        _take_command(g, limit, i, now_ns)
    left, right, status, until_ns = _target(g, now_ns)
    _follow(g, left, right, limit.acceleration, now_ns)
    if g.output_left != left or g.output_right != right:
        until_ns = min(now_ns + _RAMP_NS, until_ns)
    g.status, g.deadline_ns = status, until_ns
    return granted


@kernel
def started_anew(g, now_ns):  # type: ignore[no-untyped-def]
    """The clock was set back: no nonce that was given out before says anything any more."""
    g.boot_id += _ONE
    g.heard_ns = now_ns
    g.command_nonce = g.enabled_nonce = g.moved_by = g.since_ns = _NEVER
    g.enabled_seq = _NOBODY


@kernel
def _latch(g, latch):  # type: ignore[no-untyped-def]
    if latch > g.latch:
        g.latch = latch
        g.latch_id += _ONE


@kernel
def _take_permission(g, i, clearable, now_ns):  # type: ignore[no-untyped-def]
    newer = i.permission_nonce > g.enabled_nonce or (
        i.permission_nonce == g.enabled_nonce and i.permission_seq > g.enabled_seq
    )
    if not (
        _fresh(g, i.permission_boot_id, i.permission_nonce, now_ns)
        and (i.permission_epoch == g.epoch or i.permission_latch != _NONE)
        and newer
    ):
        g.refused += 1
        return
    g.enabled_nonce, g.enabled_seq, g.limit = i.permission_nonce, i.permission_seq, i.permission_limit
    if i.permission_latch:
        _latch(g, i.permission_latch)
        g.limit = 0.0
    elif g.latch and clearable and i.permission_clear != _NOBODY and i.permission_clear == g.latch_id:
        g.latch, g.limit = _NONE, 0.0


@kernel
def _take_lease(g, session, action, at_rest, now_ns):  # type: ignore[no-untyped-def]
    if session == _NOBODY:
        return 0
    if action == _RELEASE:
        if session != g.session:
            return 0
        g.session = _NOBODY
        return 1
    if session == g.session:
        return 1
    lapsed = now_ns - g.heard_ns >= _LAPSE_NS
    if not (at_rest and (g.session == _NOBODY or lapsed or action == _TAKE_OVER)):
        return 0
    g.epoch += _ONE
    g.session, g.seq = session, _NOBODY
    g.heard_ns, g.command_nonce, g.limit = now_ns, _NEVER, 0.0
    return 1


@kernel
def _take_command(g, limit, i, now_ns):  # type: ignore[no-untyped-def]
    left, right = i.command_left, i.command_right
    body = limit.wheel_radius * abs(left + right) / 2.0
    fastest = _TOLERANCE * limit.max_wheel_speed
    if not (
        _fresh(g, i.command_boot_id, i.command_nonce, now_ns)
        and i.command_epoch == g.epoch
        and i.command_session == g.session
        and g.session != _NOBODY
        and i.command_seq > g.seq
        and body <= _TOLERANCE * limit.max_speed
        and abs(left) <= fastest
        and abs(right) <= fastest
    ):
        g.refused += 1
        return
    g.seq, g.command_nonce, g.left, g.right, g.heard_ns = i.command_seq, i.command_nonce, left, right, now_ns


@kernel
def _fresh(g, boot_id, nonce, now_ns):  # type: ignore[no-untyped-def]
    return boot_id == g.boot_id and g.since_ns <= nonce <= now_ns < nonce + _VALID_NS


@kernel
def _target(g, now_ns):  # type: ignore[no-untyped-def]
    """Return what is allowed now (left, right), why, and until when that holds."""
    if g.latch:
        return 0.0, 0.0, _LATCHED, NEVER_NS
    if g.session == _NOBODY:
        return 0.0, 0.0, _NO_LEASE, NEVER_NS
    enabled_until_ns = g.enabled_nonce + _VALID_NS
    if now_ns >= enabled_until_ns or not g.limit > 0.0:
        return 0.0, 0.0, _NO_ENABLE, NEVER_NS
    command_until_ns = g.command_nonce + _VALID_NS
    if now_ns >= command_until_ns:
        return 0.0, 0.0, _NO_COMMAND, enabled_until_ns
    until_ns = min(enabled_until_ns, command_until_ns)
    if max(abs(g.left), abs(g.right)) > _TOLERANCE * g.limit:
        return 0.0, 0.0, _NO_ENABLE, until_ns
    return g.left, g.right, _OPEN, until_ns


@kernel
def _follow(g, target_left, target_right, acceleration, now_ns):  # type: ignore[no-untyped-def]
    """Move the output towards the target, and time a stop."""
    on_target = g.output_left == g.target_left and g.output_right == g.target_right
    longest_ns = _RAMP_NS if on_target else _LONGEST_RAMP_NS
    reach = acceleration * max(0, min(now_ns - g.at_ns, longest_ns)) * 1e-9
    left, right = target_left - g.output_left, target_right - g.output_right
    furthest = max(abs(left), abs(right))
    output_left, output_right = target_left, target_right
    if furthest > reach:
        ratio = reach / furthest
        output_left, output_right = g.output_left + ratio * left, g.output_right + ratio * right
    stood = g.target_left == 0.0 and g.target_right == 0.0
    rested = stood and g.output_left == 0.0 and g.output_right == 0.0
    g.target_left, g.target_right, g.output_left, g.output_right = target_left, target_right, output_left, output_right
    g.at_ns = now_ns
    if target_left != 0.0 or target_right != 0.0:
        g.moved_by = min(g.command_nonce, g.enabled_nonce)
        return
    after_ns = _UNKNOWN if g.moved_by == _NEVER else now_ns - g.moved_by
    if not stood:
        g.target_after_ns, g.output_after_ns = after_ns, _UNKNOWN
    if output_left == 0.0 and output_right == 0.0 and not rested:
        g.output_after_ns = after_ns


KERNELS = (step, started_anew)


def set_state(g: Any, state: GateState) -> None:
    """Write a gate's state into its row of GATE."""
    plain = state._asdict()
    for name, pair in (("wheels", ("left", "right")), ("target", ("target_left", "target_right"))):
        plain.update(zip(pair, plain.pop(name), strict=True))
    plain["output_left"], plain["output_right"] = plain.pop("output")
    plain["enabled_nonce"], plain["enabled_seq"] = plain.pop("enabled")
    for name, value in plain.items():
        g[name] = value


def state_of(g: Any) -> GateState:
    """Return the state of a gate, of its row of GATE."""
    v = dict(zip(GATE.names or (), g.item(), strict=True))
    return GateState(
        v["boot_id"], v["epoch"], Latch(v["latch"]), v["latch_id"], v["session"], v["heard_ns"], v["seq"],
        v["command_nonce"], WheelSpeeds(v["left"], v["right"]), (v["enabled_nonce"], v["enabled_seq"]), v["limit"],
        WheelSpeeds(v["target_left"], v["target_right"]), WheelSpeeds(v["output_left"], v["output_right"]),
        v["at_ns"], v["since_ns"], v["moved_by"], v["target_after_ns"], v["output_after_ns"], v["refused"],
    )  # fmt: skip


def output_of(g: Any, granted: int = NOT_ASKED) -> GateOutput:
    """Return what a gate decided last, of its row of GATE."""
    deadline_ns = int(g["deadline_ns"])
    return GateOutput(
        WheelSpeeds(float(g["output_left"]), float(g["output_right"])),
        WheelSpeeds(float(g["target_left"]), float(g["target_right"])),
        GateStatus(int(g["status"])),
        None if granted == NOT_ASKED else bool(granted),
        None if deadline_ns == NEVER_NS else deadline_ns,
    )


def inputs_of(i: Any) -> Inputs:
    """Return what a gate was given, of its row of INPUT."""
    v = dict(zip(INPUT.names or (), i.item(), strict=True))
    command = permission = lease = None
    if v["command"]:
        wheels = WheelSpeeds(v["command_left"], v["command_right"])
        command = gate.Command(
            v["command_epoch"], v["command_session"], v["command_seq"], v["command_boot_id"], v["command_nonce"], wheels
        )
    if v["permission"]:
        permission = gate.Permission(
            v["permission_epoch"], v["permission_seq"], v["permission_boot_id"], v["permission_nonce"],
            Latch(v["permission_latch"]), v["permission_clear"], v["permission_limit"],
        )  # fmt: skip
    if v["lease"]:
        lease = v["lease_session"], LeaseAction(v["lease_action"])
    return Inputs(command, permission, lease, Latch(v["latch"]), bool(v["turning"]))


def set_inputs(i: Any, inputs: Inputs) -> None:
    """Write what a gate is given into its row of INPUT."""
    i["command"] = i["permission"] = i["lease"] = 0
    if (command := inputs.command) is not None:
        i["command"] = 1
        for name in ("epoch", "session", "seq", "boot_id", "nonce"):
            i[f"command_{name}"] = getattr(command, name)
        i["command_left"], i["command_right"] = command.wheels
    if (permission := inputs.permission) is not None:
        i["permission"] = 1
        for name in ("epoch", "seq", "boot_id", "nonce", "latch", "clear", "limit"):
            i[f"permission_{name}"] = getattr(permission, name)
    if inputs.lease is not None:
        i["lease"], (i["lease_session"], i["lease_action"]) = 1, inputs.lease
    i["latch"], i["turning"] = inputs.latch, inputs.turning

"""Dead reckoning: the motion of a robot by its commands alone.

A command acts a delay after its tick, each robot's own; the wheels follow it with a first-order lag; the body moves
along the arcs of the wheel speeds.
"""

import numpy as np

from robofleet.core.arrays import Array, Instants
from robofleet.core.kernels import kernel, kernel_of_plain
from robofleet.tracking.filter.correction import copy
from robofleet.vehicles import differential_drive

_LONGEST_STEP_NS = 17_000_000

_arc = kernel_of_plain(differential_drive.arc)
_body_from_wheels = kernel(differential_drive.body_from_wheels)


@kernel
def advance(
    x: Array, wheels: Array, travel: Array, start_ns: int, end_ns: int,
    ticks_ns: Instants, delay_ns: int, commands: Array, motion: Array,
) -> None:  # fmt: skip
    """Move one robot from one instant to a later one, command by command.

    x (5,): x, y, psi, efficiencies; wheels (2,): as modelled [rad/s]; travel (2,): the wheels' believed travel, added
    up [m]; commands (H, 2) of the ticks ``ticks_ns`` (H,); motion: radius, base [m], lag [s].
    """
    radius, base, lag = motion[0], motion[1], motion[2]
    now = start_ns
    newest = len(ticks_ns) - 1  # command in force at the start; -1: none, the wheels are asked to rest
    while newest >= 0 and ticks_ns[newest] + delay_ns > now:
        newest -= 1
    while now < end_ns:
        until = min(end_ns, now + _LONGEST_STEP_NS)
        if newest + 1 < len(ticks_ns):
            until = min(until, max(ticks_ns[newest + 1] + delay_ns, now))
        duration = (until - now) * 1e-9
        decay = np.exp(-duration / lag) if lag > 0.0 else 0.0
        left, wheels[0] = _lagged(wheels[0], commands[newest, 0] if newest >= 0 else 0.0, lag, duration, decay)
        right, wheels[1] = _lagged(wheels[1], commands[newest, 1] if newest >= 0 else 0.0, lag, duration, decay)
        travel[0] += radius * left * duration
        travel[1] += radius * right * duration
        v, omega = _body_from_wheels(x[3] * left, x[4] * right, radius, base)
        x[0], x[1], x[2] = _arc(x[0], x[1], x[2], v, omega, duration)
        now = until
        if newest + 1 < len(ticks_ns) and ticks_ns[newest + 1] + delay_ns <= now:
            newest += 1


@kernel
def predict(
    state: Array, wheels: Array, instants_ns: Instants, tick_ns: int, ticks_ns: Instants, delays_ns: Instants,
    commands: Array, motion: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return the poses (N, 3) at a tick; and at the moment when each robot's command of that tick acts, with the
    wheels' speeds (N, 2) then, as modelled [rad/s]."""
    here, end, then = np.empty((len(state), 3)), np.empty((len(state), 3)), np.empty((len(state), 2))
    travel, x = np.zeros(2), np.empty(5)
    for i in range(len(state)):
        copy(x, state[i])
        turning, start_ns = then[i], instants_ns[i]
        copy(turning, wheels[i])
        acts_ns = tick_ns + delays_ns[i]
        if start_ns > 0:  # 0: never seen; nothing to move, and the clock's zero may be weeks ago
            advance(x, turning, travel, start_ns, tick_ns, ticks_ns, delays_ns[i], commands[:, i], motion[i])
        copy(here[i], x)
        if start_ns > 0:
            then_ns = max(start_ns, tick_ns)
            advance(x, turning, travel, then_ns, acts_ns, ticks_ns, delays_ns[i], commands[:, i], motion[i])
        copy(end[i], x)
    return here, end, then


@kernel
def disturbance(state: Array, commands: Array, motion: Array, poses: Array, point_ahead: float) -> Array:
    """Return w (N, 2): the points' velocity beyond the commands (N, 2), by the wheels' efficiencies [m/s; world]."""
    w = np.empty((len(state), 2))
    for i in range(len(state)):
        missing_left, missing_right = (state[i, 3] - 1.0) * commands[i, 0], (state[i, 4] - 1.0) * commands[i, 1]
        v, omega = _body_from_wheels(missing_left, missing_right, motion[i, 0], motion[i, 1])
        c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        w[i, 0] = c * v - s * point_ahead * omega
        w[i, 1] = s * v + c * point_ahead * omega
    return w


@kernel
def _lagged(speed: float, command: float, lag: float, duration: float, decay: float) -> tuple[float, float]:
    """Return the mean speed over ``duration`` and the speed at its end, for a first-order lag; decay: over it."""
    if lag == 0.0 or duration == 0.0:
        return command, command if duration > 0.0 else speed
    ahead = speed - command
    return command + ahead * (1.0 - decay) * lag / duration, command + ahead * decay

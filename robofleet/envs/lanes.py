"""A tick of many robots side by side: the equations of ``vehicles/plant.py`` for LANES robots in each instruction.

First each robot's tick is cut into steps in which its commands are constant: by its gate's ramp, its delay, and its
firmware's loop. Then all robots pass their first step, all pass their second one, and so on: that loop has neither
branches nor calls, so the compiler makes vector instructions of it. Nothing befalls these robots (``plant.befall``).
"""

import math
from typing import Any, NamedTuple

from robofleet.core.arrays import Array
from robofleet.core.kernels import infinite_kernel, infinite_kernel_of_plain, kernel, kernel_of_plain
from robofleet.envs import normals
from robofleet.safety import gate
from robofleet.vehicles import plant
from robofleet.vehicles.differential_drive import WHOLE, body_from_wheels, end_of_arc

LANES = normals.STREAMS
STEP = 5 * LANES  # numbers of a step of all lanes

_NS = 1e-9
_HALF_PI, _HALF_PI_REST = 1.57079632673412561417, 6.07710050650619224932e-11  # fdlibm's pi / 2, in two parts
_RAMP_NS, _NEVER_NS = gate.RAMP_NS, plant.NEVER_NS
# rows of a step: [s], commands [rad/s], as plant.decays
_DURATION, _LEFT_COMMAND, _RIGHT_COMMAND, _DECAY, _STOP_DECAY = range(0, STEP, LANES)
_WHEEL = 5 * LANES  # numbers of the left or the right wheels
_ANGLE, _SPEED, _COUNTED, _GAIN, _ROLLED = range(0, _WHEEL, LANES)
_LEFT, _RIGHT, _BODY = 0, _WHEEL, 2 * _WHEEL
LANE_ROWS = _BODY + 17 * LANES
(
    _X, _Y, _PSI, _USED, _RADIUS, _BASE, _MAX_SPEED, _MOTOR_LAG, _STOP_LAG, _QUANTUM, _PERIOD, _DEADBAND, _BREAKAWAY,
    _SLIP, _SLIP_NOISE, _SAG, _LIFE,
) = range(_BODY, LANE_ROWS, LANES)  # where rows begin  # fmt: skip

_follow, _command = kernel_of_plain(gate.follow), kernel_of_plain(plant.command)
_next_step, _setpoints = kernel_of_plain(plant.next_step), kernel_of_plain(plant.setpoints)
_decays = kernel_of_plain(plant.decays)
_draw = normals.draw


class Lane(NamedTuple):
    """What the equations need of a ``plant.Build``."""

    wheel_radius: float
    wheel_base: float
    max_wheel_speed: float
    motor_lag: float
    stop_lag: float
    speed_quantum: float
    loop_period: float
    deadband: float
    breakaway: float
    slip: float
    slip_noise: float
    top_speed_sag: float
    battery_life: float


def steps(tick_ns: int, longest_step_ns: int) -> int:
    """Return how many steps a tick has at most.

    It is cut where a gate's output is renewed, where a renewal acts after a delay, and where a firmware's loop ends.
    """
    renewals = tick_ns // gate.RAMP_NS + 2
    return 2 * renewals + tick_ns // longest_step_ns


@kernel
def drive(  # type: ignore[no-untyped-def]
    bodies, builds, coming, gates, drives, wheels, now_ns, tick_ns, plan, lanes, streams, noise
):  # fmt: skip
    """Let robots (R,) obey wheels (R, 2) [rad/s] for a tick, each behind its gate's ramp.

    plan, lanes, noise: room for as many STEP as ``steps`` says, for LANE_ROWS and for two LANES numbers.
    """
    for begin in range(0, len(bodies), LANES):
        count, most = min(LANES, len(bodies) - begin), 0
        for k in range(_DURATION, len(plan), STEP):
            for i in range(LANES):
                plan[k + i] = 0.0
        for i in range(count):
            r = begin + i
            used = _cut(
                bodies[r], builds[r], coming[r], gates[r], drives[r % len(drives)], wheels[r, 0], wheels[r, 1], now_ns,
                now_ns + tick_ns, plan, i,
            )  # fmt: skip
            most = max(most, used)
            _load(bodies[r], builds[r], lanes, i)
        for k in range(most):
            _draw(streams, noise)
            _step(lanes, plan[k * STEP : (k + 1) * STEP], noise)
        for i in range(count):
            _store(bodies[begin + i], lanes, i)


@kernel
def _cut(b, p, coming, g, drive, left, right, now_ns, end_ns, plan, i):  # type: ignore[no-untyped-def]
    """Write the steps of lane i, and return how many they are."""
    at, at_ns = i, now_ns
    duration_ns, decay, stop_decay = 0, 0.0, 0.0
    while True:
        _follow(g, left, right, drive.max_wheel_acceleration, at_ns)
        _command(b, p, coming, g.output_left, g.output_right, _NEVER_NS)
        arrived = g.output_left == left and g.output_right == right
        at_ns = end_ns if arrived else min(at_ns + _RAMP_NS, end_ns)
        while b.reached_ns < at_ns:
            step_ns = _next_step(b, p, coming, at_ns)
            if step_ns != duration_ns:
                duration_ns, (decay, stop_decay) = step_ns, _decays(p, step_ns * _NS)
            plan[at + _DURATION], plan[at + _DECAY], plan[at + _STOP_DECAY] = step_ns * _NS, decay, stop_decay
            plan[at + _LEFT_COMMAND], plan[at + _RIGHT_COMMAND] = _setpoints(b, p)
            at += STEP
            b.reached_ns += step_ns
        if at_ns == end_ns:
            return at // STEP


@kernel
def _load(b, p, lanes, i):  # type: ignore[no-untyped-def]
    lanes[_X + i], lanes[_Y + i], lanes[_PSI + i], lanes[_USED + i] = b.x, b.y, b.psi, b.used
    lanes[_LEFT + _ANGLE + i], lanes[_RIGHT + _ANGLE + i] = b.left_angle, b.right_angle
    lanes[_LEFT + _SPEED + i], lanes[_RIGHT + _SPEED + i] = b.left_speed, b.right_speed
    lanes[_LEFT + _COUNTED + i], lanes[_RIGHT + _COUNTED + i] = b.left_counted, b.right_counted
    lanes[_LEFT + _GAIN + i], lanes[_RIGHT + _GAIN + i] = p.left_gain, p.right_gain
    lanes[_RADIUS + i], lanes[_BASE + i], lanes[_MAX_SPEED + i] = p.wheel_radius, p.wheel_base, p.max_wheel_speed
    lanes[_MOTOR_LAG + i], lanes[_STOP_LAG + i] = p.motor_lag, p.stop_lag
    lanes[_QUANTUM + i], lanes[_PERIOD + i] = p.speed_quantum, p.loop_period
    lanes[_DEADBAND + i], lanes[_BREAKAWAY + i] = p.deadband, p.breakaway
    lanes[_SLIP + i], lanes[_SLIP_NOISE + i] = p.slip, p.slip_noise
    lanes[_SAG + i], lanes[_LIFE + i] = p.top_speed_sag, p.battery_life


@kernel
def _store(b, lanes, i):  # type: ignore[no-untyped-def]
    b.x, b.y, b.psi, b.used = lanes[_X + i], lanes[_Y + i], lanes[_PSI + i], lanes[_USED + i]
    b.left_angle, b.right_angle = lanes[_LEFT + _ANGLE + i], lanes[_RIGHT + _ANGLE + i]
    b.left_speed, b.right_speed = lanes[_LEFT + _SPEED + i], lanes[_RIGHT + _SPEED + i]
    b.left_counted, b.right_counted = lanes[_LEFT + _COUNTED + i], lanes[_RIGHT + _COUNTED + i]


@infinite_kernel
def _sin_cos(x: float) -> tuple[float, float]:
    """Return sine and cosine of an angle of a few turns at most, within 1e-15, without a branch or a call.

    The polynomials are those of Moshier's Cephes, for [-pi / 4, pi / 4].
    """
    quarters = _rounded(x * (2.0 / math.pi))
    r = (x - quarters * _HALF_PI) - quarters * _HALF_PI_REST
    z = r * r
    s = r + r * z * (
        -1.66666666666666307295e-1 + z * (8.33333333332211858878e-3 + z * (-1.98412698295895385996e-4 + z * (
            2.75573136213857245213e-6 + z * (-2.50507477628578072866e-8 + z * 1.58962301576546568060e-10))))
    )  # fmt: skip
    c = 1.0 - 0.5 * z + z * z * (
        4.16666666666665929218e-2 + z * (-1.38888888888730564116e-3 + z * (2.48015872888517045348e-5 + z * (
            -2.75573141792967388112e-7 + z * (2.08757008419747316778e-9 + z * -1.13585365213876817300e-11))))
    )  # fmt: skip
    part = quarters - 4.0 * _rounded(0.25 * quarters - 0.375)  # 0 to 3
    sine, cosine = (c, s) if abs(part - 2.0) == 1.0 else (s, c)
    return (-sine if part >= 2.0 else sine), (-cosine if abs(part - 1.5) == 0.5 else cosine)


@infinite_kernel
def _rounded(x: float) -> float:
    return (x + WHOLE) - WHOLE


def turn(lanes: Array, plan: Array, wheel: int, command: int) -> None:
    """Let the left or the right wheels of all lanes turn for a step; a lane that has no such step stays as it is.

    Their mean speeds, as the floor would see them without slip, are written, too.
    """
    for i in range(LANES):
        p, duration = _lane(lanes, i), plan[_DURATION + i]
        before = lanes[wheel + _ANGLE + i], lanes[wheel + _SPEED + i], lanes[wheel + _COUNTED + i]
        mean, angle, speed, counted = plant.turned(
            p, before[0], before[1], before[2], plan[command + i], plant.top_speed(p, lanes[_USED + i] + duration),
            duration, plan[_DECAY + i], plan[_STOP_DECAY + i],
        )  # fmt: skip
        rolled = lanes[wheel + _GAIN + i] * mean
        if duration == 0.0:  # chosen before it is stored: a store on condition takes long
            (angle, speed, counted), rolled = before, 0.0
        lanes[wheel + _ANGLE + i], lanes[wheel + _SPEED + i], lanes[wheel + _COUNTED + i] = angle, speed, counted
        lanes[wheel + _ROLLED + i] = rolled


def move(lanes: Array, plan: Array, noise: Array) -> None:
    """Let the bodies of all lanes move as their wheels turned."""
    for i in range(LANES):
        p, duration = _lane(lanes, i), plan[_DURATION + i]
        left, right = plant.slipped(
            p, lanes[_LEFT + _ROLLED + i], lanes[_RIGHT + _ROLLED + i], noise[i], noise[LANES + i]
        )
        v, omega = body_from_wheels(left, right, p.wheel_radius, p.wheel_base)
        half = omega * duration / 2.0
        sin_half, _ = _sin_cos(half)
        s, c = _sin_cos(lanes[_PSI + i] + half)
        x, y, psi = end_of_arc(lanes[_X + i], lanes[_Y + i], lanes[_PSI + i], v * duration, half, sin_half, s, c)
        lanes[_X + i], lanes[_Y + i], lanes[_PSI + i] = x, y, psi
        lanes[_USED + i] += duration


def _lane(lanes: Array, i: int) -> Any:
    return Lane(
        lanes[_RADIUS + i], lanes[_BASE + i], lanes[_MAX_SPEED + i], lanes[_MOTOR_LAG + i], lanes[_STOP_LAG + i],
        lanes[_QUANTUM + i], lanes[_PERIOD + i], lanes[_DEADBAND + i], lanes[_BREAKAWAY + i], lanes[_SLIP + i],
        lanes[_SLIP_NOISE + i], lanes[_SAG + i], lanes[_LIFE + i],
    )  # fmt: skip


def step(lanes: Array, plan: Array, noise: Array) -> None:
    """Let all lanes pass a step, as ``plant.step``."""
    turn(lanes, plan, _LEFT, _LEFT_COMMAND)
    turn(lanes, plan, _RIGHT, _RIGHT_COMMAND)
    move(lanes, plan, noise)


_step = infinite_kernel_of_plain(step)

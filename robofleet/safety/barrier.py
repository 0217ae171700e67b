"""The barrier: what every robot was asked for, changed as little as keeps bodies apart and inside the arena.

A robot is held by where it would stand if it were stopped now. Its wheels follow with a first-order lag, so that pose
is an arc of what the wheels still turn; it does not move while the robot is asked to stop, and its velocity is linear
in the command, lag included. The barrier's point q is ``ahead`` in front of its axle: there the command moves it in
all directions. With Delta = q_i - q_j, n its direction, and h = |Delta| - D_ij, each of two robots keeps

    n . q_i' >= -gamma h / 2.

Half of the approach is each one's own, so a robot that stands still by mistake is as safe as one that obeys, and what
is left is a problem of two unknowns for each robot. The arena's edges are rows of the same kind, the robot's alone;
the wheels' limits are rows too. Within D_ij a robot must withdraw; where it cannot from all, it must not come nearer,
and standing is always an answer. A robot that others have held for a while asks for something else: to pass them on
the right.

A bystander, a robot that nobody drives, keeps nothing: it stands, or a hand pushes it with a velocity w that was seen.
Each robot i keeps its own half, and beside it all that the bystander j comes nearer by:

    n . q_i' >= -gamma h / 2 + max(0, n . w_j).

So h' >= -gamma h / 2 as long as i can withdraw so fast, and the other half is what a hand may do before it is seen.

Bodies are |Delta| - 2 ahead - radii apart at least. D_ij adds the gap that is asked for, both poses' errors, and how
far a robot is believed to have gone that in truth stands: its top speed for the age of the newest image, the delay of
a command, and the lag. A robot that is not seen for longer grows by its top speed until it is made to stand.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.kernels import kernel
from robofleet.vehicles import differential_drive
from robofleet.vehicles.differential_drive import DifferentialDrive

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

LEFT_ALONE, CHANGED, NO_ANSWER = 0, 1, 2

_TOLERANCE = 1e-9  # of a row [m/s]
_CHECKED = 1e-6  # of the answer [m/s]
_INSIDE = 1.0 - 1e-9  # a wheel stays inside its limit whatever is rounded later
_WANTED = 0.5  # of its top speed: who asks for less waits, as behind a robot that stalls, and is not held
_GRANTED = 0.1  # of what was wanted; with less a robot does not get on
_WITHDRAWING = 0.5  # of its top speed, at most
_AROUND_S = 0.5  # held for so long, a robot turns aside
_COS, _SIN = math.cos(math.radians(80.0)), math.sin(math.radians(80.0))  # by so much; less does not pass a crowd
_BLOCKED_S = 3.0
_WALLS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))  # outwards

_arc = kernel(differential_drive.arc)
_body_from_wheels = kernel(differential_drive.body_from_wheels)
_wheels_from_body = kernel(differential_drive.wheels_from_body)


@dataclass(frozen=True)
class Keepout:
    """What the barrier keeps."""

    gap: float  # between two bodies [m]
    ahead: float  # of the point q in front of the axle [m]
    rate: float  # gamma: how fast a distance may be used up [1/s]
    pose_error: float  # of an estimated pose [m]
    age: float  # of the newest image at a tick, at most [s]
    lost_after: float  # then a robot that is not seen is made to stand [s]
    point_ahead: float  # l: of the point whose velocity is changed least [m]
    tick: float  # control step [s]
    arena: tuple[float, float]  # size [m]


class Body(NamedTuple):
    """One robot: its drive, its disc [m], and from a tick to when its command acts [s]."""

    drive: DifferentialDrive
    radius: float
    delay: float


def apart(keepout: Keepout, one: Body, other: Body) -> float:
    """Return D: the least distance of two robots' points q [m]."""
    believed = max(b.drive.max_speed * (keepout.age + b.delay + b.drive.motor_lag) for b in (one, other))
    return one.radius + other.radius + keepout.gap + 2 * (keepout.ahead + keepout.pose_error) + believed


def from_edge(keepout: Keepout, body: Body) -> float:
    """Return the least distance of a robot's point q from the arena's edge [m]."""
    return body.radius + keepout.ahead + keepout.pose_error


def _fastest(keepout: Keepout, body: Body) -> float:
    """Return what no point q of such a robot exceeds [m/s]."""
    d = body.drive
    omega = 2 * d.wheel_radius * d.max_wheel_speed / d.wheel_base
    return d.max_speed + omega * (keepout.ahead + d.max_speed * d.motor_lag)


class Barrier:
    """The barrier of a group of N robots among M >= N bodies. It remembers for how long it has held each robot.

    ``bodies``: the robots first, then the bystanders.
    """

    def __init__(self, keepout: Keepout, bodies: tuple[Body, ...]) -> None:
        self._keepout = keepout
        self._bodies = np.array(
            [
                (b.drive.wheel_radius, b.drive.wheel_base, b.drive.motor_lag, b.drive.max_wheel_speed,
                 b.drive.max_speed, from_edge(keepout, b), _fastest(keepout, b))
                for b in bodies
            ]
        )  # fmt: skip
        self._apart = np.array([[apart(keepout, one, other) for other in bodies] for one in bodies])
        self._half = np.array(keepout.arena) / 2
        self._still = np.zeros((len(bodies), 2))
        self._held = np.zeros(len(bodies), dtype=np.int64)  # ticks in a row
        self._around_ticks = round(_AROUND_S / keepout.tick)
        self._blocked_ticks = round(_BLOCKED_S / keepout.tick)

    def filter(
        self,
        poses: Array,
        turning: Array,
        unseen: Array,
        driving: NDArray[np.bool_],
        wheels: Array,
        u: Array,
        pushed: Array | None = None,
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Change what robots are asked for, where they must be: ``wheels`` and ``u`` are written over.

        poses (M, 3): x, y [m], psi [rad] when the commands act; turning (M, 2): the wheels' speeds then [rad/s]; unseen
        (M,): age of the newest image of each body [s], infinite for one that never was seen and is nowhere.
        pushed (M, 2): velocity of each bystander [m/s; world], 0 of a robot, whose wheels tell it; None: all stand.
        driving (N,): the others stand, whatever is near. wheels (N, 2) [rad/s] and u (N, 2) [m/s; world]: the commands,
        and the velocity of the points p that they are. Returns for each robot LEFT_ALONE, CHANGED or NO_ANSWER (it
        stands); and whether it has been held for so long that it will not get on by itself.
        """
        k = self._keepout
        how = np.zeros(len(wheels), dtype=np.int64)
        pushed = self._still if pushed is None else pushed
        _filter(
            poses, turning, unseen, pushed, driving, self._bodies, self._apart, self._half, k.ahead, k.rate,
            k.point_ahead, k.age, k.lost_after, wheels, u, self._around_ticks, how, self._held,
        )  # fmt: skip
        return how, self._held[: len(wheels)] >= self._blocked_ticks


@kernel
def _filter(
    poses: Array, turning: Array, unseen: Array, pushed: Array, driving: NDArray[np.bool_], bodies: Array,
    apart: Array, half: Array, ahead: float, rate: float, l: float, age: float, lost_after: float,
    wheels: Array, u: Array, around: int, how: Instants, held: Instants,
) -> None:  # fmt: skip
    n = len(poses)
    stops, grown = np.empty((n, 6)), np.empty(n)
    for i in range(n):
        _stop(poses[i], turning[i], bodies[i], ahead, l, stops[i])
        grown[i] = bodies[i, 4] * min(max(unseen[i] - age, 0.0), lost_after)
    rows = np.empty((10 + n, 3))
    for i in range(len(wheels)):
        if not driving[i]:
            held[i] = 0
            continue
        back = -_WITHDRAWING * bodies[i, 4]
        first = _edges(rows, _limits(rows, bodies[i], l), stops[i], half, bodies[i, 5] + grown[i], rate, back)
        count = first
        for j in range(n):
            if j != i and unseen[j] < np.inf:
                near = apart[i, j] + grown[i] + grown[j]
                count = _pair(rows, count, stops[i], stops[j], pushed[j], near, rate, bodies[i], back)
        v, omega = _body_from_wheels(wheels[i, 0], wheels[i, 1], bodies[i, 0], bodies[i, 1])
        x, y = v, l * omega
        met = _excess(x, y, rows[first:count]) > _TOLERANCE
        if met and held[i] >= around:
            x, y = _COS * x + _SIN * y, _COS * y - _SIN * x
        along, across = _nearest(x, y, rows[:count])
        wanted, granted = v * v + l * omega * l * omega, v * along + l * omega * across
        if not met:
            held[i] = max(0, held[i] - 1)
        elif wanted > (_WANTED * bodies[i, 4]) ** 2 and granted < _GRANTED * wanted:
            held[i] += 1
        if along != v or across != l * omega:
            how[i] = CHANGED
            if not np.isfinite(along + across):
                how[i], along, across = NO_ANSWER, 0.0, 0.0
            wheels[i, 0], wheels[i, 1] = _wheels_from_body(along, across / l, bodies[i, 0], bodies[i, 1])
            c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
            u[i, 0], u[i, 1] = c * along - s * across, s * along + c * across


@kernel
def _stop(pose: Array, turning: Array, body: Array, ahead: float, l: float, stop: Array) -> None:
    """Write q of the pose where a robot comes to rest [m], and its velocity by one of v, and by one of l omega."""
    lag = body[2]
    v, omega = _body_from_wheels(turning[0], turning[1], body[0], body[1])
    x, y, psi = _arc(pose[0], pose[1], pose[2], v, omega, lag)
    half = omega * lag / 2.0
    chord, slope = 1.0 - half * half / 6.0, -half / 3.0  # sin(half) / half, and its derivative
    if abs(half) > 1e-4:
        chord = np.sin(half) / half
        slope = (np.cos(half) - chord) / half
    along, c, s = v * lag / 2.0, np.cos(pose[2] + half), np.sin(pose[2] + half)
    ahead_x, ahead_y = ahead * np.cos(psi), ahead * np.sin(psi)
    stop[0], stop[1], stop[2], stop[3] = x + ahead_x, y + ahead_y, chord * c, chord * s
    stop[4] = (along * (slope * c - chord * s) - ahead_y) / l
    stop[5] = (along * (slope * s + chord * c) + ahead_x) / l


@kernel
def _limits(rows: Array, body: Array, l: float) -> int:
    """Write the rows of the wheels and of the body: what the robot can do."""
    turn, fastest, count = body[1] / (2.0 * l), body[0] * body[3] * _INSIDE, 0
    for sign in (1.0, -1.0):
        count = _add(rows, count, sign, sign * turn, fastest)
        count = _add(rows, count, sign, -sign * turn, fastest)
        count = _add(rows, count, sign, 0.0, body[4] * _INSIDE)
    return count


@kernel
def _edges(rows: Array, count: int, stop: Array, half: Array, margin: float, rate: float, back: float) -> int:
    for out_x, out_y in _WALLS:
        left = abs(out_x) * half[0] + abs(out_y) * half[1] - margin - out_x * stop[0] - out_y * stop[1]
        along, across = out_x * stop[2] + out_y * stop[3], out_x * stop[4] + out_y * stop[5]
        count = _add(rows, count, along, across, max(rate * left, back))
    return count


@kernel
def _pair(
    rows: Array, count: int, stop: Array, other: Array, pushed: Array, apart: float, rate: float, body: Array,
    back: float,
) -> int:  # fmt: skip
    hurry = np.hypot(pushed[0], pushed[1])
    x, y, reach = other[0] - stop[0], other[1] - stop[1], apart + 2.0 * (body[6] + hurry) / rate
    squared = x * x + y * y
    if squared == 0.0 or squared > reach * reach:
        return count  # no direction is away from it; or nothing that the robot can do breaks the row
    distance = np.sqrt(squared)
    towards_x, towards_y = x / distance, y / distance
    along = towards_x * stop[2] + towards_y * stop[3]
    across = towards_x * stop[4] + towards_y * stop[5]
    coming = max(0.0, -towards_x * pushed[0] - towards_y * pushed[1])
    return _add(rows, count, along, across, max(rate * (distance - apart) / 2.0 - coming, back))


@kernel
def _add(rows: Array, count: int, along: float, across: float, limit: float) -> int:
    """Write along v + across (l omega) <= limit, scaled to a normal of size 1."""
    size = np.hypot(along, across)
    if size < _TOLERANCE:
        return count  # nothing that the robot does changes it
    rows[count, 0], rows[count, 1], rows[count, 2] = along / size, across / size, limit / size
    return count + 1


@kernel
def _nearest(x: float, y: float, rows: Array) -> tuple[float, float]:
    """Return the point nearest to (x, y) that keeps all rows, and has been checked to; NaN if there is none."""
    if _excess(x, y, rows) <= _TOLERANCE:
        return x, y
    along, across = _project(x, y, rows)
    if not _excess(along, across, rows) <= _CHECKED:  # it cannot withdraw from all: not nearer to any
        for k in range(len(rows)):
            rows[k, 2] = max(rows[k, 2], 0.0)
        along, across = _project(x, y, rows)
        if not _excess(along, across, rows) <= _CHECKED:
            return np.nan, np.nan
    return along, across


@kernel
def _excess(x: float, y: float, rows: Array) -> float:
    """Return by how much the worst row is broken; NaN where anything is not finite."""
    worst, finite = 0.0, 0.0
    for k in range(len(rows)):
        over = rows[k, 0] * x + rows[k, 1] * y - rows[k, 2]
        worst, finite = max(worst, over), finite + 0.0 * over
    return worst + finite


@kernel
def _project(x0: float, y0: float, rows: Array) -> tuple[float, float]:
    """Return the point nearest to (x0, y0) that keeps all rows, NaN if there is none.

    Row by row: if the newest one is broken, the answer lies on its line, between what the rows before it cut off.
    """
    x, y = x0, y0
    for k in range(len(rows)):
        a, b, limit = rows[k, 0], rows[k, 1], rows[k, 2]
        if a * x + b * y <= limit + _TOLERANCE:
            continue
        over = a * x0 + b * y0 - limit
        x, y = x0 - over * a, y0 - over * b
        low, high = -np.inf, np.inf
        for j in range(k):
            left, along = rows[j, 2] - rows[j, 0] * x - rows[j, 1] * y, rows[j, 1] * a - rows[j, 0] * b
            if abs(along) < _TOLERANCE:
                if left < -_CHECKED:
                    return np.nan, np.nan
            elif along > 0.0:
                high = min(high, left / along)
            else:
                low = max(low, left / along)
        if low > high + _CHECKED:
            return np.nan, np.nan
        shift = min(max(0.0, low), high)
        x, y = x - shift * b, y + shift * a
    return x, y

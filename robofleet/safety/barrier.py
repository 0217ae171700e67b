"""The barrier, a control barrier function (CBF) for each pair of robots; ``deadlock.py`` resolves their deadlocks.

It changes what every robot was asked for as little as keeps bodies apart, clear of obstacles and inside the arena.

A robot is held by where it would stand if it were stopped now. Its wheels follow with a first-order lag, so that pose
is an arc of what the wheels still turn; it does not move while the robot is asked to stop, and its velocity is linear
in the command, lag included. The barrier's point q is ``ahead`` in front of its axle: there the command moves it in
all directions. With Delta = q_i - q_j, n its direction, and h = |Delta| - D_ij, each of two robots keeps

    n . q_i' >= -gamma h / 2.

Half of the approach is each one's own, so a robot that stands still by mistake is as safe as one that obeys, and what
is left is a problem of two unknowns for each robot. The arena's edges and obstacles are rows of the same kind, the
robot's alone, with gamma h instead of its half; the wheels' limits are rows too. Within D_ij a robot must withdraw;
where it cannot from all, it must not come nearer, and standing is always an answer.

A bystander, a robot that nobody drives, keeps nothing: it stands, or a hand pushes it with a velocity w that was seen.
Each robot i keeps its own half, and beside it all that the bystander j comes nearer by:

    n . q_i' >= -gamma h / 2 + max(0, n . w_j).

So h' >= -gamma h / 2 as long as i can withdraw so fast, and the other half is what a hand may do before it is seen.

Bodies are |Delta| - 2 ahead - radii apart at least. D_ij adds the gap that is asked for, both poses' errors, and how
far a robot is believed to have gone that in truth stands: the fastest that it was lately asked for, for the age of the
newest image, the delay of a command, and the lag. So robots that are slow, or stand, may be nearer; and a robot that is
near another is no faster than their distance allows. Its speed of this tick counts in the next, when h has shrunk to
(1 - gamma tick) h at least: with b = |Delta| - D_ij without what is believed, and e believed so far,

    |v| (age + delay + lag) <= (1 - gamma tick) b + gamma tick e

keeps h >= 0. A robot that is not seen for longer grows by its top speed until it is made to stand.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array, Instants
from robofleet.core.kernels import kernel, kernel_of_plain
from robofleet.safety import deadlock, solid_rows
from robofleet.safety.distances import Body, Keepout, believed_for, from_edge
from robofleet.safety.neighbours import around, sorted_into_cells
from robofleet.vehicles import differential_drive, solids

LEFT_ALONE, CHANGED, NO_ANSWER = 0, 1, 2

_INSIDE = 1.0 - 1e-9  # a wheel stays inside its limit whatever is rounded later
_CREEPING = 0.075  # of its top speed: so fast a robot may be at any distance
_WITHDRAWING = 0.5  # of its top speed, at most
# of a body: its drive, its edge's margin [m], its fastest q [m/s], how long its speed is believed [s], its disc [m]
_WHEEL, _BASE, _LAG, _WHEEL_SPEED, _TOP, _EDGE, _FASTEST, _BELIEVED, _DISC = range(9)
_WALLS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))  # outwards

_arc = kernel_of_plain(differential_drive.arc)
_body_from_wheels = kernel(differential_drive.body_from_wheels)
_wheels_from_body = kernel(differential_drive.wheels_from_body)
_add_row, _solid_rows = solid_rows.add_row, solid_rows.solid_rows
_OBSTACLE, _asks, _answer, _watch = deadlock.OBSTACLE, deadlock.asks, deadlock.answer, deadlock.watch
_is_blocked = deadlock.is_blocked


def _fastest(keepout: Keepout, body: Body) -> float:
    """Return what no point q of such a robot exceeds [m/s]."""
    d = body.drive
    omega = 2 * d.wheel_radius * d.max_wheel_speed / d.wheel_base
    return d.max_speed + omega * (keepout.ahead + d.max_speed * d.motor_lag)


class Filtered(NamedTuple):
    """What the barrier lets through."""

    wheels: Array  # (N, 2) [rad/s]
    u: Array  # (N, 2) velocities of the points p [m/s; world]
    change: Instants  # (N,) LEFT_ALONE, CHANGED or NO_ANSWER: then the robot stands
    blocked: NDArray[np.bool_]  # (N,) who will not get on by itself


class Constants(NamedTuple):
    """What never changes of a barrier, as its kernel takes it."""

    bodies: Array  # (M, 9), columns as above
    between: tuple[float, float]  # beside two discs, as apart_at_rest [m]
    half: Array  # (2,) half the arena's size [m]
    edges: Array  # of the solids
    rings: Array
    floors: int  # of the rings, the first
    ahead: float  # this line and the next five: as Keepout
    rate: float
    point_ahead: float
    age: float
    lost_after: float
    tick: float
    times: tuple[int, int, int, int]  # of deadlocks [ticks]
    patience: tuple[int, int]  # [ticks]


class BarrierState(NamedTuple):
    """What a barrier remembers of its bodies (M,)."""

    holds: Instants  # (M, MEMORY)
    lately: Array  # (M, ticks) speeds that were asked for [m/s]
    deadlocks: Array  # (M, TOLD)


def constants(keepout: Keepout, bodies: tuple[Body, ...]) -> Constants:
    floors_first = sorted(keepout.solids, key=lambda solid: not solid.floor)
    return Constants(
        bodies=np.array(
            [
                (b.drive.wheel_radius, b.drive.wheel_base, b.drive.motor_lag, b.drive.max_wheel_speed,
                 b.drive.max_speed, from_edge(keepout, b), _fastest(keepout, b), believed_for(keepout, b), b.radius)
                for b in bodies
            ]
        ),
        between=(keepout.gap, 2 * (keepout.ahead + keepout.pose_error)),
        half=np.array(keepout.arena) / 2,
        edges=solids.outlines(floors_first).edges, rings=solids.outlines(floors_first).rings,
        floors=sum(solid.floor for solid in floors_first),
        ahead=keepout.ahead, rate=keepout.rate, point_ahead=keepout.point_ahead, age=keepout.age,
        lost_after=keepout.lost_after, tick=keepout.tick,
        times=deadlock.in_ticks(keepout.tick), patience=deadlock.patience(keepout.tick),
    )  # fmt: skip


def fresh(k: Constants) -> BarrierState:
    """Return the memory of a barrier at first: as long as nothing is known of their commands, all are fast."""
    n, ticks = len(k.bodies), math.ceil(k.bodies[:, _BELIEVED].max() / k.tick) + 1
    return BarrierState(
        np.zeros((n, deadlock.MEMORY), dtype=np.int64), np.repeat(k.bodies[:, _TOP : _TOP + 1], ticks, axis=1),
        np.zeros((n, deadlock.TOLD)),
    )  # fmt: skip


class Barrier:
    """The barrier of a group of N robots among M >= N bodies. It remembers how long it has held each.

    ``bodies``: the robots first, then the bystanders.
    """

    def __init__(self, keepout: Keepout, bodies: tuple[Body, ...]) -> None:
        self._constants = constants(keepout, bodies)
        self._memory = fresh(self._constants)
        self._still = np.zeros((len(bodies), 2))

    def filter(
        self,
        poses: Array,
        turning: Array,
        unseen: Array,
        driving: NDArray[np.bool_],
        wheels: Array,
        u: Array,
        pushed: Array | None = None,
    ) -> Filtered:
        """Return what robots are asked for, changed where it must be.

        poses (M, 3): x, y [m], psi [rad] when the commands act; turning (M, 2): the wheels' speeds then [rad/s]; unseen
        (M,): age of the newest image of each body [s], infinite for one that never was seen and is nowhere.
        pushed (M, 2): velocity of each bystander [m/s; world], 0 of a robot, whose wheels tell it; None: all stand.
        driving (N,): the others stand, whatever is near. wheels (N, 2) [rad/s] and u (N, 2) [m/s; world]: the commands,
        and the velocity of the points p that they are.
        """
        n = len(wheels)
        wheels, u, pushed = wheels.copy(), u.copy(), self._still if pushed is None else pushed
        change, blocked = np.zeros(n, dtype=np.int64), np.empty(n, dtype=np.bool_)
        filter_commands(
            poses,
            turning,
            unseen,
            pushed,
            driving,
            wheels,
            u,
            change,
            blocked,
            *self._memory,
            *self._constants,  # type: ignore[arg-type]
        )
        return Filtered(wheels, u, change, blocked)


@kernel
def filter_commands(
    poses: Array, turning: Array, unseen: Array, pushed: Array, driving: NDArray[np.bool_],
    wheels: Array, u: Array, change: Instants, blocked: NDArray[np.bool_],
    memory: Instants, lately: Array, deadlocks: Array,
    bodies: Array, between: tuple[float, float], half: Array, edges: Array, rings: Array, floors: int, ahead: float,
    rate: float, l: float, age: float, lost_after: float, tick: float, times: tuple[int, int, int, int],
    patience: tuple[int, int],
) -> None:  # fmt: skip
    """Change the commands (N, 2) in place, as ``Barrier.filter`` does; last: ``BarrierState``, ``Constants``."""
    n = len(poses)
    stops, grown, believed = np.empty((n, 6)), np.empty(n), np.empty(n)
    for i in range(n):
        _stop(poses[i], turning[i], bodies[i], ahead, l, stops[i])
        grown[i] = bodies[i, _TOP] * min(max(unseen[i] - age, 0.0), lost_after)
        v, _ = _body_from_wheels(turning[i, 0], turning[i, 1], bodies[i, _WHEEL], bodies[i, _BASE])
        believed[i] = bodies[i, _BELIEVED] * max(abs(v), _largest(lately[i]))
    asking = np.zeros(n, dtype=np.bool_)
    for i in range(len(wheels)):
        v, omega = _body_from_wheels(wheels[i, 0], wheels[i, 1], bodies[i, _WHEEL], bodies[i, _BASE])
        asking[i] = _asks(v, l * omega, driving[i], bodies[i, _TOP], memory[i])
    share = min(1.0, rate * tick)
    grid = sorted_into_cells(stops, unseen < np.inf, _reach(bodies, between, grown, believed, pushed, rate, share))
    near, found = np.empty(n), np.empty(n, dtype=np.int64)
    most = 10 + n + 2 * len(edges)
    rows, whose = np.empty((most, 3)), np.empty(most, dtype=np.int64)
    for i in range(len(wheels)):
        if not driving[i]:
            memory[i] = 0
            continue
        back, fastest = -_WITHDRAWING * bodies[i, _TOP], bodies[i, _TOP]
        others = around(grid, stops, i, found)
        for k in range(others):
            j = found[k]
            near[k] = bodies[i, _DISC] + bodies[j, _DISC] + between[0] + between[1] + grown[i] + grown[j]
            fastest = min(fastest, _speed(stops[i], stops[j], near[k], believed[i], believed[j], share, bodies[i]))
        margin = bodies[i, _EDGE] + grown[i]
        first = _edges(rows, _limits(rows, bodies[i], l, fastest), stops[i], half, margin, rate, back)
        count = first
        if len(rings) > 0:
            fast = bodies[i, _FASTEST]
            for k in range(2):
                solid = rings[:floors] if k == 0 else rings[floors:]
                first, count = count, _solid_rows(rows, count, stops[i], edges, solid, margin, rate, fast, back)
            whose[first:count] = _OBSTACLE
        for k in range(others):
            j = found[k]
            whose[count] = j
            apart = near[k] + max(believed[i], believed[j])
            count = _pair(rows, count, stops[i], stops[j], pushed[j], apart, rate, bodies[i], back)
        v, omega = _body_from_wheels(wheels[i, 0], wheels[i, 1], bodies[i, _WHEEL], bodies[i, _BASE])
        along, across = _answer(v, l * omega, rows[:count], first, whose, bodies[i, _TOP], asking, times, i, memory)
        if along != v or across != l * omega:
            change[i] = CHANGED
            if not np.isfinite(along + across):
                change[i], along, across = NO_ANSWER, 0.0, 0.0
            wheels[i, 0], wheels[i, 1] = _wheels_from_body(along, across / l, bodies[i, _WHEEL], bodies[i, _BASE])
            c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
            u[i, 0], u[i, 1] = c * along - s * across, s * along + c * across
    for i in range(len(wheels)):
        v, omega = _body_from_wheels(wheels[i, 0], wheels[i, 1], bodies[i, _WHEEL], bodies[i, _BASE])
        for k in range(lately.shape[1] - 1):
            lately[i, k] = lately[i, k + 1]
        lately[i, -1] = abs(v)
        _watch(poses[i], v * tick, l * omega * tick, l, times[3], deadlocks[i], memory[i])
        blocked[i] = _is_blocked(memory[i], patience)


@kernel
def _largest(values: Array) -> float:
    """Return the largest value, NaN if there is one: values.max() takes a second to compile."""
    largest = values[0]
    for value in values:
        if value > largest or np.isnan(value):
            largest = value
    return float(largest)


@kernel
def _reach(
    bodies: Array, between: tuple[float, float], grown: Array, believed: Array, pushed: Array, rate: float, share: float
) -> float:
    """Return the distance beyond which no body's row can be broken, and no body slows another one [m]."""
    disc, fastest_push, margin, fastest, slowing = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(bodies)):
        disc, margin, fastest = max(disc, bodies[i, _DISC]), max(margin, grown[i]), max(fastest, bodies[i, _FASTEST])
        fastest_push = max(fastest_push, np.hypot(pushed[i, 0], pushed[i, 1]))
        counts = bodies[i, _TOP] * bodies[i, _BELIEVED]  # so far from what is kept a robot has its top speed
        if counts > 0.0:
            slowing = max(slowing, counts / (1.0 - share) if share < 1.0 else np.inf)
    pressed = _largest(believed) + 2.0 * (fastest + fastest_push) / rate
    return float(2.0 * (disc + margin) + between[0] + between[1] + max(pressed, slowing))


@kernel
def _speed(stop: Array, other: Array, near: float, own: float, others: float, share: float, body: Array) -> float:
    """Return how fast a robot may be beside another [m/s]: what is believed of the other counts anyway."""
    if body[_BELIEVED] == 0.0:
        return float(body[_TOP])
    left = np.hypot(other[0] - stop[0], other[1] - stop[1]) - near
    allowed = (1.0 - share) * left + share * max(own, others)
    return float(max(_CREEPING * body[_TOP], max(others, allowed) / body[_BELIEVED]))


@kernel
def _stop(pose: Array, turning: Array, body: Array, ahead: float, l: float, stop: Array) -> None:
    """Write q of the pose where a robot comes to rest [m], and its velocity by one of v, and by one of l omega."""
    lag = body[_LAG]
    v, omega = _body_from_wheels(turning[0], turning[1], body[_WHEEL], body[_BASE])
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
def _limits(rows: Array, body: Array, l: float, speed: float) -> int:
    """Write the rows of the wheels, and of the body's speed: what the robot can do, and may."""
    turn, fastest, count = body[_BASE] / (2.0 * l), body[_WHEEL] * body[_WHEEL_SPEED] * _INSIDE, 0
    for sign in (1.0, -1.0):
        count = _add_row(rows, count, sign, sign * turn, fastest)
        count = _add_row(rows, count, sign, -sign * turn, fastest)
        count = _add_row(rows, count, sign, 0.0, speed * _INSIDE)
    return count


@kernel
def _edges(rows: Array, count: int, stop: Array, half: Array, margin: float, rate: float, back: float) -> int:
    for out_x, out_y in _WALLS:
        left = abs(out_x) * half[0] + abs(out_y) * half[1] - margin - out_x * stop[0] - out_y * stop[1]
        along, across = out_x * stop[2] + out_y * stop[3], out_x * stop[4] + out_y * stop[5]
        count = _add_row(rows, count, along, across, max(rate * left, back))
    return count


@kernel
def _pair(
    rows: Array, count: int, stop: Array, other: Array, pushed: Array, apart: float, rate: float, body: Array,
    back: float,
) -> int:  # fmt: skip
    fastest_push = np.hypot(pushed[0], pushed[1])
    x, y, reach = other[0] - stop[0], other[1] - stop[1], apart + 2.0 * (body[_FASTEST] + fastest_push) / rate
    squared = x * x + y * y
    if squared == 0.0 or squared > reach * reach:
        return count  # no direction is away from it; or nothing that the robot can do breaks the row
    distance = np.sqrt(squared)
    towards_x, towards_y = x / distance, y / distance
    along = towards_x * stop[2] + towards_y * stop[3]
    across = towards_x * stop[4] + towards_y * stop[5]
    coming = max(0.0, -towards_x * pushed[0] - towards_y * pushed[1])
    return _add_row(rows, count, along, across, max(rate * (distance - apart) / 2.0 - coming, back))


KERNELS = (filter_commands,)  # that are called from Python

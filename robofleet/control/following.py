"""Robots that follow a joint plan: a virtual robot each, which the real one tracks by the Newton-Raphson flow.

The virtual robot drives along its way's straight pieces and turns in place at corners, as far as ``precedence`` allows,
and waits for a real robot that is behind. The real one's point p follows the virtual one's (eq. 31): r(t + T) is where
that point will be if the virtual robot goes on. At its goal a robot is brought to position and heading by short drives
and turns in place. There a wheel is asked for no less than it needs to start. So it is under way where the virtual
robot waits and the flow asks for less than starts a wheel: else who is not quite there would keep the others waiting.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from robofleet.control import planning, precedence
from robofleet.control.flow import point_update
from robofleet.control.precedence import Plan
from robofleet.control.wheels import body_from_point
from robofleet.core.arrays import Array, Flags, Indices
from robofleet.core.kernels import kernel
from robofleet.vehicles import solids
from robofleet.vehicles.differential_drive import DifferentialDrive

_TURN_SHARE = 0.65  # of the fastest turn: the rest is the feedback's
_STRAIGHT_RAD = 0.35  # it turns by less than this while it drives
_NEAR, _FAR = 0.02, 0.06  # of the virtual robot: within the first it drives on, behind the second it waits [m]
_ARRIVED_M = 0.01  # at a place of its way
_WAITING_M = 0.008  # a robot that waits so near its place stands
_FINISHING_M = 0.02  # from the end of the way
_POSITION_STOP, _HEADING_STOP = 0.7, 0.5  # of the accuracy: a robot stops within this, and is corrected beyond 1.0
PATIENCE_S = 8.0  # of bringing a robot to its pose; after that it is left where it is ...
_LOOSE_FACTOR = 2.0  # ... within so many times the accuracy
_END_RATE = 3.0  # of what is left [1/s]
_AHEAD_M = 0.6  # of the way is allowed at once, at most


class State(IntEnum):
    """Columns of what is remembered of a robot, one row each."""

    X = 0  # the virtual robot's pose [m, rad]
    Y = 1
    PSI = 2
    DRIVEN = 3  # its way so far [m]
    REAL = 4  # the real robot's way, at least [m]
    V = 5  # the real robot's velocity as modelled [m/s, rad/s]
    OMEGA = 6
    FINISHING = 7  # 1: the way is done, and it is being brought to its pose
    THERE = 8  # ticks for which it has been at its pose
    AIMING = 9  # 1: it drives to its place; 0: it turns to its heading
    MOVING = 10  # 1: the virtual robot drove or turned in this tick
    RATE_X = 11  # velocity of the virtual robot's point [m/s]
    RATE_Y = 12
    BRINGING = 13  # ticks for which it has been brought to its pose, or to where it waits, without standing there


@dataclass(frozen=True)
class FollowerSettings:
    """What a follower needs."""

    tick: float  # [s]
    point_ahead: float  # l [m]
    horizon: float  # T [s]
    gain: float  # of the flow in a tick
    speeds: tuple[float, ...]  # of each robot, at most [m/s]
    position: float  # [m]: within this of its goal a robot is there
    heading: float  # [rad]
    slowest_wheel: float  # [rad/s]: what starts a wheel that stands


class Follower:
    """N robots and their plan."""

    def __init__(self, settings: FollowerSettings, drives: Sequence[DifferentialDrive]) -> None:
        s = settings
        self._settings = s
        self._limits = np.array(
            [
                (d.wheel_radius, d.wheel_base, d.max_wheel_speed, min(d.max_speed, speed), d.motor_lag)
                for d, speed in zip(drives, s.speeds, strict=True)
            ]
        )
        self._accuracy = np.array(
            [
                (s.position, s.heading, s.slowest_wheel, PATIENCE_S / s.tick),  # at the goal
                (_WAITING_M, _STRAIGHT_RAD, s.slowest_wheel, math.inf),  # where it waits
            ]
        )
        n = len(drives)
        self.state = np.zeros((n, len(State)))
        self.u = np.zeros((n, 2))
        self._allowed, self._done, self._reached = (np.zeros(n, dtype=np.int64) for _ in range(3))
        self._plan: Plan | None = None
        self._goals = np.zeros((n, 3))

    def begin(self, plan: Plan | None, poses: Array, goals: Array) -> None:
        """Follow a plan from where the robots stand (N, 3); None: stand."""
        self._plan, self._goals = plan, np.ascontiguousarray(goals)
        self.state[:] = 0.0
        self.state[:, :3] = poses
        for index in (self._allowed, self._done, self._reached):
            index[:] = 0

    def changed(self, u: Array, poses: Array) -> None:
        """Remember what the robots are asked for, u (N, 2) of their points [m/s; world], at these poses."""
        self.u[:] = u
        s = self._settings
        _modelled(u, poses, self._limits, s.point_ahead, s.tick, self.state)

    def tick(self, poses: Array, driving: Flags, disturbance: Array) -> Array:
        """Return v [m/s] and omega [rad/s] of all robots (N, 2)."""
        out = np.zeros((len(poses), 2))
        if self._plan is not None:
            s = self._settings
            _advance(
                *self._plan, poses, driving, self._limits, s.point_ahead, s.tick, self.state, self._allowed,
                self._done, self._reached,
            )  # fmt: skip
            _drive(
                poses, driving, disturbance, self._goals, self._limits, self._accuracy, s.point_ahead, s.horizon,
                s.gain, self.state, self.u, out,
            )  # fmt: skip
        return out

    @property
    def steps(self) -> tuple[Indices, int]:
        """Return which step each robot has come to (N,), and the last one."""
        return self._done, 0 if self._plan is None else self._plan.places.shape[1] - 1

    def rest(self) -> Array:
        """Return the points (M, 2) of what is left of all ways [m]."""
        if self._plan is None:
            return np.zeros((0, 2))
        return np.concatenate([self._plan.places[i, k:] for i, k in enumerate(self._done.tolist())])

    def rehearse(self) -> None:
        """Call every kernel of planning and following once, and follow nothing.

        numba compiles them then, or loads them from disk, and no later call waits for that.
        """
        n = len(self.state)
        ends = np.array([(-0.2, 0.0), (0.2, 0.0)])
        problem = planning.Problem(ends, ends[::-1].copy(), np.zeros((0, 3)), (0.5, 0.5), 0.2, 0.05)
        deque(precedence.plan(problem, np.random.default_rng(0)), maxlen=0)
        planning.assign(np.eye(2))
        nowhere = Plan(np.zeros((n, 2, 2)), np.zeros((n, 2)), np.zeros((n, 2, n), dtype=np.int32))
        poses, still = np.zeros((n, 3)), np.zeros((n, 2))
        self.begin(nowhere, poses, poses)
        self.tick(poses, np.ones(n, dtype=np.bool_), still)
        self.changed(still, poses)
        self.begin(None, poses, poses)


@kernel
def _wrapped(angle: float) -> float:
    return float(angle - math.tau * np.floor((angle + math.pi) / math.tau))


@kernel
def _modelled(u: Array, poses: Array, limits: Array, l: float, tick: float, state: Array) -> None:
    for i in range(len(u)):
        v, omega = body_from_point(u[i, 0], u[i, 1], poses[i, 2], l)
        share = 1.0 - np.exp(-tick / limits[i, 4]) if limits[i, 4] > 0.0 else 1.0
        state[i, 5] += share * (v - state[i, 5])
        state[i, 6] += share * (omega - state[i, 6])


@kernel
def _advance(
    places: Array, length: Array, needed: NDArray[np.int32], poses: Array, driving: Flags, limits: Array, l: float,
    tick: float, state: Array, allowed: Indices, done: Indices, stage: Indices,
) -> None:  # fmt: skip
    """Move the virtual robots by a tick, as far as the others' progress allows."""
    n, last = len(places), places.shape[1] - 1
    for i in range(n):
        s = state[i]
        while allowed[i] < last and length[i, allowed[i]] <= s[3] + _AHEAD_M:
            a, free = allowed[i] + 1, True
            for j in range(n):
                if done[j] < needed[i, a, j]:
                    free = False
            if not free:
                break
            allowed[i] = a
        s[10], s[11], s[12] = 0.0, 0.0, 0.0
        end = length[i, allowed[i]]
        while stage[i] < allowed[i] and length[i, stage[i] + 1] <= s[3] + 1e-9:
            stage[i] += 1
        if driving[i] and stage[i] < allowed[i] and s[3] < end - 1e-9:
            k = stage[i]
            x, y = places[i, k + 1, 0] - places[i, k, 0], places[i, k + 1, 1] - places[i, k, 1]
            turn = _wrapped(np.arctan2(y, x) - s[2])
            before_x, before_y = s[0] + l * np.cos(s[2]), s[1] + l * np.sin(s[2])
            off = np.hypot(
                before_x - poses[i, 0] - l * np.cos(poses[i, 2]), before_y - poses[i, 1] - l * np.sin(poses[i, 2])
            )
            pace = min(max((_FAR - off) / (_FAR - _NEAR), 0.0), 1.0)
            fastest = _TURN_SHARE * 2.0 * limits[i, 0] * limits[i, 2] / limits[i, 1] * pace * tick
            s[2] = _wrapped(s[2] + min(max(turn, -fastest), fastest))
            if abs(turn) < _STRAIGHT_RAD:
                s[3] = min(end, s[3] + np.cos(turn) * limits[i, 3] * pace * tick)
                while k < allowed[i] and length[i, k + 1] <= s[3] + 1e-9:
                    k += 1
                s[0], s[1] = places[i, k, 0], places[i, k, 1]
                if k < last and length[i, k + 1] > length[i, k]:
                    part = (s[3] - length[i, k]) / (length[i, k + 1] - length[i, k])
                    s[0] += part * (places[i, k + 1, 0] - places[i, k, 0])
                    s[1] += part * (places[i, k + 1, 1] - places[i, k, 1])
            s[10] = 1.0
            s[11] = (s[0] + l * np.cos(s[2]) - before_x) / tick
            s[12] = (s[1] + l * np.sin(s[2]) - before_y) / tick
        off = np.hypot(s[0] - poses[i, 0], s[1] - poses[i, 1])
        s[4] = max(s[4], s[3] - max(0.0, off - _ARRIVED_M))
        while done[i] < allowed[i] and length[i, done[i] + 1] <= s[4] + 1e-9:
            done[i] += 1
        if allowed[i] == last and s[3] >= length[i, last] - 1e-9 and off < _FINISHING_M:
            s[7] = 1.0


@kernel
def _drive(
    poses: Array, driving: Flags, w: Array, goals: Array, limits: Array, accuracy: Array, l: float, T: float,
    gain: float, state: Array, u: Array, out: Array,
) -> None:  # fmt: skip
    for i in range(len(poses)):
        s = state[i]
        if not driving[i]:
            out[i] = 0.0
            s[8] = 0.0
        elif s[7] > 0.0:
            _finish(poses[i], goals[i], limits[i], accuracy[0], s, out[i])
        else:
            waits = s[10] == 0.0
            if waits and s[13] == 0.0 and np.hypot(s[0] - poses[i, 0], s[1] - poses[i, 1]) < _WAITING_M:
                out[i] = 0.0
                continue
            c, sn = np.cos(poses[i, 2]), np.sin(poses[i, 2])
            x, y = poses[i, 0] + l * c, poses[i, 1] + l * sn
            px, py = s[0] + l * np.cos(s[2]), s[1] + l * np.sin(s[2])
            u_x = point_update(u[i, 0], x + T * w[i, 0], px + T * s[11], T, gain)
            u_y = point_update(u[i, 1], y + T * w[i, 1], py + T * s[12], T, gain)
            v, omega = body_from_point(u_x, u_y, poses[i, 2], l)
            out[i, 0], out[i, 1] = v, omega
            fastest = abs(v) + limits[i, 1] / 2.0 * abs(omega)  # of its wheels' rims [m/s]
            if waits and (s[13] > 0.0 or fastest < limits[i, 0] * accuracy[1, 2]):
                _finish(poses[i], s[:3], limits[i], accuracy[1], s, out[i])
                if s[8] > 0.0:
                    s[8], s[13] = 0.0, 0.0
            else:
                s[13] = 0.0


@kernel
def _finish(pose: Array, goal: Array, limits: Array, accuracy: Array, s: Array, out: Array) -> None:
    """Bring a robot to its pose, by where it would come to rest: drive to the place, then turn to the heading.

    While it stands, that is where it was measured: if it came to rest beyond the accuracy, it is corrected.
    """
    patient = s[13] < accuracy[3]
    loose = 1.0 if patient else _LOOSE_FACTOR
    lag, radius, base = limits[4] if patient else 0.0, limits[0], limits[1]  # the model may be what is wrong
    within, heading, slowest = accuracy[0], accuracy[1], accuracy[2]
    slow, slow_turn = radius * slowest, 2.0 * radius * slowest / base
    fast_turn = _TURN_SHARE * 2.0 * radius * limits[2] / base
    psi = pose[2] + s[6] * lag
    c, sn = np.cos(psi), np.sin(psi)
    x, y = goal[0] - pose[0] - s[5] * lag * c, goal[1] - pose[1] - s[5] * lag * sn
    along, across, away = c * x + sn * y, c * y - sn * x, np.hypot(x, y)
    if s[8] == 0.0:
        s[13] += 1.0
    if s[9] == 0.0 and away > loose * within:
        s[9] = 1.0
    elif away < (_POSITION_STOP if patient else loose) * within or (
        abs(across) < 0.6 * within and abs(along) < 0.6 * within
    ):
        s[9] = 0.0
    v, turn = 0.0, 0.0
    if s[9] > 0.0:
        turn = np.arctan2(across, along)
        if abs(turn) > math.pi / 2.0:
            turn = _wrapped(turn + math.pi)
        if abs(across) < 0.6 * within:
            turn = 0.0
            v = min(max(_END_RATE * abs(along), slow), limits[3])
            v = v if along > 0.0 else -v
    else:
        turn = _wrapped(goal[2] - psi)
        if abs(turn) < (loose if s[8] > 0.0 or not patient else _HEADING_STOP) * heading:
            turn = 0.0
    if turn != 0.0:
        omega = min(max(_END_RATE * abs(turn), slow_turn), fast_turn)
        room = max(0.0, base * omega / 2.0 - slow)
        v = min(max(along, -room), room)
        out[0], out[1] = v, (omega if turn > 0.0 else -omega)
    else:
        out[0], out[1] = v, 0.0
    s[8] = s[8] + 1.0 if v == 0.0 and turn == 0.0 else 0.0


def rehearse(drive: DifferentialDrive) -> None:
    """Call every kernel of planning and following once; see ``Follower.rehearse``."""
    solids.rehearse()
    Follower(FollowerSettings(0.03, 0.1, 0.5, 0.1, (0.1,), 0.01, 0.1, 0.1), [drive]).rehearse()


KERNELS = (_modelled, _advance, _drive, *precedence.KERNELS, *planning.KERNELS)  # that are called from Python

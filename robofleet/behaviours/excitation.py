"""A drive that shows what a robot is, one robot after the other: spins, straights, wheels that creep through the dead
band, wheels as fast as they go, and pseudo-random wheel speeds.

The wheel speeds follow a script, not the poses: what a robot does with them is what is measured. Poses keep it safe
and within reach: it goes along the freest line, random motion is mirrored where it would leave a small disc, and a
robot that would come too near another one or the arena's edge is held.
"""

import math
from collections.abc import Iterator
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from robofleet.behaviours.interface import Behaviour, Decision, Figure, Situation, Team
from robofleet.core.arrays import Array
from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_wheels, feasible_ratio

Pose = tuple[float, float, float]

_SPIN_SHARE, _STRAIGHT_SHARE = 0.4, 0.5  # of what the wheels can do
_SLOWEST, _FASTEST = 0.25, 0.6  # random wheel speeds, of the highest; slow ones would be lost in the dead band
_SPIN_ANGLE = 1.1 * math.tau  # [rad]
_REST_S = 0.5
_RANDOM_S = 10.0
_CREEP_SHARE, _CREEP_S = 0.12, 1.5  # up to a speed above the dead band, and how long that takes; as long down again
_TOP_S = 0.7
_LONGEST_LINE = 0.3  # [m]
_LINE_STEP = 0.02
_RANDOM_DISC = 0.08  # random motion stays so near [m]
_LEAST_GAP_M = 0.03  # between bodies, and to the edge
_DIRECTIONS = 36
_TURN_ACCURACY = 0.03  # [rad]


class Act(Enum):
    """What a robot does in a part of its script."""

    REST = 0
    SPIN = 1
    TURN = 2  # towards the freest line
    LINE = 3  # along it
    RANDOM = 4
    CREEP = 5  # a spin that speeds up slowly from rest, and slows down again


class Spell(NamedTuple):
    """A part of a robot's script: until when [s, from the script's start], and the wheels' speeds [rad/s]."""

    until: float
    act: Act
    left: float = 0.0
    right: float = 0.0


class Excitation(Behaviour):
    """The drive of all robots, in their group's order: each its script, while the others stand."""

    figures = (Figure("held", meaning="1: the robot would come too near to something, and is held", live=False),)

    def __init__(self, settings: Any, team: Team) -> None:
        super().__init__(settings, team)
        self._radii = tuple(body.radius for body in team.bodies)
        self._scripts = [list(_script(drive, team.tick, team.rng)) for drive in team.drives]
        self.ends = np.cumsum([script[-1].until for script in self._scripts])  # of each robot's script [s]
        self.restart()

    def restart(self) -> None:
        self._row, self._part = 0, 0
        self._heading = math.nan  # of the line; NaN: not turned towards it yet
        self._length = 0.0
        self._anchor: tuple[float, float] | None = None  # of the random motion

    def decide(self, now: Situation) -> Decision:
        """Return v and omega of the robot whose turn it is; the others stand."""
        bodies, held = np.zeros((len(now.poses), 2)), np.zeros(len(now.poses))
        row = int(np.searchsorted(self.ends, now.t, side="right"))
        if row < len(now.poses) and now.driving[row]:
            x, y, psi = now.poses[row].tolist()
            others = np.delete(np.column_stack([now.poses[:, :2], self._radii]), row, axis=0)
            surroundings = _Surroundings(np.concatenate([others, now.others]), self.team.arena, self._radii[row])
            left, right, stands = self._wheels(row, now.t, (x, y, psi), surroundings)
            drive = self.team.drives[row]
            bodies[row] = body_from_wheels(left, right, drive.wheel_radius, drive.wheel_base)
            held[row] = stands
        return Decision(bodies, of="body", figures={"held": held})

    def _wheels(self, row: int, t: float, pose: Pose, around: "_Surroundings") -> tuple[float, float, bool]:
        """Return the wheel speeds of the robot whose turn it is, and whether it is held."""
        script, vehicle = self._scripts[row], self.team.drives[row]
        local = t - (self.ends[row - 1] if row else 0.0)
        if row != self._row:
            self.restart()
            self._row = row
        while self._part < len(script) - 1 and script[self._part].until <= local:
            self._part += 1
        part, since = script[self._part], script[self._part - 1].until if self._part else 0.0
        left, right = part.left, part.right
        if part.act is Act.CREEP:
            rise = max(0.0, 1.0 - abs((local - since) / _CREEP_S - 1.0))
            return rise * left, rise * right, False
        if part.act is Act.TURN:
            return *self._turn(pose, around, vehicle), False
        if part.act is Act.LINE and (local - since) * abs(left) * vehicle.wheel_radius >= self._length:
            return 0.0, 0.0, self._length == 0.0
        wanted = [(left, right)]
        if part.act is Act.RANDOM:
            self._anchor = self._anchor or pose[:2]
            wanted.append((-right, -left))
        reach = self.team.tick + 2.0 * vehicle.motor_lag  # [s] in which a moving robot still comes to rest
        for left, right in wanted:
            v, omega = body_from_wheels(left, right, vehicle.wheel_radius, vehicle.wheel_base)
            if around.allow(pose, arc(*pose, v, omega, reach), self._anchor):
                return left, right, False
        return 0.0, 0.0, True

    def _turn(self, pose: Pose, around: "_Surroundings", vehicle: DifferentialDrive) -> tuple[float, float]:
        """Choose the freest line when asked first, and turn towards it."""
        if math.isnan(self._heading):
            self._heading, self._length = around.freest(pose)
        left = math.remainder(self._heading - pose[2], math.tau)
        if abs(left) < _TURN_ACCURACY:
            return 0.0, 0.0
        speed = math.copysign(_SPIN_SHARE * min(1.0, max(0.2, abs(left) / 0.4)), left) * vehicle.max_wheel_speed
        return -speed, speed


class _Surroundings(NamedTuple):
    """What one robot must not touch."""

    others: Array  # (M, 3): x, y, body radius [m]
    arena: tuple[float, float]
    radius: float

    def clearance(self, x: float, y: float) -> float:
        """Return the distance to the nearest body or edge [m]."""
        edge = min(self.arena[0] / 2 - abs(x), self.arena[1] / 2 - abs(y)) - self.radius
        if not len(self.others):
            return edge
        apart = np.hypot(self.others[:, 0] - x, self.others[:, 1] - y) - self.others[:, 2] - self.radius
        return min(edge, float(apart.min()))

    def allow(self, now: Pose, then: Pose, anchor: tuple[float, float] | None) -> bool:
        """Return whether a motion keeps out of everything, or leads away from it, and stays near the anchor."""
        clear = self.clearance(*then[:2])
        if clear < _LEAST_GAP_M and clear < self.clearance(*now[:2]):
            return False
        if anchor is None:
            return True
        away = math.dist(then[:2], anchor)
        return away <= _RANDOM_DISC or away <= math.dist(now[:2], anchor)

    def freest(self, pose: Pose) -> tuple[float, float]:
        """Return the heading of the longest free line from here, and its length [m]; of equal ones the nearest."""
        x, y, psi = pose
        turns = sorted((math.tau * k / _DIRECTIONS - math.pi for k in range(1, _DIRECTIONS + 1)), key=abs)
        best = psi, 0.0
        for turn in turns:
            c, s = math.cos(psi + turn), math.sin(psi + turn)
            length = 0.0
            while (
                length < _LONGEST_LINE
                and self.clearance(x + (length + 0.05) * c, y + (length + 0.05) * s) >= _LEAST_GAP_M
            ):
                length += _LINE_STEP
            if length > best[1]:
                best = psi + turn, length
        return best


def _script(vehicle: DifferentialDrive, tick: float, rng: np.random.Generator) -> Iterator[Spell]:
    """Give the parts of one robot's script in their order."""
    radius, base, highest = vehicle.wheel_radius, vehicle.wheel_base, vehicle.max_wheel_speed
    creep = _CREEP_SHARE * highest
    spin, straight = _SPIN_SHARE * highest, _STRAIGHT_SHARE * min(highest, vehicle.max_speed / radius)
    omega = body_from_wheels(-spin, spin, radius, base)[1]
    plan = [(Act.SPIN, _SPIN_ANGLE / omega, -spin, spin), (Act.SPIN, _SPIN_ANGLE / omega, spin, -spin)]
    plan.append((Act.TURN, math.pi / omega + 1.0, 0.0, 0.0))
    plan += [(Act.LINE, _LONGEST_LINE / (straight * radius), way * straight, way * straight) for way in (1.0, -1.0)]
    plan += [(Act.CREEP, 2.0 * _CREEP_S, -way * creep, way * creep) for way in (1.0, -1.0)]
    plan += [(Act.SPIN, _TOP_S, -way * highest, way * highest) for way in (1.0, -1.0)]
    until = _REST_S
    yield Spell(until, Act.REST)
    for act, duration, left, right in plan:
        until += duration
        yield Spell(until, act, left, right)
        until += _REST_S
        yield Spell(until, Act.REST)
    end = until + _RANDOM_S
    while until < end:
        until += tick * int(rng.integers(3, 7))
        left, right = (rng.uniform(_SLOWEST, _FASTEST, 2) * rng.choice((-1.0, 1.0), 2) * highest).tolist()
        ratio = feasible_ratio(left, right, radius, highest, vehicle.max_speed)
        yield Spell(until, Act.RANDOM, ratio * left, ratio * right)
    yield Spell(until + _REST_S, Act.REST)

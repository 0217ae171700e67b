"""A drive that shows what a robot is, one robot after the other: manoeuvres of the wheels, each there and back.

The wheel speeds follow a script, not the poses: what a robot does with them is what is measured. Poses keep it safe
and within reach: it goes along the freest line, no further than that is free, and a robot that would come too near
another one or the arena's edge is held. `robofleet calibrate drive` chooses the manoeuvres by what they tell.
"""

import math
from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Behaviour, Decision, Figure, Situation, Team
from robofleet.core.arrays import Array
from robofleet.core.settings import MANY, ROBOTS, Model, Name, within
from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_wheels, feasible_ratio

Pose = tuple[float, float, float]
WheelSpeed = Annotated[float, within(-1e4, 1e4)]
Duration = Annotated[float, within(0.01, 1000)]

LONGEST_LINE_M = 0.3
REST_S = 0.5
_SPIN_SHARE, _STRAIGHT_SHARE = 0.4, 0.5  # of what the wheels can do
_SPIN_ANGLE = 1.1 * math.tau  # [rad]
_CREEP_SHARE, _CREEP_S = 0.12, 3.0  # up to a speed above the dead band, and down again
_TOP_S = 0.7
_STEP_SHARES, _STEPS_S, _STEP_TIMES, _STEPS = (0.25, 0.6), (0.099, 0.132, 0.165, 0.198), 3, 9
_IN_PLACE_M = 0.05  # what goes further needs a free line
_LINE_STEP = 0.02
_LEAST_GAP_M = 0.03  # between bodies, and to the edge
_DIRECTIONS = 36
_TURN_ACCURACY = 0.03  # [rad]


class Manoeuvre(Model):
    """Wheel speeds there, and the opposite ones back."""

    left_rad_s: WheelSpeed
    """Speed of the left wheel on the way there; forward is positive."""
    right_rad_s: WheelSpeed
    """Speed of the right wheel."""
    duration_s: Duration
    """Time of each way."""
    times: Annotated[int, within(1, 1000)] = 1
    """How many times there and back, without a rest between."""
    ramp: bool = False
    """The speeds rise from 0 at a constant rate, and fall again, on each way; false: they jump."""


Manoeuvres = Annotated[tuple[Manoeuvre, ...], Field(min_length=1, max_length=MANY, strict=False)]


class Act(Enum):
    """What a robot does in a part of its script."""

    REST = 0
    TURN = 1  # towards the freest line
    CONSTANT = 2
    RAMP = 3


class Spell(NamedTuple):
    """A part of a robot's script: instants from the script's start [s], speeds of the wheels [rad/s]."""

    start: float
    end: float
    act: Act = Act.REST
    left: float = 0.0
    right: float = 0.0

    def wheels(self, t: float) -> tuple[float, float]:
        """Return the wheels' speeds at an instant of the script."""
        if self.act is not Act.RAMP:
            return self.left, self.right
        share = max(0.0, 1.0 - abs(2.0 * (t - self.start) / (self.end - self.start) - 1.0))
        return share * self.left, share * self.right


class Excitation(Behaviour):
    """The drive of all robots, in their group's order: each its manoeuvres, while the others stand."""

    class Settings(Behaviour.Settings):
        """The manoeuvres, as ``robofleet calibrate drive`` proposes them."""

        manoeuvres: Annotated[dict[Name, Manoeuvres], Field(max_length=ROBOTS)] = Field(default={})
        """Manoeuvres of each robot, by the robot's id. One that has none here does some of each kind."""

    figures = (Figure("held", meaning="1: the robot would come too near to something, and is held", live=False),)

    def __init__(self, settings: Any, team: Team) -> None:
        super().__init__(settings, team)
        self._radii = tuple(body.radius for body in team.bodies)
        self._scripts = [
            list(script(drive, settings.manoeuvres.get(robot) or of_each_kind(drive)))
            for robot, drive in zip(team.robots, team.drives, strict=True)
        ]
        self.ends = np.cumsum([own[-1].end for own in self._scripts])  # of each robot's script [s]
        self.restart()

    def free_line_m(self, row: int) -> float:
        """Return how long a free line a robot has where it starts, as far as that is known."""
        starts = self.team.starts
        others = [(*pose[:2], radius) for pose, radius in zip(starts, self._radii, strict=True) if pose is not None]
        if (start := starts[row]) is None:
            return LONGEST_LINE_M
        others.remove((*start[:2], self._radii[row]))
        return self._surroundings(row, np.array(others).reshape(-1, 3)).freest(start)[1]

    def restart(self) -> None:
        self._row, self._part = 0, 0
        self._heading = math.nan  # of the line; NaN: not turned towards it yet
        self._length = math.inf

    def decide(self, now: Situation) -> Decision:
        """Return v and omega of the robot whose turn it is; the others stand."""
        bodies, held = np.zeros((len(now.poses), 2)), np.zeros(len(now.poses))
        row = int(np.searchsorted(self.ends, now.t, side="right"))
        if row < len(now.poses) and now.driving[row]:
            x, y, psi = now.poses[row].tolist()
            others = np.delete(np.column_stack([now.poses[:, :2], self._radii]), row, axis=0)
            surroundings = self._surroundings(row, np.concatenate([others, now.others]))
            left, right, stands = self._wheels(row, now.t, (x, y, psi), surroundings)
            drive = self.team.drives[row]
            bodies[row] = body_from_wheels(left, right, drive.wheel_radius, drive.wheel_base)
            held[row] = stands
        return Decision(bodies, of="body", figures={"held": held})

    def _surroundings(self, row: int, others: Array) -> "_Surroundings":
        return _Surroundings(others, self.team.arena, self._radii[row])

    def _wheels(self, row: int, t: float, pose: Pose, around: "_Surroundings") -> tuple[float, float, bool]:
        """Return the wheel speeds of the robot whose turn it is, and whether it is held."""
        parts, vehicle = self._scripts[row], self.team.drives[row]
        local = t - (self.ends[row - 1] if row else 0.0)
        if row != self._row:
            self.restart()
            self._row = row
        while self._part < len(parts) - 1 and parts[self._part].end <= local:
            self._part += 1
        part = parts[self._part]
        if part.act is Act.TURN:
            return *self._turn(pose, around, vehicle), False
        left, right = part.wheels(local)
        v, omega = body_from_wheels(left, right, vehicle.wheel_radius, vehicle.wheel_base)
        if v and (local - part.start) * abs(v) >= self._length:
            return 0.0, 0.0, self._length == 0.0
        reach = self.team.tick + 2.0 * vehicle.motor_lag  # [s] in which a moving robot still comes to rest
        if around.allow(pose, arc(*pose, v, omega, reach)):
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

    def allow(self, now: Pose, then: Pose) -> bool:
        """Return whether a motion keeps out of everything, or leads away from it."""
        clear = self.clearance(*then[:2])
        return clear >= _LEAST_GAP_M or clear >= self.clearance(*now[:2])

    def freest(self, pose: Pose) -> tuple[float, float]:
        """Return the heading of the longest free line from here, and its length [m]; of equal ones the nearest."""
        x, y, psi = pose
        turns = sorted((math.tau * k / _DIRECTIONS - math.pi for k in range(1, _DIRECTIONS + 1)), key=abs)
        best = psi, 0.0
        for turn in turns:
            c, s = math.cos(psi + turn), math.sin(psi + turn)
            length = 0.0
            while (
                length < LONGEST_LINE_M
                and self.clearance(x + (length + 0.05) * c, y + (length + 0.05) * s) >= _LEAST_GAP_M
            ):
                length += _LINE_STEP
            if length > best[1]:
                best = psi + turn, length
        return best


def of_each_kind(vehicle: DifferentialDrive) -> tuple[Manoeuvre, ...]:
    """Return manoeuvres that tell something of each parameter of a robot."""
    radius, base, highest = vehicle.wheel_radius, vehicle.wheel_base, vehicle.max_wheel_speed
    spin, straight = _SPIN_SHARE * highest, _STRAIGHT_SHARE * min(highest, vehicle.max_speed / radius)
    creep, rng = _CREEP_SHARE * highest, np.random.default_rng(1)  # steps of many kinds tell delay from lag
    speeds = rng.uniform(*_STEP_SHARES, (_STEPS, 2)) * rng.choice((-1.0, 1.0), (_STEPS, 2)) * highest
    turn_s = _SPIN_ANGLE / body_from_wheels(-spin, spin, radius, base)[1]
    return (
        Manoeuvre(left_rad_s=-spin, right_rad_s=spin, duration_s=turn_s),
        Manoeuvre(left_rad_s=straight, right_rad_s=straight, duration_s=LONGEST_LINE_M / (straight * radius)),
        Manoeuvre(left_rad_s=-creep, right_rad_s=creep, duration_s=_CREEP_S, ramp=True),
        Manoeuvre(left_rad_s=-highest, right_rad_s=highest, duration_s=_TOP_S),
        *(
            Manoeuvre(left_rad_s=left, right_rad_s=right, duration_s=step_s, times=_STEP_TIMES)
            for (left, right), step_s in zip(speeds.tolist(), rng.choice(_STEPS_S, _STEPS).tolist(), strict=True)
        ),
    )


def script(vehicle: DifferentialDrive, manoeuvres: Sequence[Manoeuvre]) -> Iterator[Spell]:
    """Give the parts of one robot's script in their order."""
    part, on_line = Spell(0.0, REST_S), False
    yield part
    for each in manoeuvres:
        if not on_line and leaves_place(vehicle, each):
            end = part.end + turning_s(vehicle)
            yield Spell(part.end, end - REST_S, Act.TURN)
            part, on_line = Spell(end - REST_S, end), True
            yield part
        for part in there_and_back(vehicle, each, part.end):  # noqa: B020 - each begins where the one before ends
            yield part


def turning_s(vehicle: DifferentialDrive) -> float:
    """Return how long it takes at most to turn towards the freest line, and to rest."""
    spin = _SPIN_SHARE * vehicle.max_wheel_speed
    return math.pi / body_from_wheels(-spin, spin, vehicle.wheel_radius, vehicle.wheel_base)[1] + 1.0 + REST_S


def there_and_back(vehicle: DifferentialDrive, manoeuvre: Manoeuvre, start: float) -> Iterator[Spell]:
    """Give the parts of a manoeuvre, with its rests."""
    left, right = _feasible(vehicle, manoeuvre)
    act = Act.RAMP if manoeuvre.ramp else Act.CONSTANT
    for k in range(2 * manoeuvre.times):
        way = 1.0 if k % 2 == 0 else -1.0
        end = start + manoeuvre.duration_s
        yield Spell(start, end, act, way * left, way * right)
        start = end
        if manoeuvre.times == 1 or k == 2 * manoeuvre.times - 1:
            start = end + REST_S
            yield Spell(end, start)


def leaves_place(vehicle: DifferentialDrive, manoeuvre: Manoeuvre) -> bool:
    """Return whether a manoeuvre needs a free line."""
    left, right = _feasible(vehicle, manoeuvre)
    return abs(left + right) / 2.0 * vehicle.wheel_radius * manoeuvre.duration_s > _IN_PLACE_M


def _feasible(vehicle: DifferentialDrive, manoeuvre: Manoeuvre) -> tuple[float, float]:
    left, right = manoeuvre.left_rad_s, manoeuvre.right_rad_s
    ratio = feasible_ratio(left, right, vehicle.wheel_radius, vehicle.max_wheel_speed, vehicle.max_speed)
    return ratio * left, ratio * right

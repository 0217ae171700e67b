"""What a group's motion must keep, for the ``bounds`` of a behaviour: the arena, the wheels, the barrier."""

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from robofleet.behaviours.interface import Bound, Team
from robofleet.behaviours.laps import rounded_down
from robofleet.core.arrays import Array
from robofleet.safety.distances import apart, from_edge
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.solids import distances


def slowed(velocities: Array, speed: float) -> Array:
    """Return velocities (N, 2) [m/s] of which the faster ones have the given speed, in their own direction."""
    each = np.hypot(velocities[:, 0], velocities[:, 1])[:, None]
    return np.asarray(velocities * (speed / np.maximum(each, speed)))


def any_way(drive: DifferentialDrive, ahead: float) -> float:
    """Return the speed [m/s] that the point ahead can have in every direction, whatever the heading is."""
    turning = math.hypot(1.0, drive.wheel_base / (2.0 * ahead))
    return min(drive.max_speed, drive.wheel_radius * drive.max_wheel_speed / turning)


def point_speeds(team: Team, key: str, speed: float) -> Iterator[Bound]:
    """Yield whether every robot's point ahead can have a speed [m/s] in every direction."""
    most = [any_way(drive, team.point_ahead) for drive in team.drives]
    slowest = int(np.argmin(most))
    mend = f"the wheels of {team.robots[slowest]} give no more in every direction"
    yield Bound(key, "the speed of a robot's point ahead", speed, rounded_down(most[slowest]), "m/s", mend)


def inside(
    team: Team,
    robot: int,
    key: str,
    points: Array,
    where: Callable[[int], str],
    *,
    who: str = "",
    mend: str = "move it inwards",
) -> Iterator[Bound]:
    """Yield whether a robot's path (M, 2) [m] keeps its body inside; ``where`` says in words where row k is.

    ``who`` leaves the arena there, where it is more than this robot.
    """
    body = team.bodies[robot]
    margin = from_edge(team.keepout, body) - body.radius
    for axis, name in enumerate("xy"):
        reach = np.abs(points[:, axis])
        k = int(reach.argmax())
        blame = f"{who or team.robots[robot]} leaves the arena {where(k)}, so {mend}"
        what = f"the path's reach in {name} with a body's radius"
        yield Bound(key, what, float(reach[k]) + body.radius, team.arena[axis] / 2 - margin, "m", blame)
    yield from clear_of_solids(team, robot, key, points, where, who or f"{team.robots[robot]}'s way")


def clear_of_solids(
    team: Team, robot: int, key: str, points: Array, where: Callable[[int], str], who: str
) -> Iterator[Bound]:
    """Yield whether the barrier lets a robot be at points (M, 2) [m] beside obstacles, and on its floor."""
    solids, kept = team.keepout.solids, from_edge(team.keepout, team.bodies[robot])
    for solid, away in zip(solids, distances(solids, points), strict=True):
        k = int(away.argmin())
        if solid.floor:
            what, mend = "the path's distance from the floor's edge (floor_m)", "move it inwards"
        else:
            what, mend = f"the path's distance from {solid.name}", f"move {solid.name} or the path"
        yield Bound(key, what, float(away[k]), kept, "m", f"{who} is nearest {where(k)}, so {mend}", at_least=True)


def wheels(
    team: Team,
    robot: int,
    key: str,
    body: tuple[Array, Array],
    where: Callable[[int], str],
    fits: Callable[[float], str],
) -> Iterator[Bound]:
    """Yield whether a robot's wheels can do the ``body``'s v (M,) [m/s] and omega (M,) [rad/s].

    ``where`` says in words where row k is; ``fits`` what can be done, from the share of the speed that can be.
    """
    drive, v = team.drives[robot], np.abs(body[0])
    wheel = (v + np.abs(body[1]) * drive.wheel_base / 2) / drive.wheel_radius
    for what, values, limit, unit in (
        ("the fastest wheel along the path", wheel, drive.max_wheel_speed, "rad/s"),
        ("the highest speed along the path", v, drive.max_speed, "m/s"),
    ):
        k = int(values.argmax())
        share = min(1.0, limit / max(float(values[k]), limit))
        yield Bound(key, what, float(values[k]), limit, unit, f"{team.robots[robot]} {where(k)}; {fits(share)}")


def clear_of_each_other(team: Team, key: str, centres: Array, step: float, mend: str) -> Iterator[Bound]:
    """Yield whether the barrier lets the robots be where they are to be: ``centres`` (N, M, 2) [m] every step [s].

    Robots that approach each other need a reserve: the barrier lets none of them use up more than half of the rest of
    their distance at its rate.
    """
    moving = np.gradient(centres, step, axis=1)
    for i, j in itertools.combinations(range(len(team)), 2):
        between = centres[j] - centres[i]
        distance = np.hypot(between[:, 0], between[:, 1])
        towards = between / np.maximum(distance, np.finfo(np.float64).tiny)[:, None]
        closing = np.maximum((moving[i] * towards).sum(axis=1), -(moving[j] * towards).sum(axis=1))
        free = distance - 2 * np.maximum(closing, 0.0) / team.keepout.rate
        near = apart(team.keepout, team.bodies[i], team.bodies[j])
        what = "the distance of two robots, less what the barrier needs to brake them,"
        blame = f"the barrier would hold {team.robots[i]} and {team.robots[j]} apart, so {mend}"
        yield Bound(key, what, float(free.min()), near, "m", blame, at_least=True)


def on_a_circle(team: Team, radius: float, speed: float, centre: tuple[float, float]) -> Iterator[Bound]:
    """Yield whether points ahead can move on a circle, equally spaced: inside, and clear of each other.

    ``radius`` [m], ``speed`` [m/s], ``centre`` [m].
    """
    key, ahead = "settings.radius_m", team.point_ahead
    mend = f"the points ahead are {ahead:g} m in front of their robots, so raise it"
    yield Bound(key, "radius_m", radius, ahead, "m", mend, at_least=True, strict=True)
    for i in range(len(team)):
        extremes = np.array(centre) + radius * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        yield from inside(team, i, key, extremes, lambda _: "on the circle")
    centres, half = math.sqrt(max(radius**2 - ahead**2, 0.0)), math.pi / len(team)
    reserve = 2 * speed * centres / radius * math.cos(half) / team.keepout.rate
    nearest = 2 * centres * math.sin(half) - reserve
    near = max(apart(team.keepout, a, b) for a, b in zip(team.bodies, team.bodies[1:] + team.bodies[:1], strict=True))
    what = "the distance of two robots on the circle, less what the barrier needs to brake them,"
    yield Bound(key, what, nearest, near, "m", "the barrier would hold them, so raise radius_m", at_least=True)

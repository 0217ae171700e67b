"""What stands on the arena's floor beside robots, and a floor that is no rectangle; and what cannot be of them."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Annotated

from pydantic import Field

from robofleet.config.robots import StartPose
from robofleet.core.settings import MANY, ROBOTS, Coordinate, Height, Length, Model, Name, within
from robofleet.vehicles import solids
from robofleet.vehicles.solids import Solid

CORNERS = 200  # of one outline

Corner = Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]
Corners = Annotated[tuple[Corner, ...], Field(min_length=3, max_length=CORNERS, strict=False)]

_LEAST_AREA_M2 = 1e-6


class Circle(Model):
    """A round obstacle."""

    x_m: Coordinate
    """x of its middle [world frame]."""
    y_m: Coordinate
    """y of its middle [world frame]."""
    radius_m: Length
    """Its radius."""


class Obstacle(Model):
    """Something on the floor that does not move: a circle, or a polygon. Robots keep clear of it."""

    name: Name | None = None
    """Its name in messages; null: ``obstacle1``, ``obstacle2`` ... by its place in the list."""
    circle: Circle | None = None
    """A round obstacle."""
    polygon_m: Corners | None = None
    """An obstacle with corners, each as [x, y] in the world frame, in their order around it. Its outline must not cross
    itself; it need not be convex."""
    height_m: Height = 0.1
    """Its height, for viewers that draw in three dimensions."""


class Moving(Model):
    """Something that carries a tag and that somebody moves, for example a person's cart. Robots keep clear of it
    wherever it is seen, as of a robot that nobody drives."""

    name: Name
    """Its name in messages; no robot has the same."""
    tag: Annotated[int, Field(ge=0, le=65535)]
    """Id of its AprilTag, as of a robot."""
    radius_m: Length
    """Radius of the smallest disc, about the middle of its tag, that covers it."""
    speed_m_s: Annotated[float, within(0.01, 10)] = 0.2
    """Fastest speed at which it is moved. While its tag is not seen, robots keep so much further away each second, up
    to ``controller.filter.lost_after_s``; after two seconds the run is held."""
    tag_height_m: Height | None = None
    """Height of its tag above the floor; null: ``tracker.tag_height_m``."""
    start: StartPose | None = None
    """Where it stands at first. A simulated one begins there."""


def title(index: int, obstacle: Obstacle) -> str:
    return obstacle.name or f"obstacle{index + 1}"


Side = Annotated[float, within(0.1, 1000)]
Wall = Annotated[tuple[Coordinate, Coordinate, Coordinate, Coordinate], Field(strict=False)]


class Arena(Model):
    """The floor on which the robots may drive: a rectangle around the world's origin."""

    name: Name
    """Name of the arena on the bus and in commands such as ``robofleet stop NAME``. An arena has one run at a time."""
    size_m: Annotated[tuple[Side, Side], Field(strict=False)]
    """Length of the floor along x and along y."""
    floor_m: Corners | None = None
    """The floor's corners in their order, each as [x, y] in metres, where it is no rectangle: the robots stay inside.
    All lie within ``size_m``. null: the whole rectangle."""
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MANY, strict=False)] = ()
    """What stands on the floor. The barrier keeps every robot clear of it, and ``go_to`` drives round it."""
    moving: Annotated[tuple[Moving, ...], Field(max_length=ROBOTS, strict=False)] = ()
    """What carries a tag and is moved by somebody. The tracker finds it, and robots keep clear of it as of a robot in
    no group."""
    walls: Annotated[tuple[Wall, ...] | None, Field(max_length=MANY, strict=False)] = None
    """What simulated distance sensors see beside robots: straight walls, each from one point to another, as
    [x1, y1, x2, y2] in metres. null: the edges of the floor. They see obstacles, too. Robots keep clear of the edges
    and of obstacles, and of no other wall."""


def standing(arena: Arena) -> tuple[Solid, ...]:
    return tuple(_solid(title(i, obstacle), obstacle) for i, obstacle in enumerate(arena.obstacles))


def every(arena: Arena) -> tuple[Solid, ...]:
    """Return what robots keep clear of: the obstacles, and what lies outside a floor that is a polygon."""
    floor = () if arena.floor_m is None else (Solid("floor", arena.floor_m, floor=True),)
    return (*standing(arena), *floor)


def _solid(name: str, obstacle: Obstacle) -> Solid:
    if obstacle.circle is not None:
        c = obstacle.circle
        return Solid(name, ((c.x_m, c.y_m),), c.radius_m)
    return Solid(name, obstacle.polygon_m or ())


def complaints(arena: Arena) -> Iterator[tuple[str, str]]:
    """Yield what cannot be: (dotted path, what is wrong and how to mend it)."""
    length, width = arena.size_m
    if arena.floor_m is not None:
        yield from _outline("arena.floor_m", arena.floor_m)
        for k, (x, y) in enumerate(arena.floor_m):
            if max(abs(x) - length / 2, abs(y) - width / 2) > 1e-9:
                message = f"[{x:g}, {y:g}] is outside the arena of {length:g} x {width:g} m: move it, or raise size_m"
                yield f"arena.floor_m.{k}", message
    taken: dict[str, int] = {}
    for i, obstacle in enumerate(arena.obstacles):
        path, name = f"arena.obstacles.{i}", title(i, obstacle)
        if taken.setdefault(name, i) != i:
            yield f"{path}.name", f"{name} is obstacles.{taken[name]}'s already: give each its own"
        if (obstacle.circle is None) == (obstacle.polygon_m is None):
            yield path, "is a circle or a polygon: write `circle: {x_m: ..., y_m: ..., radius_m: ...}` or `polygon_m`"
            continue
        if obstacle.polygon_m is not None:
            faults = list(_outline(f"{path}.polygon_m", obstacle.polygon_m))
            yield from faults
            if faults:
                continue
        at = _solid(name, obstacle).outline
        low, high = at.min(axis=0), at.max(axis=0)
        if max(low[0] - length / 2, -length / 2 - high[0], low[1] - width / 2, -width / 2 - high[1]) > 0.0:
            yield path, f"{name} is outside the arena of {length:g} x {width:g} m: move it in, or remove it"


def _outline(path: str, corners: Sequence[tuple[float, float]]) -> Iterator[tuple[str, str]]:
    """Yield why corners are no polygon."""
    n = len(corners)
    edges = [(corners[k], corners[(k + 1) % n]) for k in range(n)]
    for k, (edge, other) in enumerate(edges):
        if math.dist(edge, other) < 1e-6:
            yield path, f"corner {k + 1} and the one after it are the same: remove one"
            return
    for (j, side), (k, across) in itertools.combinations(enumerate(edges), 2):
        if k - j not in (1, n - 1) and _cross(*side, *across):
            yield path, f"the side after corner {j + 1} crosses the side after corner {k + 1}: mend the corners' order"
            return
    if abs(solids.area(corners)) < _LEAST_AREA_M2:
        yield path, "has no area: its corners are on one line: move one"


def _cross(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float]) -> bool:
    """Whether a side from a to b meets one from c to d."""

    def side(p: Sequence[float], q: Sequence[float], r: Sequence[float]) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) <= 0 and side(c, d, a) * side(c, d, b) <= 0 and _overlap(a, b, c, d)


def _overlap(a: Sequence[float], b: Sequence[float], c: Sequence[float], d: Sequence[float]) -> bool:
    """Whether the boxes around two sides overlap: sides on one line need not meet."""
    return all(max(a[k], b[k]) >= min(c[k], d[k]) and max(c[k], d[k]) >= min(a[k], b[k]) for k in range(2))

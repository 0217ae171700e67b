"""The arena, the groups' shapes and the robots as Foxglove's shapes.

World frame in metres, each robot in a frame of its own.
"""

import math
from collections.abc import Iterator, Sequence
from enum import Enum
from functools import cache

from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from robofleet.behaviours import described
from robofleet.behaviours.interface import Dots, Shape
from robofleet.config import barrier, obstacles, slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, INK, QUIET
from robofleet.safety.distances import apart
from robofleet.vehicles.solids import area

Point = Sequence[float]
Point3D = tuple[float, float, float]


def prism(outline: Sequence[Point], height: float, color: Color) -> TriangleListPrimitive:
    """Return the sides and the top of a solid whose corners are counter-clockwise."""
    top = [(x, y, height) for triangle in triangles(outline) for x, y in triangle]
    at = [Point3(x=x, y=y, z=z) for x, y, z in (*top, *_sides(outline, height))]
    return TriangleListPrimitive(pose=Pose(orientation=Quaternion(w=1.0)), points=at, color=color)


def _sides(outline: Sequence[Point], height: float) -> Iterator[Point3D]:
    for (x, y), (to_x, to_y) in zip(outline, (*outline[1:], outline[0]), strict=True):
        yield from ((x, y, 0.0), (to_x, to_y, 0.0), (to_x, to_y, height))
        yield from ((x, y, 0.0), (to_x, to_y, height), (x, y, height))


def triangles(outline: Sequence[Point]) -> list[tuple[Point, Point, Point]]:
    """Return triangles that fill a polygon whose corners are counter-clockwise: an ear is cut off at a time."""
    left, found = [tuple(corner) for corner in outline], []
    while len(left) > 3:
        k = next((k for k in range(len(left)) if _is_ear(left, k)), 0)
        found.append((left[k - 1], left[k], left[(k + 1) % len(left)]))
        del left[k]
    return [*found, (left[0], left[1], left[2])]


def _is_ear(corners: Sequence[tuple[float, ...]], k: int) -> bool:
    a, b, c = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
    others = [corner for corner in corners if corner not in (a, b, c)]
    return _left(a, b, c) > 0.0 and not any(_inside(a, b, c, corner) for corner in others)


def _inside(a: Point, b: Point, c: Point, at: Point) -> bool:
    return _left(a, b, at) >= 0.0 and _left(b, c, at) >= 0.0 and _left(c, a, at) >= 0.0


def _left(a: Point, b: Point, c: Point) -> float:
    return area([(a[0], a[1]), (b[0], b[1]), (c[0], c[1])])


WORLD = "world"
_LINE_M, _FILM_M, _DOT_M = 0.006, 0.001, 0.03
_TEXT_M = 0.07
_HAZE_OPACITY = 0.2  # of what is no body


class Look(Enum):
    """How a robot is doing, and its colour."""

    STANDING = QUIET
    RUNNING = COLOURS[0]
    HALTED = COLOURS[4]  # by the supervisor, or the whole run is
    LOST = COLOURS[3]  # not seen: where it is shown it was predicted
    LATCHED = COLOURS[1]


@cache
def colour(code: str, opacity: float = 1.0) -> Color:
    """Return a colour of the form #rrggbb."""
    r, g, b = (int(code[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return Color(r=r, g=g, b=b, a=opacity)


def arena(config: Config, groups: Sequence[described.Group], at: Timestamp) -> list[SceneEntity]:
    """Return the arena's edge, obstacles, and what the groups' behaviours have on the floor."""
    (length, width), robots = config.arena.size_m, [robot.id for robot in config.members]
    corners = [(x * length / 2, y * width / 2) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    edges = [_line(LinePrimitive.LINE_LOOP, outline, INK) for outline in (corners, config.arena.floor_m) if outline]
    return [
        SceneEntity(timestamp=at, frame_id=WORLD, id="arena", lines=edges),
        *_obstacles(config, at),
        *(_shape(f"{group.name}/{shape.name}", shape, robots, at) for group in groups for shape in group.shapes),
    ]


def _obstacles(config: Config, at: Timestamp) -> Iterator[SceneEntity]:
    for solid, obstacle in zip(obstacles.standing(config.arena), config.arena.obstacles, strict=True):
        outline = solid.outline.tolist()
        x, y = solid.outline.mean(axis=0).tolist()
        yield SceneEntity(
            timestamp=at, frame_id=WORLD, id=f"obstacles/{solid.name}",
            triangles=[prism(outline, obstacle.height_m, colour(QUIET))],
            lines=[_line(LinePrimitive.LINE_LOOP, outline, INK)],
            texts=[
                TextPrimitive(
                    pose=_at(x, y, obstacle.height_m + _TEXT_M), billboard=True, font_size=_TEXT_M, color=colour(INK),
                    text=solid.name,
                )
            ],
        )  # fmt: skip


def mark(group: str, shape: Shape, robots: list[str], at: Timestamp) -> SceneUpdate:
    """Return a mark of a script; one without points is taken away."""
    name = f"{group}/{shape.name}"
    if not len(shape.points):
        return SceneUpdate(deletions=[SceneEntityDeletion(timestamp=at, id=name)])
    return SceneUpdate(entities=[_shape(name, shape, robots, at)])


def _shape(name: str, shape: Shape, robots: list[str], at: Timestamp) -> SceneEntity:
    """Return a shape; a line that has the name of a robot has its colour."""
    points = shape.points.tolist()
    if isinstance(shape, Dots):
        spheres = [_dot(x, y, COLOURS[row % len(COLOURS)]) for row, (x, y) in enumerate(points)]
        return SceneEntity(timestamp=at, frame_id=WORLD, id=name, spheres=spheres)
    own = COLOURS[robots.index(shape.name) % len(COLOURS)] if shape.name in robots else QUIET
    kind = LinePrimitive.LINE_LOOP if shape.closed else LinePrimitive.LINE_STRIP
    return SceneEntity(timestamp=at, frame_id=WORLD, id=name, lines=[_line(kind, points, own)])


def robot(config: Config, robot: Robot, look: Look, at: Timestamp) -> SceneEntity:
    """Return a robot in its own frame: body, heading, id, and half of what it keeps from another one like it."""
    radius, side = robot.vehicle.body_radius_m, config.tracker.tag_side_m
    height = slices.tag_height_m(config, robot)
    keepout, body = barrier.keepout(config), barrier.body(config, robot)
    kept = apart(keepout, body, body)  # between the points in front of the axles
    return SceneEntity(
        timestamp=at,
        frame_id=robot.id,
        id=robot.id,
        frame_locked=True,
        metadata=[KeyValuePair(key="state", value=look.name.lower())],
        cylinders=[
            _disc(0.0, 2 * radius, height, colour(look.value)),
            _disc(keepout.ahead, kept, _FILM_M, colour(look.value, _HAZE_OPACITY)),
        ],
        arrows=[
            ArrowPrimitive(
                pose=_at(0.0, 0.0, height), shaft_length=radius, shaft_diameter=side / 6, head_length=radius / 2,
                head_diameter=side / 2, color=colour(INK),
            )
        ],
        texts=[
            TextPrimitive(
                pose=_at(-radius, 0.0, height + _TEXT_M), billboard=True, font_size=_TEXT_M, color=colour(INK),
                text=robot.id,
            )
        ],
    )  # fmt: skip


def references(rows: Sequence[int], points: Array, at: Timestamp) -> SceneEntity:
    """Return where robots (by row) should be at the horizon, each with a line from its point (N, 4: point, there)."""
    dots, lines = [], []
    for row, (x, y, there_x, there_y) in zip(rows, points.tolist(), strict=True):
        dots.append(_dot(there_x, there_y, COLOURS[row % len(COLOURS)]))
        lines += [(x, y), (there_x, there_y)]
    return SceneEntity(
        timestamp=at, frame_id=WORLD, id="references", spheres=dots,
        lines=[_line(LinePrimitive.LINE_LIST, lines, QUIET)],
    )  # fmt: skip


def turned(psi: float) -> Quaternion:
    return Quaternion(z=math.sin(psi / 2), w=math.cos(psi / 2))


def _at(x: float, y: float, z: float) -> Pose:
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))


def _dot(x: float, y: float, code: str) -> SpherePrimitive:
    return SpherePrimitive(pose=_at(x, y, 0.0), size=Vector3(x=_DOT_M, y=_DOT_M, z=_DOT_M), color=colour(code))


def _disc(forward: float, diameter: float, height: float, color: Color) -> CylinderPrimitive:
    size = Vector3(x=diameter, y=diameter, z=height)
    return CylinderPrimitive(
        pose=_at(forward, 0.0, height / 2), size=size, bottom_scale=1.0, top_scale=1.0, color=color
    )


def _line(kind: LinePrimitive.Type.ValueType, points: Sequence[tuple[float, float]], code: str) -> LinePrimitive:
    at = [Point3(x=x, y=y) for x, y in points]
    return LinePrimitive(type=kind, pose=_at(0.0, 0.0, _FILM_M), thickness=_LINE_M, points=at, color=colour(code))

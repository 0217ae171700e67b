"""Obstacles as Foxglove's shapes: what stands on the floor has sides and a top."""

from collections.abc import Iterator, Sequence

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

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

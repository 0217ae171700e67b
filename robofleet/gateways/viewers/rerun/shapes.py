"""Foxglove's shapes as rerun's archetypes."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import rerun as rr
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from numpy.typing import NDArray

_LABEL_PX = -1.0  # rerun takes negative radii as points of the screen


def of_entity(entity: SceneEntity) -> Iterator[rr.AsComponents]:
    """Yield an archetype for each kind of primitive that an entity has, and its frame."""
    yield rr.CoordinateFrame(entity.frame_id)
    if entity.lines:
        strips = [strip for line in entity.lines for strip in _strips(line)]
        looks = [(line.thickness / 2, _rgba(line.color)) for line in entity.lines for _ in _strips(line)]
        yield rr.LineStrips3D(strips, radii=[radius for radius, _ in looks], colors=[colour for _, colour in looks])
    if entity.spheres:
        yield rr.Ellipsoids3D(
            centers=[_xyz(sphere.pose.position) for sphere in entity.spheres],
            half_sizes=[np.divide(_xyz(sphere.size), 2) for sphere in entity.spheres],
            colors=_colours(entity.spheres), fill_mode="solid",
        )  # fmt: skip
    if entity.cylinders:
        yield rr.Cylinders3D(
            centers=[_xyz(cylinder.pose.position) for cylinder in entity.cylinders],
            quaternions=[_turn(cylinder.pose) for cylinder in entity.cylinders],
            lengths=[cylinder.size.z for cylinder in entity.cylinders],
            radii=[cylinder.size.x / 2 for cylinder in entity.cylinders],
            colors=_colours(entity.cylinders), fill_mode="solid",
        )  # fmt: skip
    if entity.arrows:
        yield rr.Arrows3D(
            origins=[_xyz(arrow.pose.position) for arrow in entity.arrows],
            vectors=[
                _placed(arrow.pose, [Point3(x=arrow.shaft_length + arrow.head_length)])[0] - _xyz(arrow.pose.position)
                for arrow in entity.arrows
            ],
            radii=[arrow.shaft_diameter / 2 for arrow in entity.arrows],
            colors=_colours(entity.arrows),
        )
    if entity.triangles:
        yield rr.Mesh3D(
            vertex_positions=np.vstack([_placed(mesh.pose, mesh.points) for mesh in entity.triangles]),
            vertex_colors=[_rgba(mesh.color) for mesh in entity.triangles for _ in mesh.points],
        )
    if entity.texts:
        yield rr.Points3D(
            [_xyz(text.pose.position) for text in entity.texts], labels=[text.text for text in entity.texts],
            radii=_LABEL_PX, colors=_colours(entity.texts), show_labels=True,
        )  # fmt: skip


def of_annotations(drawn: ImageAnnotations) -> Iterator[rr.AsComponents]:
    """Yield the outlines of a picture, and the words at them, in pixels from its corner."""
    outlines = [[(point.x, point.y) for point in (*loop.points, *loop.points[:1])] for loop in drawn.points]
    widths = [-loop.thickness / 2 for loop in drawn.points]
    yield rr.LineStrips2D(outlines, radii=widths, colors=[_rgba(loop.outline_color) for loop in drawn.points])
    yield rr.Points2D(
        [(text.position.x, text.position.y) for text in drawn.texts], labels=[text.text for text in drawn.texts],
        radii=_LABEL_PX, colors=[_rgba(text.text_color) for text in drawn.texts], show_labels=True,
    )  # fmt: skip


def _strips(line: LinePrimitive) -> list[NDArray[np.float64]]:
    points = _placed(line.pose, line.points)
    if line.type == LinePrimitive.LINE_LIST:
        return [*points.reshape(-1, 2, 3)]
    return [np.vstack([points, points[:1]]) if line.type == LinePrimitive.LINE_LOOP else points]


@np.errstate(over="ignore", invalid="ignore")
def _placed(pose: Pose, points: Sequence[Point3]) -> NDArray[np.float64]:
    """Return points (N, 3) in the frame in which a pose is; infinite or NaN where the figures are too large."""
    *v, w = _turn(pose)
    local = np.reshape([_xyz(point) for point in points], (-1, 3))
    across = 2.0 * np.cross(v, local)
    turned: NDArray[np.float64] = local + w * across + np.cross(v, across) + _xyz(pose.position)
    return turned


def _turn(pose: Pose) -> tuple[float, float, float, float]:
    return pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w


def _xyz(vector: Point3 | Vector3) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _colours(primitives: Iterable[object]) -> list[tuple[int, ...]]:
    return [_rgba(primitive.color) for primitive in primitives]  # type: ignore[attr-defined]


def _rgba(colour: Color) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in (colour.r, colour.g, colour.b, colour.a))

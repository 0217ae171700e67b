"""The camera's pictures with what the tracker found in them."""

import math

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from robofleet.bus.messages import TagPose
from robofleet.config.tree import Config
from robofleet.recording.scenes.shapes import WORLD, colour
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.outlines import TagOutlines
from robofleet.tracking.pictures import picture_size

_FONT_PX, _LINE_PX = 22.0, 2.0
_MEASURED, _PREDICTED, _LABEL = "#1fd655", "#ffb000", "#000000"  # on grey images
# Foxglove's names of the lenses that OpenCV's coefficients mean, with how many of them; longer ones it does not know.
_PINHOLES = (("plumb_bob", 5), ("rational_polynomial", 8))


def camera_topic(view: Config) -> str:
    """Return the topic below which viewers find a camera's pictures."""
    return "/camera" if len(view.views) == 1 else f"/camera/{view.camera.name}"


class Overlay:
    """Where the fleet's tags are in a picture. A drift that the tracker corrects is not followed."""

    def __init__(self, config: Config) -> None:
        model, self.camera = config.camera.model, config.camera.name
        self.topic = camera_topic(config)
        self._model, self._geometry = model, CameraGeometry.from_model(model)
        self._size = picture_size(model.width, model.height)
        self._scale = np.array(self._size) / (model.width, model.height)
        self._outlines = TagOutlines(config)
        self._robots = {robot.tag: robot.id for robot in config.robots}

    def place(self, at: Timestamp) -> FrameTransform:
        x, y, z = self._geometry.position.tolist()
        rotation = cv2.Rodrigues(self._geometry.T_world_camera[:3, :3])[0].ravel()
        angle = float(np.linalg.norm(rotation))
        a, b, c = (math.sin(angle / 2) / (angle or 1.0) * rotation).tolist()
        return FrameTransform(
            timestamp=at, parent_frame_id=WORLD, child_frame_id=self.camera, translation=Vector3(x=x, y=y, z=z),
            rotation=Quaternion(x=a, y=b, z=c, w=math.cos(angle / 2)),
        )  # fmt: skip

    def calibration(self, at: Timestamp) -> CameraCalibration | None:
        """Return the lens, for pictures of the size that is shown; None where Foxglove has no name for it."""
        model, width, height = self._model, *self._size
        terms = list(model.distortion)
        kinds = [("kannala_brandt", 4)] if model.lens == "fisheye" else [k for k in _PINHOLES if len(terms) <= k[1]]
        if not kinds:
            return None
        (f_x, f_y), (s_x, s_y) = model.focal_px, self._scale.tolist()
        c_x, c_y = (((np.array(model.centre_px) + 0.5) * self._scale) - 0.5).tolist()
        name, count = kinds[0]
        return CameraCalibration(
            timestamp=at, frame_id=self.camera, width=width, height=height, distortion_model=name,
            D=terms + [0.0] * (count - len(terms)),
            K=[f_x * s_x, 0.0, c_x, 0.0, f_y * s_y, c_y, 0.0, 0.0, 1.0],
            R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            P=[f_x * s_x, 0.0, c_x, 0.0, 0.0, f_y * s_y, c_y, 0.0, 0.0, 0.0, 1.0, 0.0],
        )  # fmt: skip

    def outlines(self, poses: tuple[TagPose, ...], at: Timestamp) -> ImageAnnotations:
        """Return the outlines of the robots' tags with the robots' ids; what was predicted has another colour."""
        drawn, coasted = ImageAnnotations(timestamp=at), {pose.tag: pose.coasted_ns for pose in poses}
        for tag, outline in self._outlines.of(poses).items():
            # Foxglove's origin is the corner of the first pixel, not its centre.
            corners = [Point2(x=u, y=v) for u, v in ((outline + 0.5) * self._scale).tolist()]
            ink = colour(_PREDICTED if coasted[tag] else _MEASURED)
            kind = PointsAnnotation.LINE_LOOP
            drawn.points.append(
                PointsAnnotation(timestamp=at, type=kind, points=corners, outline_color=ink, thickness=_LINE_PX)
            )
            text, corner = self._robots[tag], max(corners, key=lambda point: point.x)
            drawn.texts.append(TextAnnotation(
                timestamp=at, position=corner, text=text, font_size=_FONT_PX, text_color=ink,
                background_color=colour(_LABEL, 0.6),
            ))  # fmt: skip
        return drawn

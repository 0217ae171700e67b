"""The camera's pictures, which the tracker shows while somebody looks, and what is known of its lens and place."""

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus
from robofleet.bus.keys import PICTURE, SAFE_REQUEST
from robofleet.bus.observer import Observer, Source
from robofleet.config.calibrated import CameraModel
from robofleet.config.camera import CameraSettings
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph, wanted
from robofleet.gateways.ros2.robots import Robots
from robofleet.nodes.pictures import REQUESTED
from robofleet.tracking.pictures import picture_size

_REQUEST_PERIOD_NS = S  # a request holds for two seconds
_PLUMB_BOB_COEFFICIENTS = 5  # of sensor_msgs' plumb_bob, at most


class Camera:
    """One camera, as its ``tracker`` has it; ``robots`` knows when its images were exposed."""

    def __init__(self, graph: Graph, tracker: str, view: Config, robots: Robots, bus: Bus, observer: Observer) -> None:
        self._graph, self._robots, self._bus, self._tracker = graph, robots, bus, tracker
        self._name = view.camera.name
        self._image, self._compressed, self._lens = (
            graph.publisher(topic, topics.ros_name(self._name))
            for topic in (topics.IMAGE, topics.COMPRESSED, topics.CAMERA_INFO)
        )
        self._frame = graph.frames.optical(topics.ros_name(self._name))
        self._info = camera_info(graph, view.camera.model, self._frame)
        self._observer = observer
        observer.declare([(PICTURE, self._name)])
        self._requested_ns: int | None = None

    def step(self, now_ns: int, updated: set[Source]) -> None:
        """Request pictures while somebody subscribes, and publish them."""
        looked_at = any(map(wanted, (self._image, self._compressed, self._lens)))
        if looked_at and (self._requested_ns is None or now_ns - self._requested_ns >= _REQUEST_PERIOD_NS):
            self._bus.ask(SAFE_REQUEST, self._tracker, REQUESTED)
            self._requested_ns = now_ns
        if looked_at and (source := (PICTURE, self._name)) in updated:
            picture = self._observer[source]
            self._say(self._graph.stamp(self._robots.exposed_ns(self._name, picture.exposure_ns)), picture.jpeg)

    def _say(self, stamp: Any, jpeg: bytes) -> None:
        self._info.header.stamp = stamp
        self._lens.publish(self._info)
        if wanted(self._compressed):
            image = self._graph.messages.CompressedImage(format="mono8; jpeg compressed ", data=jpeg)
            image.header.stamp, image.header.frame_id = stamp, self._frame
            self._compressed.publish(image)
        if wanted(self._image):
            pixels = decoded(jpeg)
            if pixels is not None:
                height, width = pixels.shape
                plain = self._graph.messages.Image(
                    height=height, width=width, encoding="mono8", step=width, data=pixels.tobytes()
                )
                plain.header.stamp, plain.header.frame_id = stamp, self._frame
                self._image.publish(plain)


def decoded(jpeg: bytes) -> NDArray[np.uint8] | None:
    """Return a picture's pixels; None where it is none."""
    try:
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)  # type: ignore[return-value]
    except cv2.error:  # of no bytes, and of more pixels than it takes
        return None


def camera_info(graph: Graph, model: CameraModel, frame: str) -> Any:
    """Return what is known of the lens, for pictures that may be smaller than the camera's images."""
    width, height = picture_size(model.width, model.height)
    scale = width / model.width, height / model.height
    f_x, f_y = (focal * part for focal, part in zip(model.focal_px, scale, strict=True))
    c_x, c_y = (  # pixels' centres are at whole numbers
        (centre + 0.5) * part - 0.5 for centre, part in zip(model.centre_px, scale, strict=True)
    )
    known = list(model.distortion)
    if model.lens == "fisheye":
        kind, coefficients = "equidistant", known
    elif len(known) <= _PLUMB_BOB_COEFFICIENTS:
        kind, coefficients = "plumb_bob", known + [0.0] * (_PLUMB_BOB_COEFFICIENTS - len(known))
    else:
        kind, coefficients = "rational_polynomial", known
    info = graph.messages.CameraInfo(
        height=height, width=width, distortion_model=kind, d=coefficients,
        k=[f_x, 0.0, c_x, 0.0, f_y, c_y, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[f_x, 0.0, c_x, 0.0, 0.0, f_y, c_y, 0.0, 0.0, 0.0, 1.0, 0.0],
    )  # fmt: skip
    info.header.frame_id = frame
    return info


def place(graph: Graph, camera: CameraSettings, stamp: Any) -> Any | None:
    """Return where the camera is in the map; None where nobody measured it."""
    pose = camera.model.T_world_camera
    if pose is None:
        return None
    message = graph.messages.TransformStamped(child_frame_id=graph.frames.optical(topics.ros_name(camera.name)))
    message.header.stamp, message.header.frame_id = stamp, graph.frames.map
    way, turn = message.transform.translation, message.transform.rotation
    way.x, way.y, way.z = map(float, pose.position_m)
    axis = np.array(pose.rotation_rad, dtype=np.float64)
    angle = float(np.linalg.norm(axis))
    turn.x, turn.y, turn.z = (axis * (math.sin(angle / 2.0) / angle if angle else 0.5)).tolist()
    turn.w = math.cos(angle / 2.0)
    return message

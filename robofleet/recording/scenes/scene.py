"""A run as viewers draw it: what is said on the bus, told again in Foxglove's messages (protobuf).

Poses come ten times a second, as the controller estimates them and, where that is known, as they truly are; what
changes seldom is told when it changes. A robot's shapes lie in its own frame: viewers move them by ``/tf``.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from mcap_protobuf.schema import build_file_descriptor_set

from robofleet.behaviours import described
from robofleet.bus.keys import BUSY, NEWS, NOTE, PICTURE, POSES, STATE, STATUS, TICK, TRUTH, key
from robofleet.bus.messages import BUSY_MACHINE, FLEET_POSES, RUN_STATE, TRACKER_NEWS, UNIT_STATUS, FleetPoses
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.bus.notes import noted
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.recording.channels import Channel, of_protobuf
from robofleet.recording.lines import Line, busy_line, latch_line, news_line, note_line, state_lines
from robofleet.recording.scenes import shapes
from robofleet.recording.scenes.fleet_scene import FleetScene, TopicMessages, pose_topic, stamp
from robofleet.recording.scenes.overlay import Overlay

_PERIOD_NS = S // 10
_KEPT_IMAGES = 8  # whose poses are kept until their picture comes


class Scene:
    """Makes viewers' messages of the bus's messages, which it is given in order."""

    def __init__(self, config: Config, groups: Sequence[described.Group], *, epoch_ns: int = 0) -> None:
        """Take what makes instants of the caller's clock dates [ns since 1970]."""
        self._config, self._groups, self._epoch_ns = config, groups, epoch_ns
        self._ids = config.ids
        self._fleet = FleetScene(config, groups)
        self._overlays = [Overlay(view) for view in config.views] if config.tracker.source == "camera" else []
        self.channels = tuple(self._channels())
        self._takes = self._by_key()
        self._due_ns = 0
        self._busy = False  # the machine, and that was told
        self._images: dict[str, deque[tuple[int, bytes]]] = {
            camera: deque(maxlen=_KEPT_IMAGES) for camera in config.camera_names
        }

    def update(self, full: str, payload: bytes, at_ns: int) -> list[tuple[str, bytes]]:
        """Return (topic, message) of what a message of the bus changes in the picture.

        ``at_ns``: when it came, on the caller's clock.
        """
        date_ns = at_ns + self._epoch_ns
        take = self._takes.get(full)
        messages = () if take is None else take(payload, date_ns)
        if at_ns >= self._due_ns:
            messages = (*messages, *self._draw(at_ns, date_ns))
        return [(topic, message.SerializeToString()) for topic, message in messages] if messages else []

    def _draw(self, at_ns: int, date_ns: int) -> TopicMessages:
        first, self._due_ns = not self._due_ns, (at_ns // _PERIOD_NS + 1) * _PERIOD_NS
        return (*(self._unchanging(date_ns) if first else ()), *self._fleet.draw(date_ns))

    def _channels(self) -> Iterator[Channel]:
        kinds: dict[str, type[Message]] = {
            "/tf": FrameTransforms, "/tf_static": FrameTransforms, "/arena": SceneUpdate, "/fleet": SceneUpdate,
            "/references": SceneUpdate, "/log": Log, **{pose_topic(robot): PoseInFrame for robot in self._ids},
        }  # fmt: skip
        for overlay in self._overlays:
            kinds |= {f"{overlay.topic}/image": CompressedImage, f"{overlay.topic}/annotations": ImageAnnotations}
            kinds[f"{overlay.topic}/calibration"] = CameraCalibration
        for topic, kind in kinds.items():
            yield of_protobuf(topic, kind.DESCRIPTOR.full_name, build_file_descriptor_set(kind).SerializeToString())

    def _by_key(self) -> dict[str, Callable[[bytes, int], TopicMessages]]:
        arena = self._config.arena.name
        takes: dict[str, Callable[[bytes, int], TopicMessages]] = {
            key(arena, TICK): self._fleet.tick,
            key(arena, STATE): self._state,
            key(arena, BUSY): self._is_busy,
        }
        cameras = self._config.camera_names
        for camera in cameras:
            takes[key(arena, NEWS, camera)] = partial(self._news, camera if len(cameras) > 1 else "")
            if self._overlays or self._config.bystanders:
                takes[key(arena, POSES, camera)] = partial(self._poses, camera)
        for overlay in self._overlays:
            takes[key(arena, PICTURE, overlay.camera)] = partial(self._picture, overlay)
        rows = {robot: row for row, robot in enumerate(self._ids)}
        for unit, robots in self._config.units.items():
            takes[key(arena, STATUS, unit)] = partial(self._status, [rows[robot] for robot in robots])
            takes[key(arena, TRUTH, unit)] = partial(self._fleet.truth, unit)
        for group in self._groups:
            takes[key(arena, NOTE, group.name)] = partial(self._noted, group.name)
        return takes

    def _noted(self, group: str, payload: bytes, date_ns: int) -> TopicMessages:
        note = noted(payload)
        if note is None:
            return ()
        if note.line is not None:
            return _log([note_line(group, note.line)], date_ns)
        if note.mark is None:
            return ()
        robots = [robot.id for robot in self._config.members]
        return (("/arena", shapes.mark(group, note.mark, robots, stamp(date_ns))),)

    def _unchanging(self, date_ns: int) -> TopicMessages:
        at = stamp(date_ns)
        messages: list[tuple[str, Message]] = [
            ("/arena", SceneUpdate(entities=shapes.arena(self._config, self._groups, at)))
        ]
        if self._overlays:
            places = [overlay.place(at) for overlay in self._overlays]
            messages.append(("/tf_static", FrameTransforms(transforms=places)))
        for overlay in self._overlays:
            if (lens := overlay.calibration(at)) is not None:
                messages.append((f"{overlay.topic}/calibration", lens))
        return messages

    def _state(self, payload: bytes, date_ns: int) -> TopicMessages:
        before, state = self._fleet.state, RUN_STATE.decode(payload)
        if state is None or (before is not None and state.repeats(before)):
            return ()
        self._fleet.state = state
        return _log(state_lines(before, state, self._ids), date_ns)

    def _status(self, rows: list[int], payload: bytes, date_ns: int) -> TopicMessages:
        latches, before = UNIT_STATUS.column(payload, "latch"), self._fleet.latches
        if latches is None or len(latches) != len(rows):
            return ()
        new = [
            (row, newest_latch)
            for row, newest_latch in zip(rows, latches.tolist(), strict=True)
            if newest_latch != before[row]
        ]
        for row, latch in new:
            before[row] = latch
        return _log([latch_line(self._ids[row], latch) for row, latch in new], date_ns)

    def _news(self, camera: str, payload: bytes, date_ns: int) -> TopicMessages:
        news = TRACKER_NEWS.decode(payload)
        return () if news is None else _log([news_line(news, camera)], date_ns)

    def _is_busy(self, payload: bytes, date_ns: int) -> TopicMessages:
        message = None if self._busy else BUSY_MACHINE.decode(payload)
        self._busy = self._busy or message is not None
        return () if message is None else _log([busy_line(message, self._ids)], date_ns)

    def _poses(self, camera: str, payload: bytes, date_ns: int) -> TopicMessages:
        self._images[camera].append((date_ns, payload))
        return self._fleet.image(payload, date_ns)

    def _picture(self, overlay: Overlay, payload: bytes, date_ns: int) -> TopicMessages:
        picture = PICTURE_LAYOUT.decode(payload)
        if picture is None:
            return ()
        exposed, poses = self._image(overlay.camera, picture.exposure_ns) or (date_ns, None)
        at = stamp(exposed)
        shown = CompressedImage(timestamp=at, frame_id=overlay.camera, data=picture.jpeg, format="jpeg")
        if poses is None:
            return ((f"{overlay.topic}/image", shown),)
        drawn = overlay.outlines(poses.poses, at)
        return (f"{overlay.topic}/image", shown), (f"{overlay.topic}/annotations", drawn)

    def _image(self, camera: str, exposure_ns: int) -> tuple[int, FleetPoses] | None:
        """Return an image's date and its poses. The tracker's clock is not compared with this one."""
        for date_ns, payload in self._images[camera]:
            poses = FLEET_POSES.decode(payload)
            if poses is not None and poses.exposure_ns == exposure_ns:
                return date_ns - (poses.sent_ns - exposure_ns), poses
        return None


def _log(lines: Iterable[Line], date_ns: int) -> TopicMessages:
    at = stamp(date_ns)
    return [
        ("/log", Log(timestamp=at, level=Log.Level.ValueType(level), name=name, message=words))
        for level, name, words in lines
    ]

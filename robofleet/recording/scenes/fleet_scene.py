"""The fleet as viewers draw it: frames that move, and shapes in them."""

from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from robofleet.behaviours import described
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, UNIT_TRUTH, RobotTick, RunState
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.recording.causes import driven_out
from robofleet.recording.scenes import shapes
from robofleet.recording.scenes.shapes import WORLD, Look
from robofleet.safety.supervisor import Phase

_STOPPED = (Phase.HOLD, Phase.FAULT, Phase.ESTOP)

TopicMessages = Sequence[tuple[str, Message]]  # (topic, message)


def stamp(date_ns: int) -> Timestamp:
    seconds, nanos = divmod(date_ns, S)
    return Timestamp(seconds=seconds, nanos=nanos)


def pose_topic(robot: str) -> str:
    return f"/robots/{robot}/pose"


class FleetScene:
    """Draws what has changed of the robots. Times are dates [ns].

    Rows are in the bodies' order: the group's robots, where the controller believes that they are, then the bystanders,
    where an image showed them.
    """

    def __init__(self, config: Config, groups: Sequence[described.Group]) -> None:
        self._groups = groups
        self._config, self._robots, self._driven = config, config.bodies, len(config.members)
        self._sizes = self._driven, described.size(groups, len(config.camera_names))  # of a tick
        self._parked = {robot.tag: self._driven + k for k, robot in enumerate(config.bystanders)}
        self._image: tuple[int, bytes] | None = None  # the newest one, where there are bystanders, and its date
        self.state: RunState | None = None  # as the supervisor said it last
        self.latches = [0] * len(self._robots)  # safety.latches.Latch
        self._ticked: tuple[int, bytes] | None = None  # the newest tick not drawn yet, and its date
        self._truths: dict[str, tuple[int, bytes]] = {}  # the same of every unit's truth
        self._items: tuple[RobotTick, ...] = ()  # of the tick drawn last
        self._seen: set[int] = set()  # rows; the others' estimates mean nothing
        self._looks: dict[int, Look] = {}  # as drawn
        self._references: list[int] = []  # rows; as drawn

    def tick(self, payload: bytes, date_ns: int) -> TopicMessages:
        """Take the controller's record; it is drawn later."""
        self._ticked = date_ns, payload
        return ()

    def truth(self, unit: str, payload: bytes, date_ns: int) -> TopicMessages:
        self._truths[unit] = date_ns, payload
        return ()

    def image(self, payload: bytes, date_ns: int) -> TopicMessages:
        self._image = (date_ns, payload) if self._parked else None
        return ()

    def draw(self, date_ns: int) -> TopicMessages:
        """Return what is new since the last call."""
        messages, frames = self._estimates()
        frames += self._standing()
        frames += self._true_frames()
        if frames:
            messages.append(("/tf", FrameTransforms(transforms=frames)))
        looks = {row: self._look(row) for row in self._seen}
        if looks != self._looks:
            self._looks, at = looks, stamp(date_ns)
            bodies = [shapes.robot(self._config, self._robots[row], look, at) for row, look in looks.items()]
            messages.append(("/fleet", SceneUpdate(entities=bodies)))
        return messages

    def _estimates(self) -> tuple[list[tuple[str, Message]], list[FrameTransform]]:
        """Where the newest tick says that the robots are, and are to be."""
        messages: list[tuple[str, Message]] = []
        frames: list[FrameTransform] = []
        (date_ns, payload), self._ticked = self._ticked or (0, b""), None
        tick = TICK_RECORD.decode(payload)
        if tick is None or (len(tick.robots), len(tick.figures)) != self._sizes:
            return messages, frames
        self._items, at = tick.robots, stamp(date_ns)
        self._seen.update(row for row, item in enumerate(self._items) if not item.lost)
        driven = [row for row in sorted(self._seen) if row < self._driven]
        for row in driven:
            robot, item = self._robots[row].id, self._items[row]
            frames.append(_frame(robot, at, item.x_m, item.y_m, item.psi_rad))
            pose = Pose(position=Vector3(x=item.x_m, y=item.y_m), orientation=shapes.turned(item.psi_rad))
            messages.append((pose_topic(robot), PoseInFrame(timestamp=at, frame_id=WORLD, pose=pose)))
        parts = described.parts(self._groups, np.array([tick.figures]))
        reference_points = np.concatenate([positions[0, :, :2] for positions in parts])
        known = np.isfinite(reference_points).all(axis=1).tolist()
        referring = [
            row for row in (driven if tick.phase == Phase.RUNNING else ()) if known[row] and self._permitted(row)
        ]
        if referring or self._references:
            here = [(self._items[row].point_x_m, self._items[row].point_y_m) for row in referring]
            points = np.hstack([np.reshape(here, (-1, 2)), reference_points[referring]])
            messages.append(("/references", SceneUpdate(entities=[shapes.references(referring, points, at)])))
        self._references = referring
        return messages, frames

    def _standing(self) -> list[FrameTransform]:
        (date_ns, payload), self._image = self._image or (0, b""), None
        image, frames = FLEET_POSES.decode(payload), []
        for pose in () if image is None else image.poses:
            row = self._parked.get(pose.tag)
            if row is not None and pose.coasted_ns == 0:
                self._seen.add(row)
                frames.append(_frame(self._robots[row].id, stamp(date_ns), pose.x_m, pose.y_m, pose.psi_rad))
        return frames

    def _true_frames(self) -> list[FrameTransform]:
        frames = []
        for unit, (date_ns, payload) in self._truths.items():
            truth_message, robots = UNIT_TRUTH.decode(payload), self._config.units[unit]
            for truth in () if truth_message is None else truth_message.robots:
                if truth.place < len(robots):
                    child = f"{robots[truth.place]}/truth"
                    frames.append(_frame(child, stamp(date_ns), truth.x_m, truth.y_m, truth.psi_rad))
        self._truths.clear()
        return frames

    def _look(self, row: int) -> Look:
        state = self.state
        if self.latches[row]:
            return Look.LATCHED
        if row < len(self._items) and self._items[row].lost:
            return Look.LOST
        if state is None or row >= len(state.robots):
            return Look.STANDING
        if driven_out(state, row):
            return Look.RUNNING
        if state.robots[row].cause or state.phase in _STOPPED:
            return Look.HALTED
        return Look.RUNNING if state.robots[row].permitted else Look.STANDING

    def _permitted(self, row: int) -> bool:
        state = self.state
        return state is not None and row < len(state.robots) and bool(state.robots[row].permitted)


def _frame(child: str, at: Timestamp, x: float, y: float, psi: float) -> FrameTransform:
    return FrameTransform(
        timestamp=at, parent_frame_id=WORLD, child_frame_id=child, translation=Vector3(x=x, y=y),
        rotation=shapes.turned(psi),
    )  # fmt: skip

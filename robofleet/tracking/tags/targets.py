"""What the tracker looks for."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from robofleet.config import slices
from robofleet.config.calibrated import FloorTag
from robofleet.config.tree import Config
from robofleet.core.settings import FAMILIES

_ANY_S = 1e9


class Target(NamedTuple):
    """A tag to follow."""

    tag: int
    side: float  # of its square [m]
    height: float  # above the floor [m]
    max_speed: float  # 0 for a tag that lies still [m/s]
    family: str = "36h11"  # one for all of a tracker
    side_tolerance: float = 5e-5  # by how much the side may be wrong [m]
    drives_on_s: float = 0.75  # for so long it may drive though this camera does not see it: then it is stopped

    @property
    def whole(self) -> float:
        """The side of the whole print [m]."""
        return self.side * FAMILIES[self.family].whole


def robot_targets(config: Config) -> list[Target]:
    """Return the tags of the robots that a camera can see, in the configuration's order."""
    t = config.tracker
    alone = len(config.views) == 1  # else another camera may see it
    return [
        Target(
            robot.tag,
            t.tag_side_m,
            slices.tag_height_m(config, robot),
            robot.vehicle.max_speed_m_s,
            t.family,
            t.tag_side_tolerance_m,
            *(() if alone else (_ANY_S,)),
        )
        for robot in config.seen
    ]


def floor_tags_in_view(config: Config) -> list[FloorTag]:
    """Return the tags on the floor that the calibrated camera shows whole, in the configuration's order."""
    tags, model = config.tracker.floor_tags, config.camera.model
    if not tags or model.T_world_camera is None:
        return []
    from robofleet.tracking.camera import CameraGeometry  # noqa: PLC0415 - it loads OpenCV

    geometry, points = CameraGeometry.from_model(model), []
    for tag, target in zip(tags, floor_targets(config, tags), strict=True):
        turn = math.radians(tag.heading_deg)
        for quarter in range(4):  # the print's corners
            angle, arm = turn + (quarter + 0.5) * math.pi / 2.0, target.whole / math.sqrt(2.0)
            points.append([tag.x_m + arm * math.cos(angle), tag.y_m + arm * math.sin(angle), tag.height_m])
    corners = geometry.sees(np.array(points), (model.width, model.height)).reshape(-1, 4)
    return [tag for tag, seen in zip(tags, corners, strict=True) if seen.all()]


def floor_targets(config: Config, tags: Sequence[FloorTag]) -> list[Target]:
    return [Target(floor.tag, floor.side_m, floor.height_m, 0.0, config.tracker.family) for floor in tags]

"""From an image to the poses of the robots' centres: tags, where they sit on their robots, and the camera's drift."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.config.calibrated import TagOffset
from robofleet.config.tree import Config
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.drift import DriftMonitor, Landmark
from robofleet.tracking.events import News, Notice
from robofleet.tracking.offset import centre_from_tag
from robofleet.tracking.targets import floor_targets, robot_targets
from robofleet.tracking.tracker import TagSighting, TagTracker

_BLIND_IMAGES = 10  # with robots in sight and no floor tag: the camera may look elsewhere


class RobotSighting(NamedTuple):
    """Planar pose of a robot's centre in the world frame; otherwise as :class:`TagSighting`."""

    tag: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad; CCW +]
    after_ns: int
    coasted_ns: int


class Sight(NamedTuple):
    """What one image tells."""

    robots: tuple[RobotSighting, ...]
    refused: int
    happenings: tuple[Notice, ...]


class FleetSight:
    """Sees a configuration's fleet. While the camera's place is in doubt no robot is measured."""

    def __init__(self, config: Config) -> None:
        model = config.camera.model
        geometry = CameraGeometry.from_model(model)
        targets = [*robot_targets(config), *floor_targets(config)]
        self._tracker = TagTracker(geometry, (model.width, model.height), targets, model.line_time_s)
        calibrated = {robot.tag: robot.calibration for robot in config.seen}
        self._offsets = {tag: c.tag_offset if c is not None else TagOffset() for tag, c in calibrated.items()}
        landmarks = [
            Landmark(floor.tag, floor.x_m, floor.y_m, math.radians(floor.heading_deg), floor.height_m)
            for floor in config.tracker.floor_tags
        ]
        self._drift = DriftMonitor(geometry, landmarks) if landmarks else None
        self._news = News()
        self._blind = 0

    def see(self, image: NDArray[np.uint8], exposure_ns: int) -> Sight:
        """Return what an image (H, W) tells. ``exposure_ns``: mid-exposure of its middle row."""
        poses, refused, happenings = self._tracker.track(image, exposure_ns)
        robots = [pose for pose in poses if pose.tag in self._offsets]
        measured = [pose for pose in poses if pose.coasted_ns == 0 and pose.tag not in self._offsets]
        if self._drift is not None:
            trusted = self._drift.trusted
            geometry, drifted = self._drift.update(measured)
            for happening in drifted:
                self._news.say(*happening, exposure_ns)
            happenings += self._news.take()
            if geometry is not None:
                self._tracker.moved(geometry)
            self._blind = 0 if measured else self._blind + 1
            # The image that ends the doubt was placed by the camera as it was before.
            if not (trusted and self._drift.trusted) or self._blind > _BLIND_IMAGES:
                robots = [pose for pose in robots if pose.coasted_ns]
        return Sight(tuple(map(self._robot, robots)), refused, happenings)

    def _robot(self, seen: TagSighting) -> RobotSighting:
        centre = centre_from_tag(seen.x, seen.y, seen.psi, self._offsets[seen.tag])
        return RobotSighting(seen.tag, *centre, seen.after_ns, seen.coasted_ns)

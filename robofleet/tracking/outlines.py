"""Where the tags of robots appear in an image: what is drawn over a picture."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import TagPose
from robofleet.config.tree import Config
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.offset import tag_from_centre
from robofleet.tracking.tags.targets import robot_targets

_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # of the print, from its top left, clockwise


class TagOutlines:
    """The corners of a fleet's tags in the image, from its robots' poses, by the camera's calibration."""

    def __init__(self, config: Config) -> None:
        self._geometry = CameraGeometry.from_model(config.camera.model)
        self._targets = {target.tag: target for target in robot_targets(config)}
        self._offsets = {robot.tag: robot.tag_offset for robot in config.seen}

    def of(self, poses: Iterable[TagPose]) -> dict[int, NDArray[np.float64]]:
        """Return the corners (4, 2) [px] of each tag of the fleet's, by its number."""
        corners = {pose.tag: self._corners(pose) for pose in poses if pose.tag in self._targets}
        if not corners:
            return {}
        pixels = self._geometry.project(np.concatenate(list(corners.values())))
        return dict(zip(corners, pixels.reshape(-1, 4, 2), strict=True))

    def _corners(self, pose: TagPose) -> NDArray[np.float64]:
        """Return a tag's corners (4, 3) [m; world]."""
        target = self._targets[pose.tag]
        x, y, psi = tag_from_centre(pose.x_m, pose.y_m, pose.psi_rad, self._offsets[pose.tag])
        right = np.array([np.cos(psi), np.sin(psi), 0.0])
        up = np.array([-np.sin(psi), np.cos(psi), 0.0])
        across, along = target.side * _CORNERS.T
        return np.array([x, y, target.height]) + np.outer(across, right) + np.outer(along, up)

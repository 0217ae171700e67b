"""Where the tags of robots appear in an image: what is drawn over a picture."""

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import TagPose
from robofleet.config.tree import Config
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.offset import tag_from_centre
from robofleet.tracking.tags.targets import Target, robot_targets

_CORNERS = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # of the print, from its top left, clockwise


class TagOutlines:
    """The corners of a fleet's tags in the image, from its robots' poses, by the camera's calibration."""

    def __init__(self, config: Config) -> None:
        self._geometry = CameraGeometry.from_model(config.camera.model)
        self._targets = {target.tag: target for target in robot_targets(config)}
        self._offsets = {robot.tag: robot.tag_offset for robot in config.seen}

    def of(self, poses: Iterable[TagPose]) -> dict[int, NDArray[np.float64]]:
        """Return the corners (4, 2) [px] of each tag of the fleet's, by its number."""
        tags = {
            pose.tag: tag_from_centre(pose.x_m, pose.y_m, pose.psi_rad, self._offsets[pose.tag])
            for pose in poses
            if pose.tag in self._targets
        }
        return corners_of(self._geometry, tags, self._targets)


def corners_of(
    geometry: CameraGeometry, poses: Mapping[int, tuple[float, float, float]], targets: Mapping[int, Target]
) -> dict[int, NDArray[np.float64]]:
    """Return the corners (4, 2) [px] of tags at poses x, y [m], psi [rad], by their numbers."""
    if not poses:
        return {}
    corners = np.concatenate([_corners(targets[tag], *pose) for tag, pose in poses.items()])
    return dict(zip(poses, geometry.project(corners).reshape(-1, 4, 2), strict=True))


def _corners(target: Target, x: float, y: float, psi: float) -> NDArray[np.float64]:
    """Return a tag's corners (4, 3) [m; world]."""
    right = np.array([np.cos(psi), np.sin(psi), 0.0])
    up = np.array([-np.sin(psi), np.cos(psi), 0.0])
    across, along = target.side * _CORNERS.T
    return np.array([x, y, target.height]) + np.outer(across, right) + np.outer(along, up)

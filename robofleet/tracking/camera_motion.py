"""Small motions of a camera, six parameters, and how they move its image.

They are the rotation about the optical centre [rad, about world x, y, z], the shift over the floor [m, along x, y], and
the logarithm of the focal length.
"""

import math

import cv2
import numpy as np

from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry

_CROSS_ARM_M = 0.01  # of the cross that stands for a tag's heading


def corrected(geometry: CameraGeometry, state: Array) -> CameraGeometry:
    """Return the camera turned, shifted and stretched by a state (6,)."""
    T, K = geometry.T_world_camera.copy(), geometry.K.copy()
    T[:3, :3] = cv2.Rodrigues(state[:3])[0] @ T[:3, :3]
    T[:2, 3] += state[3:5]
    K[[0, 1], [0, 1]] *= math.exp(state[5])
    return CameraGeometry(K, geometry.distortion, T, geometry.lens)


def sensitivity(geometry: CameraGeometry, points: Array) -> Array:
    """Return how far off tags at points (L, 3) are seen for a state, as a matrix (3 L, 6): x, y [m] and psi [rad]."""
    n, step = len(points), 1e-4
    cross = _crosses(points)
    columns = np.zeros((n, 3, 6))
    for k in range(6 if n else 0):
        seen = corrected(geometry, step * np.eye(6)[k]).project(cross.reshape(-1, 3))
        moved = geometry.to_plane(seen, np.repeat(points[:, 2], 4)).reshape(n, 4, 2) - cross[:, :, :2]
        columns[:, :, k] = _poses(moved[..., None])[..., 0] / step
    return columns.reshape(3 * n, 6)


def pose_covariance(geometry: CameraGeometry, points: Array, covariance: Array) -> Array:
    """Return the covariances (L, 3, 3) of x, y [m] and psi [rad] of tags at points (L, 3) by that of a state (6, 6).

    The focal length is taken for that of a lens without distortion.
    """
    cross = _crosses(points)
    ray = cross - geometry.position
    slope = ray[..., :2] / ray[..., 2:]
    moved = np.zeros((*cross.shape[:2], 2, 6))  # of where each point is seen, for each of the six
    for k, turn in enumerate(np.eye(3)):
        swing = np.cross(ray, turn)
        moved[..., k] = swing[..., :2] - slope * swing[..., 2:]
    moved[..., 0, 3] = moved[..., 1, 4] = -1.0
    axis = geometry.T_world_camera[:3, 2]
    outward = ray - (ray @ axis)[..., None] * axis
    moved[..., 5] = outward[..., :2] - slope * outward[..., 2:]
    rows = _poses(moved)
    spread: Array = rows @ covariance @ rows.transpose(0, 2, 1)
    return spread


def _crosses(points: Array) -> Array:
    """Return four points (L, 4, 3) around each."""
    cross: Array = points[:, None] + _CROSS_ARM_M * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    return cross


def _poses(moved: Array) -> Array:
    """Return how poses (L, 3, K) move whose crosses' points (L, 4, 2, K) do."""
    east, north = moved[:, 0] - moved[:, 2], moved[:, 1] - moved[:, 3]
    turned = (east[:, 1] - north[:, 0]) / (4.0 * _CROSS_ARM_M)
    return np.concatenate([moved.mean(1), turned[:, None]], axis=1)

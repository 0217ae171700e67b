"""A calibrated camera: pinhole with OpenCV's distortion k1 k2 p1 p2 k3.

Pixels are (u, v), u right and v down; integer coordinates are pixel centres, so that the image covers
[-0.5, W - 0.5] by [-0.5, H - 0.5]. Camera frame: x right, y down, z forward. World frame: z up, floor at 0.
"""

from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from robofleet.config.tree import CameraModel

Array = NDArray[np.float64]

# A step of the fixed-point iteration shrinks its error by about the distortion: 40 reach rounding.
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)


class CameraGeometry:
    """Where points of the world appear, and where a pixel's ray meets a plane z = height."""

    def __init__(self, K: ArrayLike, distortion: ArrayLike, T_world_camera: ArrayLike) -> None:
        """Take K (3, 3) [px], distortion (5,) and T_world_camera (4, 4), which maps camera to world."""
        self.K = np.array(K, dtype=np.float64)
        self.distortion = np.array(distortion, dtype=np.float64)
        self.T_world_camera = np.array(T_world_camera, dtype=np.float64)
        self._to_world = np.ascontiguousarray(self.T_world_camera[:3, :3])
        self._rotation = cv2.Rodrigues(self._to_world.T)[0]
        self._translation = -self._to_world.T @ self.position

    @classmethod
    def from_model(cls, model: CameraModel) -> Self:
        """Return the geometry of a calibrated camera of the configuration."""
        (f_x, f_y), (c_x, c_y) = model.focal_px, model.centre_px
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(np.array(model.T_world_camera.rotation_rad))[0]
        T[:3, 3] = model.T_world_camera.position_m
        return cls([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]], model.distortion, T)

    @property
    def position(self) -> Array:
        """Optical centre (3,) [m; world]."""
        return self.T_world_camera[:3, 3]

    def project(self, points_world: Array) -> Array:
        """Return the pixels (N, 2) where points (N, 3) [m; world] in front of the camera appear."""
        pixels, _ = cv2.projectPoints(points_world, self._rotation, self._translation, self.K, self.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def to_plane(self, pixels: Array, height_m: float) -> Array:
        """Return x, y (N, 2) [m; world] where the rays of pixels (N, 2) meet the plane z = height_m."""
        slopes = cv2.undistortPointsIter(  # x/z and y/z of the rays, turned into the world frame
            pixels.reshape(-1, 1, 2), self.K, self.distortion, self._to_world, np.eye(3), _UNDISTORT
        )
        x_y: Array = np.asarray(slopes, np.float64).reshape(-1, 2) * (height_m - self.position[2])
        return x_y + self.position[:2]

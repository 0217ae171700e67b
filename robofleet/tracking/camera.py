"""A calibrated camera: pinhole with OpenCV's distortion models, or fisheye.

Pixels are (u, v), u right and v down; integer coordinates are pixel centres, so that the image covers
[-0.5, W - 0.5] by [-0.5, H - 0.5]. Camera frame: x right, y down, z forward. World frame: z up, floor at 0.
"""

from typing import Literal, Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Array
from robofleet.tracking.projection import flat

Lens = Literal["pinhole", "fisheye"]

# A step of the fixed-point iteration shrinks its error by about the distortion: 40 reach rounding.
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
_SAME_M = 0.01


class CameraGeometry:
    """Where points of the world appear, and where a pixel's ray meets a plane z = height."""

    def __init__(self, K: ArrayLike, distortion: ArrayLike, T_world_camera: ArrayLike, lens: Lens = "pinhole") -> None:
        """Take K (3, 3) [px], OpenCV's distortion of that lens, and T_world_camera (4, 4), camera to world."""
        self.K = np.array(K, dtype=np.float64)
        self.distortion = np.array(distortion, dtype=np.float64)
        self.T_world_camera = np.array(T_world_camera, dtype=np.float64)
        self.lens: Lens = lens
        self._to_world = np.ascontiguousarray(self.T_world_camera[:3, :3])
        self._rotation = cv2.Rodrigues(self._to_world.T)[0]
        self._translation = -self._to_world.T @ self.position
        self.flat = flat(lens, self.K, self.distortion, self._to_world.T, self._translation)  # for kernels

    @classmethod
    def from_model(cls, model: CameraModel) -> Self:
        """Return the geometry of a calibrated camera of the configuration; ValueError if its place is not known."""
        if model.T_world_camera is None:
            raise ValueError("the camera's model has no T_world_camera")
        (f_x, f_y), (c_x, c_y) = model.focal_px, model.centre_px
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(np.array(model.T_world_camera.rotation_rad))[0]
        T[:3, 3] = model.T_world_camera.position_m
        return cls([[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]], model.distortion, T, model.lens)

    def moved(self, T_world_camera: ArrayLike) -> "CameraGeometry":
        return CameraGeometry(self.K, self.distortion, T_world_camera, self.lens)

    @property
    def position(self) -> Array:
        """Optical centre (3,) [m; world]."""
        return self.T_world_camera[:3, 3]

    def project(self, points_world: Array) -> Array:
        """Return the pixels (N, 2) where points (N, 3) [m; world] in front of the camera appear."""
        project = cv2.fisheye.projectPoints if self.lens == "fisheye" else cv2.projectPoints
        points = points_world.reshape(-1, 1, 3)
        pixels, _ = project(points, self._rotation, self._translation, self.K, self.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def sees(self, points_world: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
        """Return which points (N, 3) [m; world] appear in an image of a size (width, height) [px].

        Far outside its image a lens's coefficients mean nothing, and may bring a pixel back into it.
        """
        pixels = self.project(points_world)
        inside: NDArray[np.bool_] = np.all(np.abs(pixels / (np.array(size) - 1.0) - 0.5) <= 0.5, axis=1)
        if inside.any():
            back = self.to_plane(pixels[inside], points_world[inside, 2])
            inside[inside] = np.abs(back - points_world[inside, :2]).max(axis=1) < _SAME_M
        return inside

    def to_plane(self, pixels: Array, height_m: float | Array) -> Array:
        """Return x, y (N, 2) [m; world] where the rays of pixels (N, 2) meet z = height_m, one for all or (N,)."""
        slopes = self._slopes(pixels.reshape(-1, 1, 2))
        x_y: Array = slopes * (np.asarray(height_m).reshape(-1, 1) - self.position[2])
        return x_y + self.position[:2]

    def _slopes(self, pixels: Array) -> Array:
        """Return x/z and y/z of the rays (N, 2), turned into the world frame."""
        undistort = cv2.fisheye.undistortPoints if self.lens == "fisheye" else cv2.undistortPointsIter
        slopes = undistort(pixels, self.K, self.distortion, R=self._to_world, P=np.eye(3), criteria=_UNDISTORT)
        return np.asarray(slopes, np.float64).reshape(-1, 2)

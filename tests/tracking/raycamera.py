"""The ray-cast frames' own camera model: lens, place and shutter, written from the definitions and not through OpenCV.

Integer pixel coordinates are pixel centres; world z up; camera x right, y down, z forward. A rolling shutter exposes
rows one after the other; times count from the middle row's, (H - 1) / 2.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RayCamera:
    """A calibrated camera: OpenCV's pinhole distortion of 0 to 14 coefficients, or fisheye with 4."""

    size: tuple[int, int]  # width, height [px]
    K: Array  # (3, 3) [px]
    distortion: Array
    T_world_camera: Array  # (4, 4), camera to world
    fisheye: bool = False
    exposure: float = 0.0  # of a row [s]
    line_time: float = 0.0  # from a row to the next [s]
    lens_sigma_px: float = 0.7  # of the Gaussian that a point of light makes, by diffraction and aberrations
    defocus: float = 0.0  # radius of the disc that each point of it becomes out of focus [px]

    def project(self, points_world: Array) -> Array:
        """Return the pixels (N, 2) of points (N, 3) [m]."""
        in_camera = (points_world - self.T_world_camera[:3, 3]) @ self.T_world_camera[:3, :3]
        ray = in_camera[:, :2] / in_camera[:, 2:]
        if self.fisheye:
            r = np.hypot(*ray.T)[:, None]
            distorted = ray * _fisheye(np.arctan(r), self.distortion)[0] / np.maximum(r, 1e-12)
        else:
            distorted = np.stack(_pinhole(ray[:, 0], ray[:, 1], self.distortion), axis=1)
        return distorted * np.diag(self.K)[:2] + self.K[:2, 2]

    def on_plane(self, pixels: Array, height: float | Array) -> Array:
        """Return x, y (N, 2) [m] where the rays of pixels (N, 2) meet z = height, or each its own (N,)."""
        distorted = (pixels - self.K[:2, 2]) / np.diag(self.K)[:2]
        undo = _fisheye_ray if self.fisheye else _pinhole_ray
        ray = np.column_stack([undo(distorted, self.distortion), np.ones(len(pixels))]) @ self.T_world_camera[:3, :3].T
        eye = self.T_world_camera[:3, 3]
        return eye[:2] + ray[:, :2] * ((np.reshape(height, (-1, 1)) - eye[2]) / ray[:, 2:])

    def row_time(self, v: Array) -> Array:
        """Return when rows ``v`` are in mid-exposure [s]."""
        return (v - (self.size[1] - 1) / 2.0) * self.line_time


def _pinhole(x: NDArray[Any], y: NDArray[Any], distortion: Array) -> tuple[NDArray[Any], NDArray[Any]]:
    """Distort rays x/z, y/z, real or complex, as OpenCV's documentation defines it."""
    none = [0.0] * (14 - len(distortion))
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = [*distortion.tolist(), *none]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    a = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2)
    b = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4)
    cx, sx, cy, sy = math.cos(tilt_x), math.sin(tilt_x), math.cos(tilt_y), math.sin(tilt_y)
    R = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]]) @ [[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]]
    T = np.array([[R[2, 2], 0.0, -R[0, 2]], [0.0, R[2, 2], -R[1, 2]], [0.0, 0.0, 1.0]]) @ R
    z = T[2, 0] * a + T[2, 1] * b + T[2, 2]
    return (T[0, 0] * a + T[0, 1] * b + T[0, 2]) / z, (T[1, 0] * a + T[1, 1] * b + T[1, 2]) / z


def _pinhole_ray(distorted: Array, distortion: Array) -> Array:
    """Undo :func:`_pinhole` (N, 2) by Newton's method; the derivatives are those of a complex step, exact."""
    x, y = distorted.T
    for _ in range(20):
        a, b = _pinhole(x, y, distortion)
        miss_a, miss_b = a - distorted[:, 0], b - distorted[:, 1]
        if max(np.abs(miss_a).max(), np.abs(miss_b).max()) < 1e-13:
            break
        by_x, by_y = _pinhole(x + 1e-30j, y, distortion), _pinhole(x, y + 1e-30j, distortion)
        j = [[part.imag / 1e-30 for part in parts] for parts in (by_x, by_y)]
        det = j[0][0] * j[1][1] - j[1][0] * j[0][1]
        x, y = x - (j[1][1] * miss_a - j[1][0] * miss_b) / det, y - (j[0][0] * miss_b - j[0][1] * miss_a) / det
    return np.stack([x, y], axis=1)


def _fisheye(theta: Array, distortion: Array) -> tuple[Array, Array]:
    """Return the distorted angle and its derivative."""
    k1, k2, k3, k4 = distortion
    odd = np.polynomial.Polynomial([0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3, 0.0, k4])
    return odd(theta), odd.deriv()(theta)


def _fisheye_ray(distorted: Array, distortion: Array) -> Array:
    """Return x/z, y/z (N, 2) of distorted rays (N, 2), by Newton's method on the angle."""
    r = np.hypot(*distorted.T)[:, None]
    theta = r.copy()
    for _ in range(20):
        angle, slope = _fisheye(theta, distortion)
        theta -= (angle - r) / slope
    return distorted * np.tan(theta) / np.maximum(r, 1e-12)

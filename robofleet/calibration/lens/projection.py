"""A lens as values to estimate: where it shows points, and how that changes with every value."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from robofleet.calibration.lens.board import BoardView
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.camera import Lens as Kind

_PINHOLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x_rad", "tau_y_rad")
_FISHEYE = ("k1", "k2", "k3", "k4")


@dataclass(frozen=True)
class Lens:
    """A lens; ``values`` (P,): f_x, f_y, c_x, c_y [px], then OpenCV's distortion."""

    kind: Kind
    size: tuple[int, int]  # width, height [px]
    values: Array

    @property
    def names(self) -> tuple[str, ...]:
        coefficients = _FISHEYE if self.kind == "fisheye" else _PINHOLE
        return ("f_x_px", "f_y_px", "c_x_px", "c_y_px", *coefficients[: len(self.values) - 4])

    @cached_property
    def geometry(self) -> CameraGeometry:
        """Return the lens as a camera whose frame is the world's."""
        f_x, f_y, c_x, c_y = self.values[:4]
        K = [[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]]
        return CameraGeometry(K, self.values[4:], np.eye(4), self.kind)

    def project(self, points: Array, pose: Array) -> tuple[Array, Array, Array]:
        """Return pixels (N, 2) of points (N, 3) under a pose (6,), and their derivatives.

        These are (N, 2, P) by the lens and (N, 2, 6) by the pose.
        """
        K, count = self.geometry.K, len(self.values)
        project = cv2.fisheye.projectPoints if self.kind == "fisheye" else cv2.projectPoints
        projected, derivatives = project(points.reshape(-1, 1, 3), pose[:3], pose[3:], K, self.values[4:])
        pixels = np.asarray(projected, np.float64).reshape(-1, 2)
        jacobian = np.asarray(derivatives, np.float64).reshape(len(points), 2, -1)
        if self.kind == "fisheye":  # f, c, distortion, rotation, translation, skew
            return pixels, jacobian[..., :count], jacobian[..., count : count + 6]
        return pixels, jacobian[..., 6 : 6 + count], jacobian[..., :6]

    def slopes(self, pixels: Array) -> Array:
        """Return x/z and y/z of pixels' rays (N, 2); NaN where the lens folds and no ray leads."""
        geometry = self.geometry
        slopes = geometry.to_plane(pixels, 1.0)
        again = geometry.project(np.column_stack([slopes, np.ones(len(slopes))]))
        slopes[~(np.abs(again - pixels).max(axis=1) < 0.01)] = np.nan
        return slopes

    def pose(self, view: BoardView) -> Array:
        """Return the pose (6,) of a view: of the two that a plane leaves, the one that fits better."""
        slopes = self.slopes(view.pixels)
        seen = np.asarray(np.isfinite(slopes).all(axis=1))
        if seen.sum() < 4:
            slopes, seen = (view.pixels - self.values[2:4]) / self.values[:2], np.ones(len(seen), np.bool_)
        plane = cv2.SOLVEPNP_IPPE
        _, turns, shifts, _ = cv2.solvePnPGeneric(view.points[seen], slopes[seen], np.eye(3), None, flags=plane)
        found = (np.concatenate([r.ravel(), t.ravel()]) for r, t in zip(turns, shifts, strict=True))
        poses = [self._refined(view, pose) for pose in found]
        return min(poses, key=lambda pose: cost(self.project(view.points, pose)[0] - view.pixels))

    def _refined(self, view: BoardView, pose: Array) -> Array:
        for _ in range(4):
            pixels, _, J = self.project(view.points, pose)
            pose = pose + np.linalg.lstsq(J.reshape(-1, 6), (view.pixels - pixels).ravel(), rcond=None)[0]
        return pose


def cost(residuals: Array) -> float:
    """Return the sum of squares; infinite where the lens folded."""
    total = float((residuals * residuals).sum())
    return total if np.isfinite(total) else np.inf

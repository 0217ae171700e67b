"""A projector is a camera whose light goes the other way: the pixel at which a camera in its place would see a point
of the floor is the pixel that lights it.

A floor alone tells a projector's homography and distortion, not its place and focal length one by one. ``VALUES`` are
small changes of a projector that include both; their covariance is wide where the floor does not tell, and these
directions leave the floor's errors as they are.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.config.calibrated import PoseSettings
from robofleet.config.projectors import ProjectorModel, ProjectorOptics
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry

# What ``changed`` takes: a turn about the world's axes, a shift, the logarithm of the focal length, and additions.
VALUES = (
    "turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_m", "shift_y_m", "shift_z_m",
    "log_focal", "centre_x_px", "centre_y_px", "k1", "k2", "p1", "p2",
)  # fmt: skip
_STEP = 1e-6  # of numerical derivatives, of what is about 1
_SCALES = np.array([1.0] * 7 + [1e3] * 2 + [1.0] * 4)


@dataclass(frozen=True)
class Projector:
    """Where a projector's light falls."""

    geometry: CameraGeometry  # of a camera in its place
    size: tuple[int, int]  # of its picture: width, height [px]
    covariance: Array = field(default_factory=lambda: np.zeros((len(VALUES), len(VALUES))))  # of VALUES

    @classmethod
    def from_model(cls, model: ProjectorOptics) -> "Projector":
        (f_x, f_y), (c_x, c_y) = model.focal_px, model.centre_px
        K = [[f_x, 0.0, c_x], [0.0, f_y, c_y], [0.0, 0.0, 1.0]]
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(np.array(model.T_world_projector.rotation_rad))[0]
        T[:3, 3] = model.T_world_projector.position_m
        geometry, size = CameraGeometry(K, model.distortion, T), (model.width, model.height)
        if not isinstance(model, ProjectorModel) or model.calibrated is None or not model.calibrated.covariance:
            return cls(geometry, size)
        return cls(geometry, size, np.array(model.calibrated.covariance))

    @property
    def model(self) -> ProjectorOptics:
        """The projector as a configuration has it."""
        K, T = self.geometry.K, self.geometry.T_world_camera
        x, y, z = T[:3, 3].tolist()
        a, b, c = cv2.Rodrigues(T[:3, :3])[0].ravel().tolist()
        k1, k2, p1, p2 = self.geometry.distortion.tolist()
        return ProjectorOptics(
            width=self.size[0], height=self.size[1],
            focal_px=(float(K[0, 0]), float(K[1, 1])), centre_px=(float(K[0, 2]), float(K[1, 2])),
            distortion=(k1, k2, p1, p2), T_world_projector=PoseSettings(position_m=(x, y, z), rotation_rad=(a, b, c)),
        )  # fmt: skip

    def changed(self, change: Array) -> "Projector":
        """Return a projector that differs by VALUES (13,).

        It turns about the point of the floor at which it looks. With its focal length its distance from there grows,
        and with its principal point it goes aside: so the floor notices little of these, and a fit finds them soon.
        """
        old, K, T = self.geometry, self.geometry.K.copy(), self.geometry.T_world_camera.copy()
        axis = T[:3, 2]
        away = T[2, 3] / -axis[2] * axis  # from the projector to the floor
        R = cv2.Rodrigues(change[:3])[0]
        zoom = np.exp(change[6])
        aside = np.append(change[7:9] / (zoom * np.diag(K)[:2]), 0.0) * np.linalg.norm(away)
        T[:3, :3] = R @ T[:3, :3]
        T[:3, 3] += away - zoom * (R @ away - T[:3, :3] @ aside) + change[3:6]
        K[0, 0], K[1, 1] = zoom * K[[0, 1], [0, 1]]
        K[:2, 2] += change[7:9]
        return Projector(CameraGeometry(K, old.distortion + change[9:], T, old.lens), self.size, self.covariance)

    def pixels(self, points: Array) -> Array:
        """Return the pixels (N, 2) that light points (N, 3) [m; world]; NaN where none of the picture does.

        Far outside the picture a lens's coefficients mean nothing, and may bring a pixel back into it.
        """
        pixels = np.full((len(points), 2), np.nan)
        below = (points - self.geometry.position) @ self.geometry.T_world_camera[:3, :3]
        front: NDArray[np.bool_] = np.asarray(below[:, 2] > 0.0)
        straight = below[front, :2] / below[front, 2:] * np.diag(self.geometry.K)[:2] + self.geometry.K[:2, 2]
        front[front] = np.abs(straight / self.size - 0.5).max(axis=1) < 1.0
        if front.any():
            bent = self.geometry.project(points[front])
            inside = np.abs((bent + 0.5) / self.size - 0.5).max(axis=1) <= 0.5
            pixels[front] = np.where(inside[:, None], bent, np.nan)
        return pixels

    def lights(self, points: Array) -> NDArray[np.bool_]:
        """Return which points (N, 3) [m; world] its picture lights."""
        return np.isfinite(self.pixels(points)[:, 0])

    def floor(self, pixels: Array) -> Array:
        """Return where pixels (N, 2) light the floor, x and y (N, 2) [m; world]."""
        return self.geometry.to_plane(pixels, 0.0)

    def derivatives(self, pixels: Array) -> Array:
        """Return how the places on the floor that pixels light change with VALUES (N, 2, 13)."""
        steps = _STEP * np.diag(_SCALES)
        moved = [self.changed(step).floor(pixels) - self.changed(-step).floor(pixels) for step in steps]
        return np.stack(moved, axis=2) / (2.0 * _STEP * _SCALES)

    def spread(self, points: Array) -> Array:
        """Return the covariances (N, 2, 2) [m^2] with which points (N, 3) of the floor are lit; NaN: not lit."""
        pixels = self.pixels(points)
        lit = np.isfinite(pixels[:, 0])
        spread = np.full((len(points), 2, 2), np.nan)
        J = self.derivatives(pixels[lit])
        spread[lit] = J @ self.covariance @ J.transpose(0, 2, 1)
        return spread

    @cached_property
    def corners(self) -> Array:
        """Where the picture's corners light the floor (4, 2) [m; world], from the upper left one clockwise."""
        w, h = self.size
        return self.floor(np.array([[0.0, 0.0], [w - 1.0, 0.0], [w - 1.0, h - 1.0], [0.0, h - 1.0]]))


RAMP_M = 0.3  # over which one projector's light gives way to another's
GAMMA = 2.2  # of projectors: their light grows with this power of a grey level
_COARSE = 8  # pixels between those whose weights are computed; the others' are interpolated
_LEAST = 1e-3  # weight at a picture's very edge: also there light comes from somewhere


def gray_shares(projectors: Mapping[str, Projector], name: str) -> Array:
    """Return the share (H, W) of its grey that each pixel of a projector shows, so that where several light the floor
    it is as bright as where one does.

    Their shares of the light (to the power GAMMA) sum to one. Towards its picture's edge a projector's falls to
    nothing, smoothly over ``RAMP_M`` of floor, where another takes over.
    """
    own = projectors[name]
    width, height = own.size
    across, down = -(-width // _COARSE) + 1, -(-height // _COARSE) + 1
    u, v = np.meshgrid(np.linspace(0.0, width - 1.0, across), np.linspace(0.0, height - 1.0, down))
    floor = own.floor(np.column_stack([u.ravel(), v.ravel()]))
    columns = np.linspace(0.0, across - 1.0, width, dtype=np.float32)
    rows = np.linspace(0.0, down - 1.0, height, dtype=np.float32)
    x, y = np.meshgrid(columns, rows)
    weights = {
        each: cv2.remap(_weight(projector, floor).reshape(down, across), x, y, cv2.INTER_LINEAR)
        for each, projector in projectors.items()
    }
    light = weights[name] / np.maximum(np.sum([*weights.values()], axis=0), _LEAST)
    return np.asarray(light ** (1.0 / GAMMA), np.float64)


def _weight(projector: Projector, floor: Array) -> Array:
    """Return how far places (N, 2) lie inside a picture, in [0, 1]: 1 from ``RAMP_M`` on, 0 where it lights none."""
    pixels = projector.pixels(np.column_stack([floor, np.zeros(len(floor))]))
    last = np.array(projector.size) - 1.0
    left, top, right, bottom = np.linalg.norm(projector.corners - np.roll(projector.corners, 1, axis=0), axis=1)
    px_per_m = last / [(top + bottom) / 2.0, (left + right) / 2.0]
    inside = (np.minimum(pixels, last - pixels) / px_per_m).min(axis=1)
    t = np.clip(inside / RAMP_M, 0.0, 1.0)
    weight = _LEAST + (1.0 - _LEAST) * t * t * (3.0 - 2.0 * t)
    return np.asarray(np.nan_to_num(weight, nan=0.0), np.float64)

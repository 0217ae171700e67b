"""A projector for tests: tilted by 5 degrees, with a lens, over the shipped arena."""

import cv2
import numpy as np

from robofleet.projection.model import Projector
from robofleet.tracking.camera import CameraGeometry

SIZE = 960, 540


def tilted(x: float = 0.0, degrees: float = 5.0, k1: float = -0.03, height_m: float = 3.1) -> Projector:
    T = np.eye(4)
    turn = np.radians([degrees, 1.0, 0.7])
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(turn)[0]
    T[:3, 3] = x, -0.1, height_m
    K = [[750.0, 0.0, 482.0], [0.0, 750.0, 265.0], [0.0, 0.0, 1.0]]
    return Projector(CameraGeometry(K, [k1, 0.01, 5e-4, -4e-4], T), SIZE)


def on_floor(x_y: np.ndarray) -> np.ndarray:
    return np.column_stack([x_y, np.zeros(len(x_y))])


def pixels(columns: int = 15, rows: int = 8) -> np.ndarray:
    """Pixels (N, 2) all over the picture."""
    u, v = np.meshgrid(np.linspace(20.0, SIZE[0] - 21.0, columns), np.linspace(20.0, SIZE[1] - 21.0, rows))
    return np.column_stack([u.ravel(), v.ravel()])

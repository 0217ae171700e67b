"""``CameraGeometry.project`` inside kernels: where one point appears, by the same models as OpenCV's.

A camera is one row of numbers here; ``flat`` makes it.
"""

import math

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.kernels import infinite_kernel

_PINHOLE, _FISHEYE = 0.0, 1.0
_COEFFICIENTS = 14
_AXIS = 1e-8  # slope of a ray so near the axis that a fisheye does not bend it


def flat(lens: str, K: Array, distortion: Array, rotation: Array, translation: Array) -> Array:
    """Return a camera (40,): model, focal lengths and centre [px], world to camera, distortion, tilt."""
    coefficients = np.zeros(_COEFFICIENTS)
    coefficients[: distortion.size] = distortion.ravel()
    model = _FISHEYE if lens == "fisheye" else _PINHOLE
    middle = [model, K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    parts = middle, rotation.ravel(), translation.ravel(), coefficients, _tilt(*coefficients[12:]).ravel()
    return np.concatenate(parts)


def _tilt(x: float, y: float) -> Array:
    """Return the homography (3, 3) of a sensor that is tilted about x and y [rad]."""
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(x), math.sin(x)], [0.0, -math.sin(x), math.cos(x)]])
    about_y = np.array([[math.cos(y), 0.0, -math.sin(y)], [0.0, 1.0, 0.0], [math.sin(y), 0.0, math.cos(y)]])
    turn = about_y @ about_x
    level = np.array([[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]])
    return np.asarray(level @ turn, np.float64)


@infinite_kernel
def project(camera: Array, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the pixel u, v where a point [m; world] in front of a camera appears."""
    turn, shift, k, tilt = camera[5:14], camera[14:17], camera[17:31], camera[31:40]
    depth = turn[6] * x + turn[7] * y + turn[8] * z + shift[2]
    depth = depth if depth != 0.0 else 1.0  # as OpenCV has it
    a = (turn[0] * x + turn[1] * y + turn[2] * z + shift[0]) / depth
    b = (turn[3] * x + turn[4] * y + turn[5] * z + shift[1]) / depth
    square = a * a + b * b
    if camera[0] == _FISHEYE:
        slope = math.sqrt(square)
        angle = math.atan(slope)
        q = angle * angle
        bent = angle * (1.0 + q * (k[0] + q * (k[1] + q * (k[2] + q * k[3]))))
        scale = bent / slope if slope > _AXIS else 1.0
        a, b = scale * a, scale * b
    else:
        radial = 1.0 + square * (k[0] + square * (k[1] + square * k[4]))
        radial /= 1.0 + square * (k[5] + square * (k[6] + square * k[7]))
        right = a * radial + 2.0 * k[2] * a * b + k[3] * (square + 2.0 * a * a) + square * (k[8] + square * k[9])
        down = b * radial + k[2] * (square + 2.0 * b * b) + 2.0 * k[3] * a * b + square * (k[10] + square * k[11])
        if k[12] != 0.0 or k[13] != 0.0:
            far = tilt[6] * right + tilt[7] * down + tilt[8]
            a = (tilt[0] * right + tilt[1] * down + tilt[2]) / far
            b = (tilt[3] * right + tilt[4] * down + tilt[5]) / far
        else:
            a, b = right, down
    return camera[1] * a + camera[3], camera[2] * b + camera[4]

"""A projector from where its pixels are seen on the floor: a homography, then a bundle with the lens.

What cameras see of one pixel differs from where its light is by noise, each time anew, and by the errors of that
camera's own pose, which all that it sees have in common. The bundle (``scipy.optimize.least_squares``) estimates the
latter beside the projector: several cameras correct each other, and what one alone cannot know stays in the
covariance. Priors hold what a floor does not tell near what projectors have.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from robofleet.core.arrays import Array
from robofleet.core.errors import BadInputError
from robofleet.projection.model import VALUES, Projector
from robofleet.tracking.camera import CameraGeometry

_THROW = 1.6  # focal length of a usual projector [widths]
# Standard deviations of what projectors have: turn [rad], shift [m], logarithm of the focal length, principal point
# [widths; heights, by which lenses are shifted], k1, k2, p1, p2.
_TURN, _SHIFT, _FOCAL, _ACROSS, _DOWN = 1.0, 1.0, 0.4, 0.1, 0.6
_DISTORTION = 0.2, 0.2, 0.005, 0.005
LEAST = 12  # tags
_NEAR_M = 0.02  # of a homography, which knows no lens
_OUTLIER = 5.0  # standard deviations
_ROUNDS = 4


class FitError(BadInputError):
    """Raised where what was seen does not tell a projector; the message says how to mend it."""


class Seen(NamedTuple):
    """Pixels of a projector as one camera sees them on the floor."""

    pixels: Array  # (N, 2) of the projector
    floor: Array  # (N, 2) where their light seems to be [m; world]
    covariance: Array  # (N, 2, 2) of each by itself, but for a factor that all have in common [m^2]
    by_camera: Array  # (N, 2, K) how they move with K errors of the camera, each of standard deviation 1 [m]


class Fit(NamedTuple):
    """A projector fitted to what cameras saw."""

    projector: Projector
    error: Array  # (N, 2) of all that was seen, from where the projector lights [m]
    used: NDArray[np.bool_]  # (N,)
    noise: float  # errors, over what their covariance says; the projector's covariance counts it


def fit(seen: Sequence[Seen], size: tuple[int, int]) -> Fit:
    """Fit a projector with a picture of a size (width, height) [px] to what each camera saw.

    Raises:
        FitError: They do not tell it.
    """
    pixels, floor = (np.concatenate([getattr(own, name) for own in seen]) for name in ("pixels", "floor"))
    if len(pixels) < LEAST:
        raise FitError(f"{len(pixels)} tags of the pattern were read, {LEAST} are needed")
    used = _near_homography(pixels, floor)
    if np.count_nonzero(used) < LEAST:
        raise FitError("the tags that were read form no plane picture: clear the floor, or calibrate the cameras again")
    start = _start(pixels[used], floor[used], size)
    whiten = np.linalg.inv(np.linalg.cholesky(np.concatenate([own.covariance for own in seen])))
    bundle = _Bundle(start, pixels, floor, whiten, _by_cameras(seen))
    noise, change = 1.0, np.zeros(bundle.count)
    for _ in range(_ROUNDS):
        change = bundle.solved(used, noise, change)
        distance = np.linalg.norm(bundle.residuals(change), axis=1)
        noise = float(np.median(distance[used])) / _MEDIAN
        inside = distance < _OUTLIER * noise
        if (inside == used).all():
            break
        used = inside
    freedom = 2 * int(used.sum()) - _TOLD
    noise = math.sqrt(float((distance[used] ** 2).sum()) / freedom)
    change = bundle.solved(used, noise, change)
    projector = bundle.projector(change)
    projector = replace(projector, covariance=bundle.covariance(projector, used, noise))
    return Fit(projector, bundle.errors(change), used, noise)


_MEDIAN = math.sqrt(2.0 * math.log(2.0))  # of the length of two standard normal draws
_TOLD = 12  # numbers that a floor tells of a projector: a homography's 8 and the distortion's 4


def _near_homography(pixels: Array, floor: Array) -> NDArray[np.bool_]:
    _, near = cv2.findHomography(pixels, floor, cv2.RANSAC, _NEAR_M, maxIters=5000, confidence=0.9999)
    return np.zeros(len(pixels), np.bool_) if near is None else near.ravel() > 0


def _start(pixels: Array, floor: Array, size: tuple[int, int]) -> Projector:
    """Return the projector without distortion, of a usual focal length, that lights a plane so."""
    focal, middle = _THROW * size[0], (np.array(size) - 1.0) / 2.0
    K = np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
    points = np.column_stack([floor, np.zeros(len(floor))])
    _, turns, shifts, errors = cv2.solvePnPGeneric(points, pixels, K, None, flags=cv2.SOLVEPNP_IPPE)
    for turn, shift, _ in sorted(zip(turns, shifts, np.ravel(errors), strict=True), key=lambda found: found[2]):
        T = np.eye(4)
        T[:3, :3] = cv2.Rodrigues(turn)[0].T
        T[:3, 3] = -T[:3, :3] @ shift.ravel()
        if T[2, 3] > 0.0:
            return Projector(CameraGeometry(K, np.zeros(4), T), size)
    raise FitError("the picture is mirrored on the floor: switch the projector's mirroring off")


def _by_cameras(seen: Sequence[Seen]) -> Array:
    """Return how all that was seen moves with the errors of all cameras (N, 2, sum of K)."""
    ends = np.cumsum([own.by_camera.shape[2] for own in seen])
    parts = [np.zeros((len(own.pixels), 2, ends[-1])) for own in seen]
    for own, part, end in zip(seen, parts, ends, strict=True):
        part[:, :, end - own.by_camera.shape[2] : end] = own.by_camera
    return np.concatenate(parts)


class _Bundle:
    """Least squares over VALUES and the cameras' errors."""

    def __init__(self, start: Projector, pixels: Array, floor: Array, whiten: Array, by_cameras: Array) -> None:
        self._start, self._pixels, self._floor = start, pixels, floor
        self._whiten, self._by_cameras = whiten, by_cameras
        width, height = start.size
        values = [_TURN] * 3 + [_SHIFT] * 3 + [_FOCAL, _ACROSS * width, _DOWN * height, *_DISTORTION]
        self._sigma = np.array(values + [1.0] * by_cameras.shape[2])
        self.count = len(self._sigma)

    def projector(self, change: Array) -> Projector:
        return self._start.changed(change[: len(VALUES)])

    def errors(self, change: Array) -> Array:
        """Return what was seen from where the projector lights (N, 2) [m]."""
        lit = self.projector(change).floor(self._pixels)
        return np.asarray(self._floor - self._by_cameras @ change[len(VALUES) :] - lit, np.float64)

    def residuals(self, change: Array) -> Array:
        """Return the errors (N, 2) in standard deviations."""
        return np.asarray(np.einsum("nij,nj->ni", self._whiten, self.errors(change)), np.float64)

    def solved(self, used: NDArray[np.bool_], noise: float, near: Array) -> Array:
        """Return the best change ``near`` one, where errors are ``noise`` times those stated."""

        def whole(scaled: Array) -> Array:
            return np.concatenate([self.residuals(self._sigma * scaled)[used].ravel() / noise, scaled])

        best = least_squares(whole, near / self._sigma, jac="3-point", xtol=1e-8, ftol=1e-8)
        return np.asarray(self._sigma * best.x, np.float64)

    def covariance(self, projector: Projector, used: NDArray[np.bool_], noise: float) -> Array:
        """Return the covariance (13, 13) of a solution's VALUES: of changes from there, not from the start."""
        moves = np.concatenate([projector.derivatives(self._pixels[used]), self._by_cameras[used]], axis=2)
        J = (self._whiten[used] @ moves * self._sigma / noise).reshape(-1, self.count)
        information = J.T @ J + np.eye(self.count)
        covariance = np.linalg.inv(information) * np.outer(self._sigma, self._sigma)
        return np.asarray(covariance[: len(VALUES), : len(VALUES)], np.float64)

"""Where a camera is above the plane on which tags move, by what the tags look like.

All tags have one known side and lie on one plane. So each tag that is seen tells the scale at its place, and how it is
foreshortened. Plane, and as far as the lens is not calibrated its focal length, distortion and centre, are fitted to
them, with priors: what the images do not tell stays what a usual camera has.

A tag's corners are carried onto the plane; what is left of the best square of its side there is its residual. Units of
the fit are pixels. World frame: origin on the plane in the image's middle, x to the image's right there, z up.
"""

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from robofleet.config.calibrated import CameraModel
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry, Lens
from robofleet.tracking.sources import CameraError
from robofleet.tracking.tags.detection import CORNERS

USUAL_FOV_DEG = 65.0  # horizontal: webcams 60 to 78, telephones 63 to 72
# Standard deviations of what a camera has: logarithm of the focal length, where it is assumed or was named; principal
# point [widths], k1 and k2.
_FOCAL, _FOCAL_NAMED, _CENTRE, _K1, _K2 = 0.2, 0.02, 0.01, 0.15, 0.05
_FLATTEST = 0.2  # cosine of the largest angle of the optical axis from the plane's normal
_STARTS = (0.0, -0.7, 0.7)  # tilts from which it is sought [rad],
_STEPS, _FIRST_STEPS, _FIRST_TAGS = 30, 8, 24  # by some of the tags at first
_ROBUST = 2.5  # a residual so many typical ones large counts as this one
_LEAST_PX = 0.02  # noise of a corner that nothing betters
_APART = 0.5  # a tag that moved less tells nothing new [sides]
_STEP = 1e-5  # of numerical derivatives
_BEYOND = 1e3  # residual of a tag that a guess does not see [px]


@dataclass(frozen=True, kw_only=True)
class PlacedCamera:
    """A camera whose place is known.

    Attributes:
        geometry: The camera.
        size: Width and height of its images [px].
        line_time_s: From a row's exposure to the next one's [s]; 0: all at once.
        lens_calibrated: The lens was measured. Else it is what the tags tell, and what is usual.
        place_calibrated: The place was measured, in a frame of the laboratory. Else it was found above the tags' plane.
        edge_error_m: Standard deviation of a position at the image's edge, by what is not known of lens and plane [m];
            0: all was measured.
        fov_deg: Horizontal field of view, without distortion [deg].
    """

    geometry: CameraGeometry
    size: tuple[int, int]
    fov_deg: float
    line_time_s: float = 0.0
    lens_calibrated: bool = True
    place_calibrated: bool = True
    edge_error_m: float = 0.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the vertical [deg]."""
        return math.degrees(math.acos(min(1.0, -self.geometry.T_world_camera[2, 2])))

    @property
    def height_m(self) -> float:
        """Height of the camera above the floor [m]."""
        return float(self.geometry.position[2])


class SeenTags:
    """The corners of tags, wherever they tell something new."""

    def __init__(self) -> None:
        self._last: dict[int, Array] = {}
        self._corners: list[Array] = []

    def __len__(self) -> int:
        return len(self._corners)

    def add(self, tag: int, corners: Array) -> None:
        """Take corners (4, 2), clockwise from the print's top left [px]."""
        centre, side = corners.mean(0), float(np.linalg.norm(corners[1] - corners[0]))
        if tag not in self._last or np.linalg.norm(centre - self._last[tag]) > _APART * side:
            self._last[tag] = centre
            self._corners.append(corners)

    @property
    def corners(self) -> Array:
        """(M, 4, 2) [px]."""
        return np.array(self._corners)


def placed(
    seen: Array, side_m: float, height_m: float, size: tuple[int, int], model: CameraModel | None, fov_deg: float | None
) -> PlacedCamera:
    """Return the camera that sees tags with corners ``seen`` (M, 4, 2), ``height_m`` above the floor.

    model: of a lens that was measured; None: its field of view may be named.

    Raises:
        CameraError: The tags do not tell it.
    """
    some = np.linspace(0, len(seen) - 1, min(_FIRST_TAGS, len(seen))).astype(int)
    near = _Fit(seen[some], side_m, size, model, fov_deg).roughly()
    fit = _Fit(seen, side_m, size, model, fov_deg)
    values, covariance = fit.best(near)
    geometry = fit.geometry(values)
    T = geometry.T_world_camera.copy()
    T[2, 3] += height_m
    return PlacedCamera(
        geometry=geometry.moved(T),
        size=size,
        line_time_s=0.0 if model is None else model.line_time_s,
        lens_calibrated=model is not None,
        place_calibrated=False,
        edge_error_m=fit.edge_error(values, covariance),
        fov_deg=_fov_deg(size[0], fit.focal_px(values)),
    )


def calibrated(model: CameraModel) -> PlacedCamera:
    """Return a camera of which all was measured."""
    return PlacedCamera(
        geometry=CameraGeometry.from_model(model),
        size=(model.width, model.height),
        line_time_s=model.line_time_s,
        fov_deg=_fov_deg(model.width, model.focal_px[0]),
    )


def side_ratio(geometry: CameraGeometry, seen: Array, side_m: float, height_m: float) -> float:
    """Return the median side of tags with corners ``seen`` (M, 4, 2), over what it should be."""
    flat = geometry.to_plane(seen.reshape(-1, 2), height_m).reshape(-1, 4, 2)
    return float(np.median(np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2).mean(1))) / side_m


class _Fit:
    """Values: tilt about the image's right and down [rad], logarithm of the distance [m] along the optical axis, and of
    a lens that was not measured: logarithm of the focal length [px], principal point [widths], k1, k2."""

    def __init__(
        self, seen: Array, side_m: float, size: tuple[int, int], model: CameraModel | None, fov_deg: float | None
    ) -> None:
        self._seen, self._side, self._size, self._model = seen, side_m, size, model
        self._side_px = np.linalg.norm(seen - np.roll(seen, 1, axis=1), axis=2).mean(1)
        focal = size[0] / 2.0 / math.tan(math.radians(USUAL_FOV_DEG if fov_deg is None else fov_deg) / 2.0)
        lens = [] if model is not None else [math.log(focal), 0.0, 0.0, 0.0, 0.0]
        sigma = [_FOCAL if fov_deg is None else _FOCAL_NAMED, _CENTRE, _CENTRE, _K1, _K2][: len(lens)]
        distance = (focal if model is None else model.focal_px[0]) * side_m / float(np.median(self._side_px))
        self._mean = np.array([0.0, 0.0, math.log(distance), *lens])
        self._weight = np.array([0.0, 0.0, 0.0, *(1.0 / np.array(sigma))])  # of the priors

    def focal_px(self, values: Array) -> float:
        return self._model.focal_px[0] if self._model is not None else math.exp(values[3])

    def geometry(self, values: Array) -> CameraGeometry:
        K, distortion, lens = self._lens(values)
        R = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(np.array([values[0], values[1], 0.0]))[0]
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R, -math.exp(values[2]) * R[:, 2]
        tilted = CameraGeometry(K, distortion, T, lens)
        middle = (np.array(self._size) - 1.0) / 2.0
        origin, right = tilted.to_plane(middle + np.array([[0.0, 0.0], [1.0, 0.0]]), 0.0)
        c, s = (right - origin) / np.linalg.norm(right - origin)
        level = np.eye(4)
        level[:2, :2] = [[c, s], [-s, c]]
        level[:2, 3] = -level[:2, :2] @ origin
        return tilted.moved(level @ T)

    def _lens(self, values: Array) -> tuple[Array, Array, Lens]:
        if self._model is not None:
            (f_x, f_y), (c_x, c_y) = self._model.focal_px, self._model.centre_px
            return (
                np.array([[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1.0]]),
                np.array(self._model.distortion),
                self._model.lens,
            )
        f, (width, height) = math.exp(values[3]), self._size
        c_x, c_y = (width - 1.0) / 2.0 + values[4] * width, (height - 1.0) / 2.0 + values[5] * width
        return np.array([[f, 0, c_x], [0, f, c_y], [0, 0, 1.0]]), np.array([values[6], values[7], 0.0, 0.0]), "pinhole"

    def residuals(self, values: Array) -> Array:
        """Return what is left of each tag (M, 8) [px]."""
        beyond = np.full((len(self._seen), 8), _BEYOND)
        if math.cos(values[0]) * math.cos(values[1]) < _FLATTEST or np.abs(values - self._mean).max() > 3.0:
            return beyond
        geometry = self.geometry(values)
        x_y = geometry.to_plane(self._seen.reshape(-1, 2), 0.0)
        z = (x_y[:, 0] + 1j * x_y[:, 1]).reshape(-1, 4)
        arms = z - z.mean(1, keepdims=True)
        turn = arms @ CORNERS.conj()
        rest = (arms - self._side * (turn / np.abs(turn))[:, None] * CORNERS) * (self._side_px / self._side)[:, None]
        rest = np.concatenate([rest.real, rest.imag], axis=1)
        return np.where(np.isfinite(rest) & (np.abs(rest) < _BEYOND), rest, beyond)

    def roughly(self) -> Array:
        """Return values near the best, wherever the camera looks from."""
        starts = (np.array([a, b, *self._mean[2:]]) for a, b in product(_STARTS, repeat=2))
        found = [self._descended(start, _FIRST_STEPS) for start in starts]
        return min(found, key=lambda values: float(np.median((self.residuals(values) ** 2).mean(1))))

    def best(self, near: Array) -> tuple[Array, Array]:
        """Return the values that explain the tags best, and their covariance."""
        values = self._descended(near, _STEPS)
        rest = self.residuals(values)
        J, weights, sigma = self._slope(values, rest)
        information = J.T @ (weights[:, None] * J) / sigma**2 + np.diag(self._weight**2)
        scale = np.sqrt(np.diagonal(information))
        if not scale.all() or np.linalg.cond(information / np.outer(scale, scale)) > 1e12:
            raise CameraError("the tags do not tell where the camera is: film more of them, or one that moves")
        return values, np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)

    def edge_error(self, values: Array, covariance: Array) -> float:
        """Return the largest standard deviation of a position at the image's edge, from the image's middle [m]."""
        width, height = self._size
        edge = np.array(sorted(set(product((0.0, 0.5, 1.0), repeat=2)) - {(0.5, 0.5)})) * [width - 1.0, height - 1.0]

        def at(values: Array) -> Array:
            return self.geometry(values).to_plane(edge, 0.0)

        both = [at(values + step) - at(values - step) for step in _STEP * np.eye(len(values))]
        J = np.stack(both, axis=2) / (2.0 * _STEP)
        spread = J @ covariance @ J.transpose(0, 2, 1)
        return float(np.sqrt(np.linalg.eigvalsh(spread).max()))

    def _descended(self, values: Array, steps: int) -> Array:
        """Return the values after steps of Levenberg and Marquardt."""
        damping, rest = 1e-3, self.residuals(values)
        for _ in range(steps):
            J, weights, sigma = self._slope(values, rest)
            normal = J.T @ (weights[:, None] * J) / sigma**2 + np.diag(self._weight**2)
            slope = J.T @ (weights * rest.ravel()) / sigma**2 + self._weight**2 * (values - self._mean)
            change = -np.linalg.lstsq(normal + damping * np.diag(np.diagonal(normal)), slope, rcond=None)[0]
            tried = self.residuals(values + change)
            if self._total(tried, values + change, weights, sigma) < self._total(rest, values, weights, sigma):
                values, rest, damping = values + change, tried, damping / 5.0
                if np.abs(change).max() < 1e-9:
                    break
            else:
                damping *= 5.0
        return values

    def _total(self, rest: Array, values: Array, weights: Array, sigma: float) -> float:
        prior = self._weight * (values - self._mean)
        return float(weights @ rest.ravel() ** 2 / sigma**2 + prior @ prior)

    def _slope(self, values: Array, rest: Array) -> tuple[Array, Array, float]:
        """Return derivatives (8M, K) of the residuals, their weights (8M,), and the noise [px]."""
        both = [self.residuals(values + step) - self.residuals(values - step) for step in _STEP * np.eye(len(values))]
        J = np.stack([change.ravel() for change in both], axis=1) / (2.0 * _STEP)
        size = np.sqrt((rest**2).mean(1))
        sigma = max(_LEAST_PX, float(np.median(size)))
        weights = np.minimum(1.0, _ROBUST * sigma / np.maximum(size, 1e-12))
        return J, np.repeat(weights, 8), sigma


def _fov_deg(width: int, focal_px: float) -> float:
    return 2.0 * math.degrees(math.atan(width / 2.0 / focal_px))

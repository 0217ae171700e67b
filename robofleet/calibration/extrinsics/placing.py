"""Where a camera hangs, by least squares over surveyed marks, and how sure that is.

A mark's pixel is a ray; where it meets the plane of the mark's height is where the mark is *seen*. Its error there is
the survey's (one standard deviation for both coordinates), the pixel's, and, if the lens comes with a covariance, the
lens's, which the errors of all marks have in common. Marks whose places were themselves seen through the lens follow
its errors too (``Marks.by_lens``); only the difference counts then. The pose that explains the differences best,
weighted by the inverse of all that, is six small numbers away from the one before: the camera turns about the world's
x, y, z through its optical centre [rad], and shifts along them [m]. To first order a ray's meeting point then moves by
the turned ray, slid along the ray back onto the plane.

What the fit would say of a mark without that mark follows in closed form from the same matrices: with
P = V^-1 - V^-1 J C J^T V^-1, its error is P_ii^-1 (P r)_i, with covariance P_ii^-1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.lens import projection
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry

PARAMETERS = ("turn_x_rad", "turn_y_rad", "turn_z_rad", "shift_x_m", "shift_y_m", "shift_z_m")  # of a covariance
LEAST_SURVEY_M = 1e-4  # nobody surveys a floor better
_GAUSS_NEWTON_STEPS = 8  # from a pose that is right to some centimetres
_UNSURVEYED_SIGMA_M = 1.0  # standard deviation of a place that nobody surveyed
_HEADING_RAD = math.radians(1.0)  # standard deviation of a tag's heading laid out by hand, until the tags tell
_LEAST_HEADING_RAD = math.radians(0.2)
_TURNED = 4.0  # a heading so many standard deviations off was surveyed wrongly


@dataclass(frozen=True)
class Lens:
    """A camera of which only the place is sought."""

    geometry: CameraGeometry  # in any place
    size: tuple[int, int]  # of its image: width, height [px]
    covariance: Array  # (K, K) of f_x, f_y, c_x, c_y [px], then the distortion; (0, 0) if it is not known

    def slopes(self, pixels: Array) -> Array:
        """Return x/z and y/z (N, 2) of pixels' rays, camera frame."""
        return self.geometry.moved(np.eye(4)).to_plane(pixels, 1.0) if len(pixels) else np.zeros((0, 2))

    def by_pixel(self, pixels: Array) -> Array:
        """Return how the slopes change with the pixel (N, 2, 2) [1/px]."""
        return np.asarray(np.linalg.inv(self._derivatives(pixels)[0]))

    def by_lens(self, pixels: Array) -> Array:
        """Return how the slopes change with the lens's values (N, 2, K)."""
        by_slope, by_value = self._derivatives(pixels)
        return np.asarray(np.linalg.solve(by_slope, -by_value))

    def _derivatives(self, pixels: Array) -> tuple[Array, Array]:
        """Return how pixels change with their slopes (N, 2, 2) [px], and with the lens's values (N, 2, K)."""
        K = self.geometry.K
        values = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], self.geometry.distortion])
        points = np.column_stack([self.slopes(pixels), np.ones(len(pixels))])
        _, by_value, by_pose = projection.Lens(self.geometry.lens, self.size, values).project(points, np.zeros(6))
        return by_pose[:, :, 3:5], by_value[:, :, : len(self.covariance)]


@dataclass(frozen=True)
class Placement:
    """A camera's pose fitted to marks."""

    lens: Lens
    T_world_camera: Array
    covariance: Array  # (6, 6), in the order of PARAMETERS
    survey_m: float  # standard deviation of the survey, one coordinate: as stated, else estimated
    error: Array  # (N, 2) seen minus surveyed [m]
    left_out: Array  # (N, 2) the same, of each mark by a fit to the others; NaN where they do not determine a pose
    left_out_covariance: Array  # (N, 2, 2)
    heading_error: Array  # (N,) seen minus surveyed [rad]; NaN: not surveyed
    turned: NDArray[np.bool_]  # (N,) marks whose heading was surveyed wrongly, and is not used
    chi_square: float  # of the positions; a draw from the chi-square distribution of ``freedom`` if all is as supposed
    freedom: int
    absorbed: Array  # (6, K) how the fitted pose follows an error of the lens

    @property
    def geometry(self) -> CameraGeometry:
        return self.lens.geometry.moved(self.T_world_camera)

    def spread(self, points: Array) -> Array:
        """Return the covariances (G, 2, 2) [m^2] with which the camera sees points (G, 3) on their planes."""
        pixels = self.geometry.project(points)
        slopes = self.lens.slopes(pixels)
        _, J, by_slope = on_plane(self.T_world_camera, slopes, points[:, 2])
        through_lens = self.absorbed @ self.lens.covariance @ self.absorbed.T
        left = by_slope @ self.lens.by_lens(pixels) - J @ self.absorbed  # of the lens's error, pose refitted
        own = J @ (self.covariance - through_lens) @ J.transpose(0, 2, 1)
        whole: Array = own + left @ self.lens.covariance @ left.transpose(0, 2, 1)
        return whole

    def seen(self, marks: Marks) -> tuple[Array, Array]:
        """Return the errors (N, 2) [m] of marks that were not fitted, and their covariances (N, 2, 2)."""
        return errors_at(self.lens, marks, self.T_world_camera, self.covariance, self.survey_m)


def met(T_world_camera: Array, slopes: Array, heights: Array) -> Array:
    """Return where rays meet their planes (N, 2) [m; world]."""
    R, centre = T_world_camera[:3, :3], T_world_camera[:3, 3]
    rays = slopes @ R[:, :2].T + R[:, 2]
    return np.asarray(centre[:2] + ((heights - centre[2]) / rays[:, 2])[:, None] * rays[:, :2])


def on_plane(T_world_camera: Array, slopes: Array, heights: Array) -> tuple[Array, Array, Array]:
    """Return where rays meet their planes, and how that moves.

    Places (N, 2) [m; world], their derivatives (N, 2, 6) by turn and shift, and (N, 2, 2) by the slopes.
    """
    R, centre = T_world_camera[:3, :3], T_world_camera[:3, 3]
    rays = slopes @ R[:, :2].T + R[:, 2]
    reach = (heights - centre[2]) / rays[:, 2]
    q = reach[:, None] * rays
    slide = q[:, :2] / q[:, 2:]  # what a unit of height costs along the ray

    def back(moved: Array) -> Array:
        """Slide displacements (N, 3, C) along the rays, onto the planes."""
        return np.asarray(moved[:, :2] - slide[:, :, None] * moved[:, 2:])

    zero = np.zeros(len(q))
    x, y, z = q.T
    turn = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).transpose(2, 0, 1)  # columns: e_k x q
    shift = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    by_slope = back(reach[:, None, None] * R[None, :, :2])
    return centre[:2] + q[:, :2], back(np.concatenate([turn, shift], 2)), by_slope


def place(lens: Lens, marks: Marks, T_world_camera: Array, survey_m: float | None) -> Placement:
    """Fit one camera's pose: see ``place_together``."""
    return place_together([lens], [marks], [T_world_camera], survey_m)[0]


def place_together(
    lenses: Sequence[Lens], marks: Sequence[Marks], poses: Sequence[Array], survey_m: float | None
) -> list[Placement]:
    """Fit the poses of cameras, each to its own marks, beginning near them.

    Marks of one name have one survey's error, or, where nobody surveyed them (NaN), one place. ``survey_m`` None:
    estimated from what is left over.

    Raises:
        np.linalg.LinAlgError: the marks do not determine the poses.
    """
    T, counts = list(poses), [len(own) for own in marks]
    ends = np.cumsum(counts)
    rows = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]  # of marks, by camera
    names = np.concatenate([own.names for own in marks])
    surveyed = np.concatenate([own.points[:, :2] for own in marks])
    unsurveyed, same = np.isnan(surveyed[:, 0]), np.equal.outer(names, names)
    freedom = 2 * len(names) - 6 * len(T) - 2 * len(set(names[unsurveyed]))
    slopes = [lens.slopes(own.pixels) for lens, own in zip(lenses, marks, strict=True)]
    by_pixel = [lens.by_pixel(own.pixels) for lens, own in zip(lenses, marks, strict=True)]
    by_lens = [lens.by_lens(own.pixels) for lens, own in zip(lenses, marks, strict=True)]

    def linearised(survey_m: float) -> tuple[Array, Array, Array, list[Array]]:
        """Return what the poses leave over (2N,), its derivatives, its covariance, and how it follows each lens."""
        seen, J = np.empty((len(names), 2)), np.zeros((len(names), 2, 6 * len(T)))
        V = np.kron(same * np.where(unsurveyed, _UNSURVEYED_SIGMA_M, survey_m) ** 2, np.eye(2))
        follows = []
        for c, (own, part) in enumerate(zip(marks, rows, strict=True)):
            seen[part], J[part, :, 6 * c : 6 * c + 6], by_slope = on_plane(T[c], slopes[c], own.points[:, 2])
            follows.append((by_slope @ by_lens[c] - own.by_lens).reshape(2 * len(own), -1))
            block = slice(2 * part.start, 2 * part.stop)
            V[block, block] += _seen_noise(by_slope @ by_pixel[c], follows[c], own.sigma_px, lenses[c].covariance)
        mean = same @ seen / same.sum(axis=1)[:, None]
        return (np.where(unsurveyed[:, None], mean, surveyed) - seen).ravel(), J.reshape(2 * len(names), -1), V, follows

    def step(change: Array) -> None:
        T[:] = [moved(pose, part) for pose, part in zip(T, change.reshape(-1, 6), strict=True)]

    sigma, chi_square = LEAST_SURVEY_M if survey_m is None else survey_m, 0.0
    for _ in range(_GAUSS_NEWTON_STEPS):
        r, J, V, _ = linearised(sigma)
        weighted, covariance, P = normal(J, V)
        chi_square = float(r @ P @ r)
        step(covariance @ (weighted.T @ r))
        if survey_m is None:
            sigma = max(LEAST_SURVEY_M, sigma * math.sqrt(chi_square / freedom))
    headings = [_headings(lens, own, pose) for lens, own, pose in zip(lenses, marks, T, strict=True)]
    off = np.concatenate([own for own, _ in headings])
    heading_sigma = _heading_sigma(off)
    turned = np.abs(off) > _TURNED * heading_sigma
    used = np.isfinite(off) & ~turned
    J_heading = np.zeros((len(names), 6 * len(T)))
    for c, (part, (_, J_own)) in enumerate(zip(rows, headings, strict=True)):
        J_heading[part, 6 * c : 6 * c + 6] = J_own
    r, J, V, follows = linearised(sigma)
    whole = np.diag(np.full(len(V) + np.count_nonzero(used), heading_sigma**2))
    whole[: len(V), : len(V)] = V
    r = np.concatenate([r, -off[used]])
    weighted, covariance, P = normal(np.vstack([J, J_heading[used]]), whole)
    without, without_covariance = left_out(P, r, used)
    without[unsurveyed], without_covariance[unsurveyed] = np.nan, np.nan
    step(covariance @ (weighted.T @ r))
    error = -linearised(sigma)[0].reshape(-1, 2)
    placements = []
    for c, part in enumerate(rows):
        pose, own = slice(6 * c, 6 * c + 6), weighted[2 * part.start : 2 * part.stop]
        placements.append(Placement(
            lenses[c], T[c], covariance[pose, pose], sigma, error[part], -without[part], without_covariance[part],
            off[part], turned[part], chi_square, freedom, covariance[pose] @ own.T @ follows[c],
        ))  # fmt: skip
    return placements


def moved(T_world_camera: Array, change: Array) -> Array:
    """Return a pose turned about its own place and shifted, by (6,) in the order of PARAMETERS."""
    T = T_world_camera.copy()
    T[:3, :3] = cv2.Rodrigues(change[:3])[0] @ T[:3, :3]
    T[:3, 3] += change[3:]
    return T


def change_between(before: Array, after: Array) -> Array:
    """Return what ``moved`` takes to go from one pose to another (6,)."""
    turn = rotation_vector(after[:3, :3] @ before[:3, :3].T)
    return np.concatenate([turn, after[:3, 3] - before[:3, 3]])


def rotation_vector(R: Array) -> Array:
    """Return axis times angle (3,) [rad]: ``cv2.Rodrigues`` is 4e-5 off for a camera that looks straight down."""
    axis = np.linalg.svd(R - np.eye(3))[2][2]
    sine = axis @ [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]] / 2.0
    vector: Array = axis * math.atan2(sine, (np.trace(R) - 1.0) / 2.0)
    return vector


def errors_at(lens: Lens, marks: Marks, T: Array, covariance: Array, survey_m: float) -> tuple[Array, Array]:
    """Return the errors (N, 2) [m] of marks that a pose with a covariance was not fitted to, and theirs (N, 2, 2)."""
    seen, J, by_slope = on_plane(T, lens.slopes(marks.pixels), marks.points[:, 2])
    noise = _ownnoise(by_slope @ lens.by_pixel(marks.pixels), marks.sigma_px, survey_m)
    return seen - marks.points[:, :2], noise + J @ covariance @ J.transpose(0, 2, 1)


def _seen_noise(by_pixel: Array, by_lens: Array, sigma_px: Array, lens: Array) -> Array:
    """Return the covariance (2N, 2N) of what one camera sees: its pixels', and its lens's (2N, K)."""
    own = _ownnoise(by_pixel, sigma_px, 0.0)
    n = len(own)
    V = np.zeros((n, 2, n, 2))
    V[np.arange(n), :, np.arange(n), :] = own
    whole: Array = V.reshape(2 * n, 2 * n) + by_lens @ lens @ by_lens.T
    return whole


def _ownnoise(by_pixel: Array, sigma_px: Array, survey_m: float) -> Array:
    """Return each mark's covariance (N, 2, 2) by its survey and its pixel."""
    own: Array = sigma_px[:, None, None] ** 2 * (by_pixel @ by_pixel.transpose(0, 2, 1)) + survey_m**2 * np.eye(2)
    return own


def normal(J: Array, V: Array) -> tuple[Array, Array, Array]:
    """Return V^-1 J, the pose's covariance and P; LinAlgError if J's columns depend on each other."""
    inverse = np.linalg.inv(V)
    weighted = inverse @ J
    information = J.T @ weighted
    scale = np.sqrt(np.diagonal(information))
    if not scale.all() or np.linalg.cond(information / np.outer(scale, scale)) > 1e10:
        raise np.linalg.LinAlgError("the marks do not determine a pose")
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return weighted, covariance, inverse - weighted @ covariance @ weighted.T


def _headings(lens: Lens, marks: Marks, T: Array) -> tuple[Array, Array]:
    """Return headings' errors (N,) [rad], NaN where there is none, and their derivatives (N, 6)."""
    heights = marks.points[:, 2]
    centre, J_centre, _ = on_plane(T, lens.slopes(marks.pixels), heights)
    tags = np.isfinite(marks.ahead[:, 0])
    edge, J_edge, _ = on_plane(T, lens.slopes(np.where(tags[:, None], marks.ahead, marks.pixels)), heights)
    arm = edge - centre
    left = np.stack([-arm[:, 1], arm[:, 0]], 1) / np.where(tags, (arm**2).sum(1), np.nan)[:, None]
    off = np.arctan2(arm[:, 1], arm[:, 0]) - marks.headings
    off -= math.tau * np.round(off / math.tau)
    J: Array = (left[:, :, None] * (J_edge - J_centre)).sum(1)
    return off, J


def _heading_sigma(off: Array) -> float:
    """Return the standard deviation of headings from their errors; one that was surveyed wrongly counts little."""
    known = np.abs(off[np.isfinite(off)])
    return _HEADING_RAD if len(known) < 4 else max(_LEAST_HEADING_RAD, 1.4826 * float(np.median(known)))


def left_out(P: Array, r: Array, with_heading: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return what each mark is off by (N, 2) for a fit without it, and the covariances (N, 2, 2)."""
    n = len(with_heading)
    heading_rows = 2 * n + np.cumsum(with_heading) - 1
    error, covariance = np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan)
    score = P @ r
    for i in range(n):
        rows = [2 * i, 2 * i + 1, *([int(heading_rows[i])] if with_heading[i] else [])]
        block = P[np.ix_(rows, rows)]
        scale = np.sqrt(np.maximum(np.diagonal(block), 1e-300))
        if np.linalg.cond(block / np.outer(scale, scale)) < 1e8:
            whole = np.linalg.inv(block)
            error[i], covariance[i] = (whole @ score[rows])[:2], whole[:2, :2]
    return error, covariance

"""Planar poses of a fleet's AprilTags (36h11) in one image of an overhead camera.

A tag lies flat at a known height, centred on its robot. With the pattern upright as OpenCV prints it
(``cv2.aruco.generateImageMarker``), the print's right is the robot's forward x, its top the robot's left y.

OpenCV finds and identifies the squares, with corners good to half a pixel. The pose is then fitted to the
greys of the whole pattern: at 24 px a tag, refined contours leave 0.24 mm and 0.39 deg rms, this fit 0.05 mm
and 0.03 deg. Points of the plane are complex numbers here, x + iy; in the tag's own frame, forward + i left
[sides].
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.tracking.camera import CameraGeometry

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CELLS = 8  # of the pattern, black rim included
_SAMPLES = 24  # along a side of the fitted square, about one a pixel
_REACH = 0.56  # half the fitted square [sides]: it goes half a white cell beyond the black rim
_BLUR = 0.03  # standard deviation expected of lens, pixel and interpolation [sides]; a wrong one does not bias
_STEPS = 2  # Gauss-Newton
_ALIKE = 0.9  # least correlation of a print with its pattern: a tag has 0.99, one with 4 cells wrong 0.88
_SIZE = (0.8, 1.25)  # of a square on the plane, over the true one
_SKEW = 0.1  # its corners' largest distance from a true square's [sides]

# As detectMarkers orders them: the print's top left, top right, bottom right, bottom left.
_CORNERS = np.array([-0.5 + 0.5j, 0.5 + 0.5j, 0.5 - 0.5j, -0.5 - 0.5j])


class TagSighting(NamedTuple):
    """One tag: planar pose of its centre in the world frame."""

    tag: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad; CCW +]


class Sightings(NamedTuple):
    """What one image shows."""

    poses: tuple[TagSighting, ...]
    refused: int  # squares that read as the fleet's and cannot be: an id seen twice, a wrong size, shape or look


class TagDetector:
    """Finds a fleet's tags; other ids of the family are not in its dictionary."""

    def __init__(self, geometry: CameraGeometry, tag_ids: Sequence[int], side_m: float, height_m: float) -> None:
        """Take the fleet's ids, the side of the tags' black square and the height at which all lie."""
        self._geometry, self._ids, self._side, self._height = geometry, tag_ids, side_m, height_m
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        fleet = cv2.aruco.Dictionary(family.bytesList[list(tag_ids)], _CELLS - 2, family.maxCorrectionBits)
        self._detector = cv2.aruco.ArucoDetector(fleet, _parameters(geometry, side_m, height_m))
        patterns = [fleet.generateImageMarker(i, _CELLS) > 0 for i in range(len(tag_ids))]
        self._fits = np.stack([_fit(pattern) for pattern in patterns])
        at = _samples().reshape(-1, 1)
        self._weights = (0.5 + 2.0 * at.real * _CORNERS.real) * (0.5 + 2.0 * at.imag * _CORNERS.imag)

    def detect(self, image: NDArray[np.uint8]) -> Sightings:
        """Return the poses seen in an image (H, W)."""
        corners, found, _ = self._detector.detectMarkers(image)
        if found is None or len(found) == 0:
            return Sightings((), 0)
        index = found[:, 0]
        pixels = np.concatenate(corners, axis=1).reshape(-1, 2).astype(np.float64)
        x_y = self._geometry.to_plane(pixels, self._height)
        centre, psi, plausible = self._square((x_y[:, 0] + 1j * x_y[:, 1]).reshape(-1, 4))
        for _ in range(_STEPS):
            centre, psi, alike = self._polish(image, index, centre, psi)
        good = plausible & (alike > _ALIKE) & (np.bincount(index)[index] == 1)
        rows = zip(index[good].tolist(), centre[good].tolist(), psi[good].tolist(), strict=True)
        seen = tuple(TagSighting(self._ids[i], c.real, c.imag, math.remainder(a, math.tau)) for i, c, a in rows)
        return Sightings(seen, len(index) - len(seen))

    def _square(self, corners: Complex) -> tuple[Complex, Array, NDArray[np.bool_]]:
        """Return centre and heading of the squares (M, 4) by least squares, and whether they may be tags."""
        centre = corners.mean(1)
        arms = (corners - centre[:, None]) / self._side
        turn = arms @ _CORNERS.conj() / 2.0  # 2 is the sum of |_CORNERS|^2
        size = np.abs(turn)
        skew = np.abs(arms - turn[:, None] * _CORNERS).max(1)
        return centre, np.angle(turn), (size > _SIZE[0]) & (size < _SIZE[1]) & (skew < _SKEW)

    def _polish(
        self, image: NDArray[np.uint8], index: NDArray[Any], centre: Complex, psi: Array
    ) -> tuple[Complex, Array, Array]:
        """Return centres and headings (M,) a Gauss-Newton step on, and the correlations (M,) before it."""
        turn = self._side * np.exp(1j * psi)
        corners = (centre[:, None] + turn[:, None] * _CORNERS).ravel()
        points = np.stack([corners.real, corners.imag, np.full(len(corners), self._height)], axis=1)
        at = (self._weights @ self._geometry.project(points).reshape(-1, 4, 2)).astype(np.float32)
        grays = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        fit = (self._fits[index] @ grays[:, :, None].astype(np.float64))[:, :, 0]
        alike = fit[:, 0] / (grays.std(1) * _SAMPLES + 1e-9)
        forward, left, spin = (fit[:, 2:] / np.maximum(fit[:, 1:2], 1.0)).T  # less contrast than 1 is no tag
        return centre + turn * (forward + 1j * left), psi + spin, alike


def _parameters(geometry: CameraGeometry, side: float, height: float) -> cv2.aruco.DetectorParameters:
    """Return the settings of OpenCV's detector: one threshold, and only contours about as long as a tag's."""
    side_px = geometry.K[0, 0] * side / (geometry.position[2] - height)
    image_px = 2.0 * geometry.K[:2, 2].max()  # the longer side, which the rates are of, nearly
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15.0
    # Contours count a diagonal step as one, and the image's corners show tags smaller: half remains.
    parameters.minMarkerPerimeterRate = 0.5 * 4.0 * side_px / image_px
    parameters.maxMarkerPerimeterRate = 2.0 * 4.0 * side_px / image_px
    # All the bits that the family can correct: what is corrected wrongly does not look like its tag.
    parameters.errorCorrectionRate = 1.0
    return parameters


def _samples() -> Complex:
    """Return where the fit samples a tag, (_SAMPLES, _SAMPLES), row 0 at the print's top."""
    at = ((np.arange(_SAMPLES) + 0.5) / _SAMPLES * 2.0 - 1.0) * _REACH
    return at[None, :] - 1j * at[:, None]


def _fit(pattern: NDArray[Any]) -> Array:
    """Return the rows (5, n) to multiply a patch of n greys with; ``pattern`` (8, 8) is true where white.

    Correlation times the patch's norm; contrast; contrast times the offset forward, left [sides] and
    counter-clockwise [rad]. Brightness and a slope of the light are fitted too, and dropped.
    """
    at = _samples()
    z = (at[0].real[:, None] - (np.arange(_CELLS + 1) / _CELLS - 0.5)) / _BLUR
    step = np.vectorize(math.erf)(z / math.sqrt(2.0)) / 2.0
    slope = np.exp(-z * z / 2.0) / (_BLUR * math.sqrt(2.0 * math.pi))
    cell, edge, black = step[:, :-1] - step[:, 1:], slope[:, :-1] - slope[:, 1:], 1.0 - pattern
    look, forward, left = -cell @ black @ cell.T, -cell @ black @ edge.T, edge @ black @ cell.T
    spin = at.real * left - at.imag * forward
    basis = np.stack([look, -forward, -left, -spin, np.ones_like(look), at.real, at.imag]).reshape(7, -1)
    look = look.ravel() - look.mean()
    return np.vstack([look / np.linalg.norm(look), np.linalg.pinv(basis.T)[:4]])

"""Who is compared on the ray-cast frames: robofleet's tracker, and the libraries that a user could pick.

A library's corners are undistorted and put on the tags' plane by the same geometry as robofleet's; the square that fits
them best by least squares gives centre and heading (its centre is their mean, which is better than where the diagonals
cross by the square root of two). AprilTag libraries put the middle of the first pixel at +0.5: that is taken off.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
import pupil_apriltags
import pyapriltags
from numpy.typing import NDArray

from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.offset import UNKNOWN, Covariance
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker

Image = NDArray[np.uint8]

OURS, UNTIMED = "robofleet", "robofleet, row times ignored"

_FAMILY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
# The print's top left, top right, bottom right, bottom left: forward + i left [sides].
_CORNERS = np.array([-0.5 + 0.5j, 0.5 + 0.5j, 0.5 - 0.5j, -0.5 - 0.5j])


class PeerTag(NamedTuple):
    """What a candidate says of one tag."""

    tag: int
    x: float  # [m; world]
    y: float
    psi: float  # [rad; CCW +]
    after_ns: int = 0  # the tag's instant, minus the image's
    covariance: Covariance = UNKNOWN


Candidate = Callable[[Image, int], list[PeerTag]]  # image, exposure_ns


class Setting(NamedTuple):
    """What a candidate may know beforehand."""

    geometry: CameraGeometry
    size: tuple[int, int]  # of the image
    targets: Sequence[Target]
    line_time: float


def robofleet(setting: Setting) -> Candidate:
    """Follow the tags; what was predicted and not measured does not count."""
    tracker = TagTracker(setting.geometry, setting.size, setting.targets, setting.line_time)

    def see(image: Image, exposure_ns: int) -> list[PeerTag]:
        poses = tracker.track(image, exposure_ns).poses
        return [PeerTag(s.tag, s.x, s.y, s.psi, s.after_ns, s.covariance) for s in poses if s.coasted_ns == 0]

    return see


def untimed(setting: Setting) -> Candidate:
    """Follow the tags, as if all rows were exposed at once."""
    return robofleet(setting._replace(line_time=0.0))


def opencv_default(setting: Setting) -> Candidate:
    """Detect the family's tags as OpenCV does if nothing is said."""
    return _opencv(setting, cv2.aruco.ArucoDetector(_FAMILY), range(len(_FAMILY.bytesList)))


def opencv_tuned(setting: Setting) -> Candidate:
    """Detect the fleet's tags with one threshold, contours of some length only, and refined corners."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15.0
    parameters.minMarkerPerimeterRate = 0.04
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    ids = [target.tag for target in setting.targets]
    fleet = cv2.aruco.Dictionary(_FAMILY.bytesList[ids], _FAMILY.markerSize, _FAMILY.maxCorrectionBits)
    return _opencv(setting, cv2.aruco.ArucoDetector(fleet, parameters), ids)


class _PupilDetector(pupil_apriltags.Detector):
    """Never freed: it would free its families before the detector that reads them, and crash."""

    def __del__(self) -> None:
        pass


def apriltag(make: Any, decimate: float) -> Callable[[Setting], Candidate]:
    """Detect the family's tags with a wrapper of the AprilTag library."""

    def candidate(setting: Setting) -> Candidate:
        detector = make(families=f"tag{setting.targets[0].family}", nthreads=1, quad_decimate=decimate)

        def see(image: Image, exposure_ns: int) -> list[PeerTag]:
            found = detector.detect(image)
            corners = [tag.corners[[1, 0, 3, 2]] - 0.5 for tag in found]
            return _placed(setting, [tag.tag_id for tag in found], corners)

        return see

    return candidate


CANDIDATES: dict[str, Callable[[Setting], Candidate]] = {
    OURS: robofleet,
    "OpenCV, default": opencv_default,
    "OpenCV, tuned": opencv_tuned,
    "pyapriltags, decimate 1": apriltag(pyapriltags.Detector, 1.0),
    "pyapriltags, decimate 2": apriltag(pyapriltags.Detector, 2.0),
    "pupil-apriltags, decimate 1": apriltag(_PupilDetector, 1.0),
    "pupil-apriltags, decimate 2": apriltag(_PupilDetector, 2.0),
    UNTIMED: untimed,
}


def _opencv(setting: Setting, detector: cv2.aruco.ArucoDetector, ids: Sequence[int]) -> Candidate:
    def see(image: Image, exposure_ns: int) -> list[PeerTag]:
        corners, index, _ = detector.detectMarkers(image)
        return _placed(setting, [] if index is None else [ids[i] for i in index.ravel()], corners)

    return see


def _placed(setting: Setting, tags: Sequence[int], corners: Sequence[NDArray[Any]]) -> list[PeerTag]:
    """Put corners [px], in the order of ``_CORNERS``, on the tags' plane."""
    if not tags:
        return []
    pixels = np.concatenate([np.reshape(c, (4, 2)) for c in corners]).astype(np.float64)
    x, y = setting.geometry.to_plane(pixels, setting.targets[0].height).T
    at = (x + 1j * y).reshape(-1, 4)
    centre = at.mean(1)
    psi = np.angle((at - centre[:, None]) @ _CORNERS.conj())
    return [PeerTag(*each) for each in zip(tags, centre.real.tolist(), centre.imag.tolist(), psi.tolist(), strict=True)]

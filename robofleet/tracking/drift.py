"""Notices that the camera is no longer where it was calibrated, by tags that lie on the floor."""

from collections.abc import Sequence
from typing import NamedTuple

from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import Happening
from robofleet.tracking.tracker import TagSighting


class Landmark(NamedTuple):
    """A surveyed tag that lies still."""

    tag: int
    x: float  # [m; world]
    y: float
    psi: float  # of the print's right [rad; CCW +]
    height: float  # [m]


class DriftMonitor:
    """Compares where landmarks are seen with where they lie."""

    def __init__(self, geometry: CameraGeometry, landmarks: Sequence[Landmark]) -> None:
        self._geometry = geometry

    def update(self, sightings: Sequence[TagSighting]) -> tuple[CameraGeometry | None, tuple[Happening, ...]]:
        """Take one image's sightings of the landmarks, placed by the geometry given last.

        Returns the corrected geometry if it changed, and what happened.
        """
        return None, ()

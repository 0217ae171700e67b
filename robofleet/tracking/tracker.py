"""Follows a set of tags from image to image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import Happening
from robofleet.tracking.tags import TagDetector


class Target(NamedTuple):
    """A tag to follow."""

    tag: int
    side: float  # of its black square [m]
    height: float  # above the floor [m]
    max_speed: float  # 0 for a tag that lies still [m/s]


class TagSighting(NamedTuple):
    """Planar pose of a tag's centre in the world frame."""

    tag: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # of the print's right [rad; CCW +]
    after_ns: int  # its own mid-exposure, minus the image's (rolling shutter)
    coasted_ns: int  # 0: measured in this image; else predicted, from a measurement so old


class Sightings(NamedTuple):
    """What one image shows."""

    poses: tuple[TagSighting, ...]
    refused: int  # squares that read as a target and cannot be it
    happenings: tuple[Happening, ...]


class TagTracker:
    """Acquires tags, follows them, predicts those that are hidden, and never guesses which is which."""

    def __init__(
        self,
        geometry: CameraGeometry,
        image_size: tuple[int, int],
        targets: Sequence[Target],
        line_time: float = 0.0,
    ) -> None:
        """Take the image's (width, height) and a rolling shutter's time from row to row [s]."""
        by_look: dict[tuple[float, float], list[int]] = {}
        for target in targets:
            by_look.setdefault((target.side, target.height), []).append(target.tag)
        self._detectors = [TagDetector(geometry, tags, *look) for look, tags in by_look.items()]

    def track(self, image: NDArray[np.uint8], exposure_ns: int) -> Sightings:
        """Return what an image (H, W) shows, whose middle row was exposed around ``exposure_ns``."""
        found = [detector.detect(image) for detector in self._detectors]
        poses = tuple(TagSighting(*pose, 0, 0) for sightings in found for pose in sightings.poses)
        return Sightings(poses, sum(sightings.refused for sightings in found), ())

    def moved(self, geometry: CameraGeometry) -> None:
        """Go on with a corrected camera."""

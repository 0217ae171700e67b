"""From an image to the poses of the robots' centres: tags, where they sit on their robots, the camera's drift, and what
its images have of those before."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robofleet.config.tree import Config
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.cameras.light import Light, TagLight
from robofleet.tracking.denoising import TemporalDenoising
from robofleet.tracking.drift import DriftMonitor
from robofleet.tracking.events import NO_TAG, News, TrackerEvent
from robofleet.tracking.offset import centre_covariance, centre_from_tag
from robofleet.tracking.tags.imaging import BlurMonitor, Imaging
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import floor_tags_in_view, floor_targets, robot_targets
from robofleet.tracking.tags.tracker import Sightings, TagSighting, TagTracker

_MOVES_PX = 1.0  # from image to image, of a tag that shows whether images lag
_BLIND_IMAGES = 10  # with robots in sight and no floor tag that lies where it was: the camera may look elsewhere


class FleetSight:
    """Sees a configuration's fleet. While the camera's place is in doubt no robot is measured."""

    def __init__(self, config: Config) -> None:
        model = config.camera.model
        geometry = CameraGeometry.from_model(model)
        lying = floor_tags_in_view(config)
        targets = [*robot_targets(config), *floor_targets(config, lying)]
        self._heights = {target.tag: target.height for target in targets}
        self._light = TagLight(targets)
        self._measured: list[TagSighting] = []  # in the newest image
        imaging = Imaging.of(model.imaging)
        self._tracker = TagTracker(geometry, (model.width, model.height), targets, model.line_time_s, imaging)
        self._blur = BlurMonitor(imaging, None if model.imaging is None else model.imaging.blur_px)
        self._denoising = TemporalDenoising()
        self._judges = [PhotometricFit(geometry, targets, model.line_time_s) for _ in range(2)]
        self._offsets = {robot.tag: robot.tag_offset for robot in config.seen}
        self._drift = DriftMonitor(geometry, lying) if lying else None
        self._camera = geometry  # of the newest image
        self._news = News()
        self._blind = 0

    def see(self, image: NDArray[np.uint8], exposure_ns: int) -> Sightings:
        """Return the poses of robots' centres in an image (H, W). ``exposure_ns``: mid-exposure of its middle row."""
        blur_px = self._blur.changed()  # by the image before
        if blur_px is not None:
            self._news.say(TrackerEvent.CAMERA_BLUR, NO_TAG, blur_px, exposure_ns)
        undone, before = self._denoising.undone(image, exposure_ns), self._measured
        if undone is None:
            return self._seen(image, exposure_ns)
        if self._denoising.share:
            return self._seen(undone, exposure_ns)
        sightings = self._seen(image, exposure_ns)
        self._judge(image, undone, before)
        if self._denoising.share:
            self._news.say(TrackerEvent.CAMERA_DENOISES, NO_TAG, self._denoising.share, exposure_ns)
        return sightings

    def _judge(self, image: NDArray[np.uint8], undone: NDArray[np.uint8], before: Sequence[TagSighting]) -> None:
        """Compare how much tags that moved look like themselves with the image before in theirs, and without it."""
        earlier = {seen.tag: (seen.x, seen.y) for seen in before}
        rows = {tag: row for row, tag in enumerate(self._heights)}
        both = [seen for seen in self._measured if seen.tag in earlier]
        here = np.array([(seen.x, seen.y, self._heights[seen.tag]) for seen in both]).reshape(-1, 3)
        then = np.array([(*earlier[seen.tag], self._heights[seen.tag]) for seen in both]).reshape(-1, 3)
        geometry = self._tracker.geometry
        moved = np.linalg.norm(geometry.project(here) - geometry.project(then), axis=1) > _MOVES_PX if both else []
        moving = [seen for seen, moves in zip(both, moved, strict=True) if moves]
        if moving:
            index = np.array([rows[seen.tag] for seen in moving])
            guess = np.array([complex(seen.x, seen.y) for seen in moving]), np.array([seen.psi for seen in moving])
            for fit in self._judges:
                fit.geometry = geometry
            shown, without = self._judges
            self._denoising.judge(shown.fit(image, index, *guess).alike, without.fit(undone, index, *guess).alike)

    def _seen(self, image: NDArray[np.uint8], exposure_ns: int) -> Sightings:
        drift = self._drift
        if drift is None:
            poses, refused, happenings = self._tracker.track(image, exposure_ns)
            self._measured = [pose for pose in poses if pose.coasted_ns == 0]
            return Sightings(tuple(map(self._robot, poses)), refused, happenings + self._news.take())
        placed = False

        def place(lying: list[TagSighting]) -> None:
            nonlocal placed
            placed = bool(lying)
            self._place(drift, lying, exposure_ns)

        self._tracker.geometry = drift.geometry
        poses, refused, happenings = self._tracker.track(image, exposure_ns, place)
        self._measured = [pose for pose in poses if pose.coasted_ns == 0]
        robots = [pose for pose in poses if pose.tag in self._offsets]
        measured = [pose for pose in self._measured if pose.tag not in self._offsets]
        wrong = False
        if measured and not placed:  # they were found with the robots, which may have been placed by a wrong camera
            self._camera = self._updated(drift, measured, exposure_ns)
            wrong = self._camera is not self._tracker.geometry
            if wrong:
                self._tracker.moved(self._camera)
        self._blind = 0 if drift.floor_seen else self._blind + 1
        if wrong or not drift.trusted or self._blind > _BLIND_IMAGES:
            robots = [pose for pose in robots if pose.coasted_ns]
        return Sightings(tuple(map(self._robot, self._doubted(drift, robots))), refused, happenings + self._news.take())

    def _doubted(self, drift: DriftMonitor, robots: list[TagSighting]) -> list[TagSighting]:
        """Add what is not known of this image's camera to what is not known of the tags in it."""
        if not robots:
            return robots
        spread = drift.covariance(np.array([[seen.x, seen.y, self._heights[seen.tag]] for seen in robots]))
        rows = spread[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]] + [seen.covariance for seen in robots]
        return [
            seen if seen.coasted_ns else seen._replace(covariance=tuple(row))
            for seen, row in zip(robots, rows.tolist(), strict=True)
        ]

    def _place(self, drift: DriftMonitor, lying: Sequence[TagSighting], exposure_ns: int) -> None:
        """Place the other tags by the camera that shows the floor tags of this image where they lie."""
        trusted = drift.trusted
        camera = self._updated(drift, lying, exposure_ns)
        if trusted:
            self._tracker.geometry = camera
        else:  # where the robots are is not known: they are followed by where they were seen
            self._tracker.geometry = self._camera
            self._tracker.moved(camera)
        self._camera = camera

    def _updated(self, drift: DriftMonitor, lying: Sequence[TagSighting], exposure_ns: int) -> CameraGeometry:
        """Return the camera of this image by its floor tags, and tell what happened to it or to them."""
        camera, drifted = drift.update(lying)
        for happening in drifted:
            self._news.say(*happening, exposure_ns)
        return camera

    def light(self, image: NDArray[np.uint8]) -> Light:
        return self._light.of(image, self._tracker.geometry, self._measured)

    def _robot(self, seen: TagSighting) -> TagSighting:
        x, y, psi = centre_from_tag(seen.x, seen.y, seen.psi, self._offsets[seen.tag])
        spread = centre_covariance(seen.covariance, seen.psi, self._offsets[seen.tag])
        return seen._replace(x=x, y=y, psi=psi, covariance=spread)

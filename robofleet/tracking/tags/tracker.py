"""Follows tags from image to image, and never guesses which is which.

Each image: predict every tag by its last motion, and fit it there photometrically (``photometric.py``). Where that
fails, look for the part of it that is not covered, and search the region that it can have reached (``detection.py``,
``deep.py``). Where that fails too, coast on the prediction and say so. One tile of the image is searched as a whole,
another one each time: newcomers, and prints that ought not to be there, are found within a sweep. As long as a tag is
missing, a second sweep searches deeper.

A tag is known by its continuity: it cannot be further off than its robot can have driven. A print elsewhere is
refused and reported. Only when the tag itself is gone, and the print stayed for some sweeps with no second one of its
id, it is believed: the tag was carried there, or is new.
"""

import math
from collections.abc import Callable, Sequence
from itertools import repeat
from typing import NamedTuple

import numpy as np

from robofleet.core.arrays import Array, Complex, Image, Indices
from robofleet.core.clock import S
from robofleet.core.settings import FAMILIES
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import News, Notice, TrackerEvent
from robofleet.tracking.offset import UNKNOWN, Covariance
from robofleet.tracking.tags.deep import DeepSearch
from robofleet.tracking.tags.detection import Findings, Region, Sweep, TagDetector, tiles
from robofleet.tracking.tags.imaging import Imaging
from robofleet.tracking.tags.motion import measure, predict
from robofleet.tracking.tags.photometric import NOBODY, Fit, Found, PhotometricFit, side_px
from robofleet.tracking.tags.prints import PrintMonitor
from robofleet.tracking.tags.suspects import SAME, Suspects
from robofleet.tracking.tags.targets import Target

CLEAR = 0.9  # a tag that is less alike may be placed better by what is not covered of it
_COAST_NS = S // 2  # a tag that is hidden for longer is lost
_SWEEP_TILES = (4, 3)  # across and down: one is searched in each image
_DEEP_TILES, _DEEP_TILE_PX = 3, (640, 360)  # of the deep search: so many across and down, or more of this size
_BEGINNING = 30  # images that are searched as a whole as long as a tag was never seen
_SEARCHES = 8  # hidden tags an image, at most: a flash that hides all at once may not stop the tracker
_DEEP_SEARCHES = 1  # of these, whose regions are searched deeply
_GAP_NS = S // 10  # a tag that was hidden for longer may be another print of it when it is found again,
_SETTLED_NS = 10 * S  # which shows when both are seen within so long
_OFTEN = 10  # images from which each shape is learnt at first, one an image
_NAMED_EVERY = 4  # studies after which a print is named that is off
_SELDOM, _TURNS = 2, 16  # then from one of so many; and each from one of so many, if there is time for all
_REGION_MARGIN = 0.6  # of a region around what a tag can have reached [sides]


class TagSighting(NamedTuple):
    """Planar pose of a tag's centre in the world frame."""

    tag: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # of the print's right [rad; CCW +]
    after_ns: int  # its own mid-exposure, minus the image's (rolling shutter)
    coasted_ns: int  # 0: measured in this image; else predicted, from a measurement so old
    covariance: Covariance = UNKNOWN  # of what is predicted


class Sightings(NamedTuple):
    """What one image shows."""

    poses: tuple[TagSighting, ...]
    refused: int  # prints that read as a target and cannot be it
    happenings: tuple[Notice, ...]


class TagTracker:
    """Acquires tags, follows them, predicts those that are hidden."""

    def __init__(
        self, geometry: CameraGeometry, image_size: tuple[int, int], targets: Sequence[Target], line_time: float = 0.0,
        imaging: Imaging | None = None,
    ) -> None:  # fmt: skip
        """Take the image's (width, height), a rolling shutter's time from row to row [s], and what is known of the
        camera's imaging."""
        n = len(targets)
        self._targets, self._size = tuple(targets), image_size
        self._alike = FAMILIES[targets[0].family].alike  # a tag where it is expected may be partly hidden
        self._fit = PhotometricFit(geometry, targets, line_time, imaging)
        self._detector = TagDetector(self._fit, targets)
        self._deep = DeepSearch(self._fit, targets)
        self._sides = np.array([target.side for target in targets])
        self._drives = np.array([target.max_speed != 0.0 for target in targets])
        self._pixels_per_m = side_px(geometry, targets[0]) / targets[0].side
        self._centre = np.full(n, np.nan, np.complex128)  # of the newest measurement [m; world]
        self._psi = np.zeros(n)
        self._velocity = np.zeros(n, np.complex128)  # in the tag's frame, forward + i left [m/s]
        self._omega = np.zeros(n)  # [rad/s]
        self._covariance = np.zeros((n, 6))  # of the newest measurement, each a Covariance
        self._row = np.zeros(n)  # of the image, where it was [px]
        self._measured_ns = np.zeros(n, np.int64)
        self._motion = self._centre, self._psi, self._velocity, self._omega, self._row, self._measured_ns
        self._line_ns = np.array([(image_size[1] - 1) / 2.0, line_time * 1e9])  # middle row [px], from row to row
        self._regained_ns = np.full(n, -_SETTLED_NS, np.int64)  # when it was found again after a gap
        self._wanted_studies = np.zeros(n, np.int64)  # images from which each tag's shape ought to have been learnt
        self._prints = PrintMonitor(self._fit.shapes, targets, float(geometry.position[2]))
        self._followed = np.zeros(n, np.bool_)  # measured, or coasting for a short while
        self._suspects = Suspects(targets)
        overlap = 1.5 * max(side_px(geometry, target) * target.whole / target.side for target in targets)
        self._sweep = Sweep(self._detector, tiles(image_size, _SWEEP_TILES, overlap), overlap)
        across, down = (max(_DEEP_TILES, round(a / b)) for a, b in zip(image_size, _DEEP_TILE_PX, strict=True))
        self._deep_sweep = Sweep(self._deep, tiles(image_size, (across, down), overlap), overlap)
        self._images = 0
        self._searches = self._deep_searches = 0  # that may be made still in this image
        self._news = News()
        self._refused = 0
        none = np.zeros(0, np.int64)
        centre, psi, _ = self._predicted(none, 0)  # compiles, or loads
        self._measure(none, self._fit.fit(np.zeros((4, 4), np.uint8), none, centre, psi), 0)

    @property
    def geometry(self) -> CameraGeometry:
        """The camera that places the tags; one that moved shows them elsewhere."""
        return self._fit.geometry

    @geometry.setter
    def geometry(self, geometry: CameraGeometry) -> None:
        self._fit.geometry = geometry

    def moved(self, geometry: CameraGeometry) -> None:
        """Go on with a corrected camera: what was seen at a pixel is seen there still."""
        known, before = np.flatnonzero(self._measured_ns), self.geometry
        self.geometry = geometry
        self._carry(known, self._centre[known], before)

    def track(
        self, image: Image, exposure_ns: int, locate: Callable[[list[TagSighting]], None] | None = None
    ) -> Sightings:
        """Return what an image (H, W) shows. ``exposure_ns``: mid-exposure of its middle row.

        place: is told what was measured of the tags that lie still, before the others are; it may give another camera.
        """
        self._refused = 0
        followed = np.flatnonzero(self._followed)
        expected = followed.tolist()
        measured: set[int] = set()
        self._searches, self._deep_searches = _SEARCHES // 2, 0  # for tags that lie still
        if locate is not None:
            drives = self._drives[followed]
            measured = self._expected(image, exposure_ns, followed[~drives], set(followed[drives].tolist()))
            lying = np.array(sorted(measured), np.int64)
            centre, before = self._centre[lying], self.geometry
            locate(self._sightings(lying.tolist(), exposure_ns))
            if measured and self.geometry is not before:
                self._carry(lying, centre, before)
            followed = followed[drives]
        self._searches, self._deep_searches = self._searches + _SEARCHES // 2, _DEEP_SEARCHES
        measured |= self._expected(image, exposure_ns, followed, measured)
        hidden = [i for i in expected if i not in measured]
        measured |= self._scan(image, exposure_ns, measured)
        poses = self._sightings(sorted(measured), exposure_ns)
        poses += self._coast(exposure_ns, [i for i in hidden if i not in measured])
        return Sightings(tuple(poses), self._refused, self._news.take())

    def _carry(self, index: Indices, centre: Complex, before: CameraGeometry) -> None:
        """Move tags, which camera ``before`` placed at ``centre`` (M,), to where the new camera places them."""
        heights = self._fit.heights[index]
        pixels = before.project(np.column_stack([centre.real, centre.imag, heights]))
        x_y = self.geometry.to_plane(pixels, heights)
        self._centre[index] = x_y[:, 0] + 1j * x_y[:, 1]

    # Tags that are expected

    def _expected(self, image: Image, exposure_ns: int, index: Indices, others: set[int]) -> set[int]:
        """Measure followed tags; returns those that are there. ``others`` are expected elsewhere, or were found."""
        measured = self._follow(image, exposure_ns, index)
        hidden = [i for i in index.tolist() if i not in measured]
        return measured | self._search(image, exposure_ns, hidden, measured | others)

    def _follow(self, image: Image, exposure_ns: int, index: Indices) -> set[int]:
        """Fit the followed tags where they are expected; returns those that are there."""
        if not len(index):
            return set()
        centre, psi, velocity = self._predicted(index, exposure_ns)
        studied = self._studied(index)
        fit = self._fit.fit(image, index, centre, psi, velocity, self._omega[index], studied=studied)
        if studied != NOBODY and self._fit.shapes.counts[studied] % _NAMED_EVERY == 0:
            for event, value in self._prints.news(studied):
                self._say(event, studied, value, exposure_ns)
        if (fit.alike >= CLEAR).all():
            self._measure(index, fit, exposure_ns)
            return set(index.tolist())
        tracked = np.flatnonzero(fit.alike > self._alike)
        partly = tracked[fit.alike[tracked] < CLEAR][: self._searches].tolist()
        self._searches -= len(partly)
        for k in partly:
            tag = self._deep.near(image, int(index[k]), complex(fit.centre[k]), float(fit.psi[k]), followed=True)
            if tag is not None:
                fit.centre[k], fit.psi[k], fit.covariance[k] = tag.centre, tag.psi, tag.covariance
        self._measure(index[tracked], fit.of(tracked), exposure_ns)
        return set(index[tracked].tolist())

    def _studied(self, index: Indices) -> int:
        """Return whose shape is learnt from this image: of those that drive, in turn, at first often, then seldom."""
        drives = index[self._drives[index]]
        if self._images % max(_SELDOM, _TURNS // max(1, len(drives))):
            drives = drives[self._fit.shapes.counts[drives] < _OFTEN]
        if not len(drives):
            return NOBODY
        chosen = int(drives[np.argmin(self._wanted_studies[drives])])
        self._wanted_studies[chosen] += 1
        return chosen

    def _predicted(self, index: Indices, exposure_ns: int) -> tuple[Complex, Array, Complex]:
        """Return centre, heading and velocity [m/s; world] when the rows in which the tags were last are exposed."""
        return predict(index, exposure_ns, self._line_ns, *self._motion)

    def _measure(self, index: Indices, fit: Fit, exposure_ns: int) -> None:
        """Take measured poses, and the motion since the ones before."""
        moving = self._followed & self._drives
        measure(index, exposure_ns, self._line_ns, moving, fit.centre, fit.psi, fit.row, *self._motion)
        self._covariance[index] = fit.covariance
        self._followed[index] = True

    def _reach(self, i: int, exposure_ns: int) -> float:
        """Return how far a tag can be from where it was measured last [m]."""
        return self._suspects.reach(i, exposure_ns - int(self._measured_ns[i]))

    def _search(self, image: Image, exposure_ns: int, hidden: list[int], measured: set[int]) -> set[int]:
        """Look for hidden tags where they can be, the longest hidden first; returns those that are there."""
        found: set[int] = set()
        longest = sorted(hidden, key=lambda i: self._measured_ns[i])[: self._searches]
        self._searches -= len(longest)
        for i in longest:
            centre, psi, _ = self._predicted(np.array([i]), exposure_ns)
            partly = self._deep.near(image, i, complex(centre[0]), float(psi[0]), followed=True)
            if partly is not None and abs(partly.centre - self._centre[i]) <= self._reach(i, exposure_ns):
                self._take(partly, exposure_ns)
                found.add(i)
                continue
            region = self._region(i, exposure_ns)
            findings = self._detector.detect(image, region)
            if not findings.tags and self._deep_searches:
                findings = self._deep.detect(image, region)
                self._deep_searches -= 1
            here = [
                tag
                for tag in findings.tags
                if tag.target == i
                and abs(tag.centre - self._centre[i]) <= self._reach(i, exposure_ns)
                and not self._suspects.is_second(tag, exposure_ns)
            ]
            if here and all(self._suspects.same(tag, here[0].centre) for tag in here):
                self._take(here[0], exposure_ns)
                found.add(i)
                continue
            for tag in findings.tags:
                if tag.target not in (i, *measured) and abs(tag.centre - self._centre[i]) < SAME * self._sides[i]:
                    self._suspects.displaced(tag.target)
                    self._say(TrackerEvent.TAG_MISTAKEN, i, self._targets[tag.target].tag, exposure_ns)
        return found

    def _region(self, i: int, exposure_ns: int) -> Region:
        (u, v) = self._fit.pixels(np.array([i]), self._centre[[i]])[0]
        half = (
            self._reach(i, exposure_ns) + _REGION_MARGIN * self._targets[i].whole * math.sqrt(2.0)
        ) * self._pixels_per_m
        width, height = self._size
        u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        return Region(
            max(0, int(u - half)), max(0, int(v - half)), min(width, int(u + half) + 2), min(height, int(v + half) + 2)
        )

    def _take(self, tag: Found, exposure_ns: int) -> None:
        i = tag.target
        if 0 < self._measured_ns[i] < exposure_ns - _GAP_NS:
            self._regained_ns[i] = exposure_ns
            self._fit.shapes.counts[i] = min(int(self._fit.shapes.counts[i]), _OFTEN - 1)  # its shape may be another
        if self._measured_ns[i] < exposure_ns - _SETTLED_NS:
            self._forget(i)
        index, centre = np.array([tag.target]), np.array([tag.centre])
        rows = self._fit.pixels(index, centre)[:, 1]
        self._measure(
            index, Fit(centre, np.array([tag.psi]), np.ones(1), rows, np.array([tag.covariance])), exposure_ns
        )
        self._suspects.cleared(tag.target)

    def _forget(self, i: int) -> None:
        """Learn anew what shape a tag has."""
        self._fit.shapes.forget(i)
        self._prints.forget(i)

    def _coast(self, exposure_ns: int, hidden: list[int]) -> list[TagSighting]:
        """Return where the tags that are hidden for a short while should be."""
        poses = []
        for i in hidden:
            coasted_ns = exposure_ns - int(self._measured_ns[i])
            if coasted_ns > _COAST_NS:
                self._followed[i] = False
                self._say(TrackerEvent.TAG_LOST, i, coasted_ns * 1e-9, exposure_ns)
                continue
            centre, psi, _ = predict(np.array([i]), exposure_ns, np.zeros(2), *self._motion)
            pose = (float(centre[0].real), float(centre[0].imag), math.remainder(float(psi[0]), math.tau))
            poses.append(TagSighting(self._targets[i].tag, *pose, 0, max(1, coasted_ns), UNKNOWN))
        return poses

    # Tags that are not

    def _scan(self, image: Image, exposure_ns: int, measured: set[int]) -> set[int]:
        """Search a tile, or the whole image at first and while nothing is followed; returns those that are believed."""
        beginning = self._images < _BEGINNING and not self._measured_ns.all()
        whole = beginning or not (measured or self._followed.any())
        known = np.full_like(self._centre, np.nan)
        known[list(measured)] = self._centre[list(measured)]
        look = self._detector.detect(image, known=known) if whole else self._sweep.search(image, self._images, known)
        look = self._deeper(look, image, known)
        self._images += 1
        self._refused += look.refused
        believed: set[int] = set()
        seconds = [tag for tag in look.tags if self._suspects.is_second(tag, exposure_ns)]
        others = [tag for tag in look.tags if tag not in seconds]
        for tag in seconds:
            self._refuse(TrackerEvent.TAG_TWICE, tag, complex(self._centre[tag.target]), exposure_ns)
        for tag in others:
            rivals = [o for o in others if o.target == tag.target and not self._suspects.same(o, tag.centre)]
            if rivals:
                self._refuse(TrackerEvent.TAG_TWICE, tag, rivals[0].centre, exposure_ns)
                self._doubt(tag.target, exposure_ns)
            elif tag.target in measured:
                self._refuse(TrackerEvent.TAG_TWICE, tag, self._centre[tag.target], exposure_ns)
                if exposure_ns - self._regained_ns[tag.target] > _SETTLED_NS:
                    self._suspects.second(tag, exposure_ns)
                else:  # the wrong one of the two may have been taken after the gap
                    self._doubt(tag.target, exposure_ns)
                    measured.discard(tag.target)
            elif tag.target not in believed and self._believable(tag, exposure_ns, whole=whole):
                self._take(tag, exposure_ns)
                believed.add(tag.target)
        return believed

    def _deeper(self, look: Findings, image: Image, known: Complex) -> Findings:
        """Search a tile deeper if a tag is missing that a look did not find; return all that was found."""
        if self._followed.all():
            return look
        missing = ~self._followed
        missing[[tag.target for tag in look.tags]] = False
        if not missing.any():
            return look
        deep = self._deep_sweep.search(image, self._images, known).tags
        news = [
            tag
            for tag in deep
            if not any(tag.target == seen.target and self._suspects.same(tag, seen.centre) for seen in look.tags)
        ]
        return Findings((*look.tags, *news), look.refused)

    def _believable(self, tag: Found, exposure_ns: int, *, whole: bool) -> bool:
        """Return whether continuity or patience allow a tag that is not followed, or is not where it was."""
        i = tag.target
        known = self._measured_ns[i] > 0
        before = complex(self._centre[i]) if known else tag.centre
        distance = abs(tag.centre - before)
        if distance <= self._reach(i, exposure_ns) and (known or whole):
            if not self._followed[i]:
                hidden_s = (exposure_ns - int(self._measured_ns[i])) * 1e-9 if known else 0.0
                self._say(TrackerEvent.TAG_FOUND, i, hidden_s, exposure_ns)
            return True
        rival = self._suspects.rival(tag, exposure_ns)
        hidden_ns = exposure_ns - int(self._measured_ns[i]) if known else None
        patient = self._suspects.sighted(tag, exposure_ns, self._images / len(self._sweep), hidden_ns)
        if rival is not None:
            self._refuse(TrackerEvent.TAG_TWICE, tag, rival, exposure_ns)
            self._doubt(i, exposure_ns)
        elif patient and not self._followed[i]:
            self._say(TrackerEvent.TAG_CARRIED if known else TrackerEvent.TAG_FOUND, i, distance, exposure_ns)
            self._forget(i)  # who carried it may have moved it on its robot
            return True
        elif known:
            self._refuse(TrackerEvent.TAG_JUMPED, tag, before, exposure_ns)
        return False

    def _doubt(self, i: int, exposure_ns: int) -> None:
        """Give up a tag that has two prints of which either may be it."""
        self._suspects.doubt(i, exposure_ns)
        self._followed[i] = False

    # What is said

    def _refuse(self, event: TrackerEvent, tag: Found, other: complex, exposure_ns: int) -> None:
        """Refuse a print, and tell how far it is from the other place of its tag."""
        self._refused += 1
        self._say(event, tag.target, abs(tag.centre - other), exposure_ns)

    def _say(self, event: TrackerEvent, i: int, value: float, exposure_ns: int) -> None:
        self._news.say(event, self._targets[i].tag, value, exposure_ns)

    def _sightings(self, index: list[int], exposure_ns: int) -> list[TagSighting]:
        """Return what was measured in this image."""
        centre, after_ns = self._centre[index], self._measured_ns[index] - exposure_ns
        spread = map(tuple, self._covariance[index].tolist())
        columns = (values.tolist() for values in (centre.real, centre.imag, self._psi[index], after_ns))
        return list(map(TagSighting, (self._targets[i].tag for i in index), *columns, repeat(0), spread))

"""Notices that the camera is no longer where it was calibrated, by tags that lie on the floor, and corrects it.

A camera that turned, shifted or stretched a little since shows every landmark a little off, each by its row of a
sensitivity matrix times six small numbers (``camera_motion.py``). A Kalman filter follows them: what remains from image
to image (drift), and what is new in each image, with variances that are learnt: of a camera at rest they shrink, and
its images are not corrected by their noise. A mount vibrates: what is new of rotation and shift ends with its image. A
lens breathes: what is new of the focal length remains. How much that changes shows in how far the landmarks spread
since the image before, where the survey's errors cancel.

Height above the floor is not among the six: from landmarks of one height it looks like focal length, and taking 1 mm at
2.5 m for that leaves 0.04 mm at a robot's tag. A tilt and a shift differ by how the corners of the arena move: three
landmarks far apart tell one from the other. Two do not; then a tilt is believed, for mounts turn more than they shift,
and up to half of what was a shift remains in the far corners.

What the landmarks were off at the beginning is the survey's, not the camera's: each landmark's own is learnt and
subtracted, if the survey's tolerance explains it. It is the mean of its sightings, drawn to the survey by as much as
the camera shakes. If the lens breathes meanwhile, it is learnt anew, and the survey says where the camera is. Landmarks
that a camera cannot explain moved themselves.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robofleet.config.calibrated import FloorTag
from robofleet.core.arrays import Array, Flags
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.camera_motion import corrected, pose_covariance, sensitivity
from robofleet.tracking.events import Notice, TrackerEvent
from robofleet.tracking.tags.tracker import TagSighting

# Covariances of the camera: rotation [rad] about world x, y, z, shift along x, y [m], log focal length.
_WANDER = np.diag([1.5e-6, 1.5e-6, 1.5e-6, 1e-6, 1e-6, 1e-6]) ** 2  # from image to image, by warming: 5 mm/min
_KNOCK = np.diag([5e-3, 5e-3, 5e-3, 2e-3, 2e-3, 3e-4]) ** 2  # by a knock
_FOCUS = 5e-3**2  # variance of a focal length that breathes [1], and of its change in an image
# Variances of what is new in an image: the least, and what a first surprise makes of it.
_REST = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 3e-7]) ** 2
_SHAKEN = np.array([1e-4, 1e-4, 1e-4, 4e-5, 4e-5, 0.0]) ** 2
_SHAKEN_MORE = 4.0  # a surprise raises them by so much at most
_VIBRATION_GAIN = 0.1
# Standard deviations of a landmark's x, y [m], psi [rad].
_SURVEY = np.array([5e-4, 5e-4, math.radians(1.0)])
_LEAST_NOISE = np.array([3e-5, 3e-5, 5e-4])  # of a sighting
_MOST_NOISE = np.array([1e-3, 1e-3, 2e-2])
_NOISE_GAIN = 0.05
_MEDIAN = 0.6745 * math.sqrt(2.0)  # of the magnitude of the difference of two sightings [standard deviations of one]

_GATE, _SURVEY_GATE = 6.0**2, 4.0**2  # squared distance from which a landmark disagrees
_LEARNT_SIGHTINGS = 20  # of a landmark's own offset, and more if the camera shakes
_STILL_GATE = 3.0**2  # the same of what a landmark moved since the image before
_BREATHES = 20.0  # variances of a change of the focal length beyond which it is one
_BEGINS = 100.0  # times its variance before, with which breathing begins
_LEAST_FREE = 0.2  # share of a sighting's variance that its image's camera must leave to tell its noise
_CALM_IMAGES = 2  # in agreement, after which a knock is over
_LOST_IMAGES = 30  # in a row that are not explained, after which the camera is given up
_FAR_OFF_IMAGES = 3  # the same, if the landmarks are out of bounds
_OFF_IMAGES = 10  # of a landmark that moved itself
_BACK_AFTER_IMAGES = 30  # until it is used again
_STALE_M = 5e-5  # change of a landmark's place that is worth a new geometry
_REPORTED_M = 1e-3  # least change that is reported
_TOLERATED_M = 4e-3  # error up to which an image is believed to show what a knock did
_BOUND_SHARE = 0.02  # of the camera's height: largest correction on the floor, 50 mm of 2.5 m, or about a degree
_ONE = np.eye(6)
_SLOW = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # what is new of these remains
_FAST = 1.0 - _SLOW


class DriftMonitor:
    """Compares where landmarks, surveyed tags that lie still, are seen with where they lie.

    ``geometry``: where the camera hangs; by it the next image's landmarks are to be placed. ``trusted``: poses may be
    used. Not while a knock of more than 4 mm goes on, not when landmarks disagree for a second, and not when the camera
    is further out than is corrected; it can come back. ``floor_seen``: the newest image shows a landmark that did not
    move itself.

    One landmark alone tells that something moved, not what. Two correct a knock, three follow a drift; four in the
    arena's corners place a robot to better than a tenth of a millimetre, relative to the calibration.
    """

    def __init__(self, geometry: CameraGeometry, landmarks: Sequence[FloorTag]) -> None:
        self.trusted, self.floor_seen = True, False
        n = len(landmarks)
        places = [(mark.x_m, mark.y_m, math.radians(mark.heading_deg), mark.height_m) for mark in landmarks]
        table = np.array(places, np.float64).reshape(n, 4)
        self._rows = {landmark.tag: row for row, landmark in enumerate(landmarks)}
        self._tags = [landmark.tag for landmark in landmarks]
        self._survey, self._points = table[:, :3].copy(), table[:, [0, 1, 3]].copy()
        self._calibrated = self.geometry = geometry
        self._sensitivity = sensitivity(geometry, self._points)
        self._state = np.zeros(6)  # what remains, since ``geometry``
        self._covariance: Array = np.zeros((6, 6))
        self._home = self._state, self._covariance  # before a knock that is not believed yet
        self._vibration: Array = _REST.copy()  # variances of what is new in an image
        self._shaken = np.zeros(6)  # what the newest image has of its own
        self._uncertainty: Array = np.zeros((6, 6))  # of that image's camera
        self._noise: Array = _LEAST_NOISE
        self._before = np.full((n, 3), np.nan)
        self._last = np.full((n, 3), np.nan)  # residuals of the image before
        self._learnt = np.zeros(n)  # sightings from which a landmark's own offset was learnt
        self._mean = np.zeros((n, 3))  # of them
        self._own = np.zeros((n, 3))  # what a landmark is off by itself
        self._own_variance = np.tile(_SURVEY**2, (n, 1))
        self._off = np.zeros(n, dtype=np.int64)  # images in which it disagreed: _OFF and more, it moved
        self._calm, self._lost, self._given_up = _CALM_IMAGES, 0, False
        self._worst = 0.0  # of a landmark since the camera is lost [m]
        self._reported = np.zeros((n, 2))  # corrections told last

    def update(self, sightings: Sequence[TagSighting]) -> tuple[CameraGeometry, tuple[Notice, ...]]:
        """Take one image's sightings of the landmarks, placed by ``geometry``.

        Returns the camera of this very image, and what happened.
        """
        before, residual = self.geometry, self._residuals(sightings)
        self._shaken, self._uncertainty = np.zeros(6), self._covariance + np.diag(self._vibration)
        voters = ~np.isnan(residual[:, 0]) & (self._off < _OFF_IMAGES)
        notices = self._follow_focus(residual, voters)
        offset = residual - self._own
        variance = self._noise**2 + self._own_variance
        self.floor_seen = bool(np.count_nonzero(voters))
        if not self.floor_seen:  # landmarks that moved themselves may lie where they were again
            surprise = offset - self._seen(self._state)
            agree = self._distance(surprise, variance, self._covariance + np.diag(self._vibration)) < 1.0
            return before, notices + self._blame(surprise, agree)
        if self._calm < _CALM_IMAGES and self._agrees(offset, variance, voters, *self._home):
            (self._state, self._covariance), self._calm = self._home, _CALM_IMAGES
        if self._agrees(offset, variance, voters, self._state, self._covariance):
            notices += self._followed(residual, offset, variance, voters)
        else:
            notices += self._knocked(offset, variance, voters)
        self._follow_noise(residual - self._seen(self._state + self._shaken), variance)
        if self._calm >= _CALM_IMAGES:
            notices += self._settled()
        camera = self._state + self._shaken
        if self._given_up or np.abs(self._seen(camera)[:, :2]).max() < _STALE_M:
            return self.geometry, notices
        return corrected(self.geometry, camera), notices

    def covariance(self, points: Array) -> Array:
        """Return the covariances (N, 3, 3) of x, y [m] and psi [rad] that the newest image's camera adds to those of
        tags at points (N, 3)."""
        return pose_covariance(self.geometry, points, self._uncertainty)

    def _follow_focus(self, residual: Array, voters: Flags) -> tuple[Notice, ...]:
        """Learn how much the focal length changes from image to image, if nothing else but vibration moved at least
        three landmarks."""
        moved, self._last = residual - self._last, residual
        both = voters & ~np.isnan(moved[:, 0])
        if np.count_nonzero(both) < 3:
            return ()
        variance = 2.0 * self._noise**2
        rows, moved = self._sensitivity.reshape(-1, 3, 6)[both], moved[both]
        weighted = (rows / variance[:, None]).reshape(-1, 6)
        prior = np.diag(1.0 / (2.0 * _FAST * self._vibration + _SLOW * _FOCUS))
        covariance = np.linalg.inv(weighted.T @ rows.reshape(-1, 6) + prior)
        change = covariance @ (weighted.T @ moved.ravel())
        if (((moved - rows @ change) ** 2 / variance).sum(1) > _STILL_GATE).any():
            return ()
        before, sure = self._vibration[5], change[5] ** 2 - _BREATHES * covariance[5, 5]
        self._vibration[5] = max(_REST[5], (1.0 - _VIBRATION_GAIN) * before, sure)
        if sure < _BEGINS * before:
            return ()
        self._covariance = self._covariance + np.diag(_SLOW * _FOCUS)
        fresh = self._learnt < _LEARNT_SIGHTINGS
        self._mean[fresh], self._own[fresh] = 0.0, 0.0
        self._own_variance[fresh], self._learnt[fresh] = _SURVEY**2, 0.0
        return (Notice(TrackerEvent.CAMERA_BREATHES, value=abs(float(change[5]))),)

    def _agrees(self, offset: Array, variance: Array, voters: Flags, state: Array, covariance: Array) -> bool:
        """Return whether half of the voters lie where a camera shows them."""
        agree = self._distance(offset - self._seen(state), variance, covariance + np.diag(self._vibration)) < 1.0
        return bool(2 * np.count_nonzero(agree & voters) >= np.count_nonzero(voters))

    def _followed(self, residual: Array, offset: Array, variance: Array, voters: Flags) -> tuple[Notice, ...]:
        """Follow a camera that is about where it was expected."""
        surprise = offset - self._seen(self._state)
        distance = self._distance(surprise, variance, self._covariance + np.diag(self._vibration))
        agree = distance < 1.0
        self._calm += 1
        happenings = self._blame(surprise, agree)
        known = agree & voters
        count = np.count_nonzero(known)
        if count >= 2:
            # Those that hardly agree count less. With fewer than three, what they do not show would wander by noise.
            weight = known / np.fmax(4.0 * distance, 1.0)
            prior = self._covariance + _WANDER if count >= 3 else self._covariance
            self._correct(surprise, variance, weight, prior + np.diag(_SLOW * self._vibration))
        if self._calm >= _CALM_IMAGES and self.trusted:
            self._learn(residual, agree)
        return happenings

    def _residuals(self, sightings: Sequence[TagSighting]) -> Array:
        """Return how far off (L, 3) the landmarks are seen; NaN for one that is not measured in this image."""
        placed, variances = np.full_like(self._survey, np.nan), []
        for tag, x, y, psi, _, coasted_ns, covariance in sightings:
            row = self._rows.get(tag)
            if row is not None and coasted_ns == 0:
                placed[row] = x, y, psi
                variances.append(covariance)
        if variances and np.isnan(self._last).all():  # the first ones
            xx, _, yy, _, _, turn = np.median(variances, axis=0)
            self._noise = np.minimum(np.maximum(np.sqrt([xx, yy, turn]), _LEAST_NOISE), _MOST_NOISE)
        residual = placed - self._survey
        residual[:, 2] -= math.tau * np.round(residual[:, 2] / math.tau)
        return residual

    def _seen(self, state: Array) -> Array:
        """Return how far off (..., L, 3) states (..., 6) show the landmarks."""
        return (state @ self._sensitivity.T).reshape(*state.shape[:-1], -1, 3)

    def _follow_noise(self, left: Array, variance: Array) -> None:
        """Adapt the noise to the median change of the residuals between images. A landmark's own offset, which is
        constant, cancels in it."""
        spread = (self._sensitivity @ self._uncertainty * self._sensitivity).sum(-1).reshape(-1, 3)
        free = variance / (variance + spread)
        left = np.where(free > _LEAST_FREE, left / np.sqrt(free), np.nan)
        change = np.abs(left - self._before)
        self._before = left
        seen = np.count_nonzero(~np.isnan(change), axis=0)
        below = (change < _MEDIAN * self._noise).sum(0)
        noise = self._noise * (1.0 + _NOISE_GAIN * np.where(seen > 0, 0.5 - below / np.maximum(seen, 1), 0.0))
        self._noise = np.minimum(np.maximum(noise, _LEAST_NOISE), _MOST_NOISE)

    def _distance(self, surprise: Array, variance: Array, covariance: Array) -> Array:
        """Return squared distances (..., L), 1 at the gate; surprises (..., L, 3), covariances (..., 6, 6)."""
        spread = (self._sensitivity @ covariance * self._sensitivity).sum(-1).reshape(*covariance.shape[:-2], -1, 3)
        distance: Array = (surprise * surprise / (variance + spread)).sum(-1)
        distance /= np.where(self._learnt > 0, _GATE, _SURVEY_GATE)
        return distance

    def _correct(self, surprise: Array, variance: Array, weight: Array, prior: Array) -> None:
        """Correct the drift, whose covariance is ``prior``, and estimate this image's vibration, from the landmarks of
        weight (L,) above 0."""
        surprise = np.where(weight[:, None] > 0, surprise, 0.0)
        weighted = self._sensitivity * (weight[:, None] / variance).reshape(-1, 1)
        information = weighted.T @ self._sensitivity
        both = prior + np.diag(_FAST * self._vibration)
        self._uncertainty = np.asarray(np.linalg.solve(_ONE + both @ information, both), np.float64)
        pull = weighted.T @ surprise.ravel()
        pull = pull - information @ (self._uncertainty @ pull)  # what the image says, by the inverse of both
        known = information - information @ self._uncertainty @ information
        self._shaken = _FAST * self._vibration * pull
        self._state = self._state + prior @ pull
        self._covariance = prior - prior @ known @ prior
        if self._calm >= _CALM_IMAGES:  # a step of expectation maximization
            grown = _FAST * self._vibration**2 * (pull**2 - np.diag(known))
            self._vibration = np.maximum(self._vibration + _VIBRATION_GAIN * grown, _REST)

    def _knocked(self, offset: Array, variance: Array, voters: Flags) -> tuple[Notice, ...]:
        """Try what most landmarks agree on; without it the state remains. It is believed when it is calm."""
        if self._calm >= _CALM_IMAGES:
            self._home = self._state, self._covariance
        self._calm = 0
        self._state, self._covariance = self._home
        voting = np.flatnonzero(voters)
        prior = self._covariance + _KNOCK
        self._uncertainty = prior + np.diag(self._vibration)
        explained = False
        if len(voting) >= 2:
            surprise = offset - self._seen(self._state)
            agree = voters & self._consensus(surprise, variance, voting, prior)
            explained = bool(2 * np.count_nonzero(agree) > len(voting))
            if explained:
                self._correct(surprise, variance, agree.astype(np.float64), prior)
                jump = self._state - self._home[0] + self._shaken
                most = _SHAKEN_MORE * self._vibration + _SHAKEN
                self._vibration = self._vibration + _FAST * np.minimum(jump**2, most)
        errors = np.hypot(offset[voting, 0], offset[voting, 1])
        error, bound = float(np.median(errors)), _BOUND_SHARE * self.geometry.position[2]
        self.trusted = self.trusted and error <= _TOLERATED_M
        self._worst = max(self._worst, float(errors.max()))
        self._lost = 0 if self.trusted and explained else self._lost + 1
        patience = _FAR_OFF_IMAGES if error > bound and len(voting) >= 2 else _LOST_IMAGES
        return self._give_up(self._worst) if self._lost >= patience else ()

    def _give_up(self, error: float) -> tuple[Notice, ...]:
        already, self._given_up, self.trusted = self._given_up, True, False
        return () if already else (Notice(TrackerEvent.CAMERA_MOVED, value=error),)

    def _consensus(self, surprise: Array, variance: Array, voting: NDArray[np.intp], prior: Array) -> Flags:
        """Return which landmarks (L,) agree with the pair of them that most agree with."""
        pairs = np.array(list(itertools.combinations(voting.tolist(), 2)))
        rows = self._sensitivity.reshape(-1, 3, 6)[voting]
        weighted = rows / variance[voting][:, :, None]
        information, score = np.zeros((len(variance), 6, 6)), np.zeros((len(variance), 6))
        information[voting] = weighted.transpose(0, 2, 1) @ rows
        score[voting] = (weighted * surprise[voting][:, :, None]).sum(1)
        covariance = np.linalg.solve(_ONE + prior @ information[pairs].sum(1), prior)
        state = (covariance @ score[pairs].sum(1)[:, :, None])[:, :, 0]
        distance = self._distance(surprise - self._seen(state), variance, covariance)
        best = np.minimum(distance[:, voting], 1.0).sum(1).argmin()
        agree: Flags = distance[best] < 1.0
        return agree

    def _blame(self, surprise: Array, agree: Flags) -> tuple[Notice, ...]:
        """Count how long a landmark has been elsewhere than the camera explains."""
        distance = np.hypot(surprise[:, 0], surprise[:, 1])
        elsewhere = ~agree & (distance > _REPORTED_M)
        if not np.count_nonzero(elsewhere) and not np.count_nonzero(self._off):
            return ()
        moved = self._off >= _OFF_IMAGES
        self._off = np.where(elsewhere, np.where(moved, _OFF_IMAGES + _BACK_AFTER_IMAGES, self._off + 1), self._off)
        self._off = np.where(agree, np.maximum(self._off - 1, 0), self._off)
        fresh = np.flatnonzero((self._off >= _OFF_IMAGES) & ~moved)
        self._off[fresh] = _OFF_IMAGES + _BACK_AFTER_IMAGES
        return tuple(Notice(TrackerEvent.TAG_JUMPED, self._tags[row], float(distance[row])) for row in fresh)

    def _learn(self, residual: Array, agree: Flags) -> None:
        """Learn what the landmarks are off by themselves, from more sightings the more the camera shakes."""
        shaking = (self._sensitivity**2 @ (_FAST * self._vibration)).reshape(-1, 3)
        variance = self._noise**2 + shaking
        patience = _LEARNT_SIGHTINGS * np.sqrt(variance / self._noise**2)[:, :2].max(1)
        fresh = agree & (self._learnt < patience)
        if not np.count_nonzero(fresh):
            return
        self._learnt[fresh] += 1.0
        count, variance, before = self._learnt[fresh, None], variance[fresh], self._own_variance[fresh]
        known = 1.0 / (1.0 / _SURVEY**2 + count / variance)
        # The first sightings' variance is not known then, but by what the camera's vibration turned out to be.
        settled = count > _LEARNT_SIGHTINGS
        known = np.where(settled, np.minimum(known, before), known)
        part = np.where(settled, known / variance, 1.0 / count)
        left = (residual - self._seen(self._state))[fresh]
        stretched = self._sensitivity[:, 5].reshape(-1, 3)[fresh]  # what a lens that breathes still explains
        breath = (stretched * left).sum() / ((stretched**2).sum() + self._noise[0] ** 2 / self._vibration[5])
        self._mean[fresh] += part * (left - breath * stretched - self._mean[fresh])
        self._own_variance[fresh] = known
        self._own[fresh] = self._mean[fresh] * (1.0 - known / _SURVEY**2)

    def _settled(self) -> tuple[Notice, ...]:
        """Take the camera for where it is now, if that differs, and within bounds."""
        self._lost, self._worst = 0, 0.0
        if self.trusted and np.abs(self._seen(self._state)[:, :2]).max() < _STALE_M:
            return ()
        geometry = corrected(self.geometry, self._state)
        points = self._points
        shift = self._calibrated.to_plane(geometry.project(points), points[:, 2]) - points[:, :2]
        largest = float(np.hypot(shift[:, 0], shift[:, 1]).max())
        if largest > _BOUND_SHARE * self._calibrated.position[2]:
            return self._give_up(largest)
        breathes = self._vibration[5] > _BEGINS * _REST[5]  # that is known already
        report = self._given_up or (not breathes and float(np.abs(shift - self._reported).max()) > _REPORTED_M)
        self.trusted, self._given_up = True, False
        self._last = self._last - self._seen(self._state)
        self.geometry, self._state = geometry, np.zeros(6)
        if not report:
            return ()
        self._reported = shift
        return (Notice(TrackerEvent.CAMERA_CORRECTED, value=largest),)

"""Holds white paper below saturation while the light changes: exposure time first, as long as motion allows, then gain.

The loop is slow and integrates in decibels. It begins when the brightest tag's white leaves a wide band around its aim
and ends in a narrow one; the brightest of some images counts, so lamps that flicker do not move it. A setting is judged
only when it has surely taken effect. Lowering is faster than raising, and fastest when white is saturated.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.cameras.light import Light
from robofleet.tracking.events import News, Notice, TrackerEvent
from robofleet.tracking.sources import CameraError, Exposure, ExposureLimits
from robofleet.tracking.tags.photometric import side_px
from robofleet.tracking.tags.targets import robot_targets

SATURATED = 250.0  # [grey levels] from here on a white is not known
_FAINT = 30.0  # contrast [grey levels]: with less, tags may be lost and are hardly found again
_DARK = 60.0  # light grey of an image without tags: white paper in it would be faint
_LEAST_CONTRAST = 40.0  # contrast of the faintest tag [grey levels], or middle grey: below it nothing is lowered
_BLIND_IMAGES = 30  # without a tag: then the whole image counts
_WHITE_BAND = (0.75, 1.1)  # of the aim: white may stay here
_WHITE_AIM = (0.9, 1.03)  # of the aim: white is brought here
_SETTLING_IMAGES = 6  # webcams take over a setting up to so many late
_WATCHED_IMAGES = 4  # images after these, of which the brightest counts when the light is to be raised
_RAISE_DB, _LOWER_DB, _SATURATED_DB = 0.42, -0.92, -1.94  # at most, at once: +5, -10 and -20 %
_EPS = 1e-6
_ROUNDING_SHARE = 0.01  # by a camera that tells another exposure than it was asked for


class ExposureController:
    """Decides, image by image, how a camera is to expose. Pure: no clock, no camera."""

    def __init__(self, white_gray: float, limits: ExposureLimits) -> None:
        """Take the aim for white paper [grey levels] and the limits, both of the camera and of the laboratory."""
        self._aim, self._limits = white_gray, limits
        self._exposure: Exposure | None = None  # of the newest image
        self._blind = 0  # images since the last tag
        self._images = 0  # with this exposure
        self._peak: Light | None = None  # the brightest since it settled
        self._correcting = 0  # 1: raising, -1: lowering
        self._trouble: TrackerEvent | None = None
        self._news = News()
        self.news = self._news.take

    def look(self, light: Light, exposure: Exposure) -> Exposure | None:
        """Take how bright an image is, and how it was exposed; return a new exposure, None: leave it."""
        if exposure != self._exposure:
            self._exposure, self._images, self._peak = exposure, 0, None
        self._images += 1
        self._blind = 0 if light.tags else self._blind + 1
        if self._images <= _SETTLING_IMAGES or 0 < self._blind < _BLIND_IMAGES:
            return None
        if (within := self._within(exposure)) != exposure:
            self._images = 0
            return within
        if self._peak is None or light.white > self._peak.white:
            self._peak = light
        watched = self._images >= _SETTLING_IMAGES + _WATCHED_IMAGES
        wanted_db = self._wanted_db(self._peak)
        if wanted_db > 0.0 and not watched:
            return None
        new = self._changed(exposure, wanted_db) if wanted_db else exposure
        if watched:
            self._judge(self._peak, stuck=new == exposure)
            self._images, self._peak = _SETTLING_IMAGES, None
        if new == exposure:
            return None
        self._images = 0
        return new

    def _within(self, exposure: Exposure) -> Exposure:
        """Return the limits' nearest exposure to one that is not within them, as the first one may be."""
        low, high = self._limits.shortest, self._limits.longest
        time_s, gain = (min(max(x, a), b) for x, a, b in zip(exposure, low, high, strict=True))
        near_time = abs(time_s - exposure.time_s) <= _ROUNDING_SHARE * time_s
        near_gain = abs(gain - exposure.gain) <= _ROUNDING_SHARE * abs(gain)
        return exposure if near_time and near_gain else Exposure(time_s, gain)

    def _wanted_db(self, light: Light) -> float:
        """Return the change of brightness that is wanted [dB]; 0 while white is inside its band."""
        share = light.white / self._aim
        low, high = _WHITE_BAND
        if self._correcting > 0:
            low = _WHITE_AIM[0]
        elif self._correcting < 0:
            high = _WHITE_AIM[1]
        raising, lowering = share < low, share > high and light.faintest >= _LEAST_CONTRAST
        self._correcting = 1 if raising else -1 if lowering else 0
        return 20.0 * math.log10(1.0 / max(share, 1e-3)) if raising or lowering else 0.0

    def _changed(self, exposure: Exposure, wanted_db: float) -> Exposure:
        """Return the exposure after one step; the same one where a limit or the camera's own steps allow no other."""
        least, most, step, gain_db = self._limits
        if wanted_db > 0.0:
            db = min(wanted_db, _RAISE_DB)
            now_s = exposure.time_s
            longer_s = _next(now_s, now_s * _ratio(db), now_s * _ratio(wanted_db), step.time_s)
            if (time_s := min(longer_s, most.time_s)) > now_s * (1.0 + _EPS):
                return exposure._replace(time_s=time_s)
            more = _next(exposure.gain, exposure.gain + db / gain_db, exposure.gain + wanted_db / gain_db, step.gain)
            return exposure._replace(gain=max(exposure.gain, min(more, most.gain)))
        saturated = self._peak is not None and self._peak.white >= SATURATED
        db = _SATURATED_DB if saturated else max(wanted_db, _LOWER_DB)
        gain = max(_floor(exposure.gain + db / gain_db, step.gain), least.gain)
        if gain < exposure.gain:
            return exposure._replace(gain=gain)
        time_s = max(_floor(exposure.time_s * _ratio(db), step.time_s), least.time_s)
        return exposure._replace(time_s=min(time_s, exposure.time_s))

    def _judge(self, light: Light, *, stuck: bool) -> None:
        """Say when the light is beyond what can be set, and when it no longer is."""
        trouble = None
        if stuck and light.white >= SATURATED:
            trouble = Notice(TrackerEvent.CAMERA_TOO_BRIGHT, value=light.white)
        elif stuck and light.white < _WHITE_BAND[0] * self._aim and light.clearest < (_FAINT if light.tags else _DARK):
            trouble = Notice(TrackerEvent.CAMERA_TOO_DARK, value=light.clearest)
        event = None if trouble is None else trouble.event
        if event is not self._trouble:
            self._news.add(trouble or Notice(TrackerEvent.CAMERA_LIGHT_GOOD, value=light.white))
        self._trouble = event


class Bound(NamedTuple):
    """The longest exposure that a configuration allows, and why."""

    time_s: float
    why: str


def longest_exposure(config: Config) -> Bound:
    """Return the longest exposure: by the blur of the fastest robot, and by the time that there is for an image."""
    camera = config.camera
    geometry, targets = CameraGeometry.from_model(camera.model), robot_targets(config)
    speeds = (target.max_speed * side_px(geometry, target) / target.side for target in targets)
    fastest = max([*speeds, _EPS])  # [px/s]
    blur = f"{camera.exposure.blur_px:g} px of motion blur at {fastest:.0f} px/s (camera.exposure.blur_px)"
    bounds = [Bound(camera.exposure.blur_px / fastest, blur)]
    if camera.trigger == "tick":
        free_s = 2.0 * (camera.trigger_lead_s - camera.readout_s)
        bounds.append(Bound(free_s, "twice the time from readout to tick (camera.trigger_lead_s)"))
    period_s = config.controller.tick_s if camera.trigger == "tick" else 1.0 / camera.rate_hz
    bounds.append(Bound(period_s - camera.readout_s, "the time between two images, without the readout"))
    return min(bounds)


def exposure_controller(config: Config, camera: ExposureLimits | None) -> ExposureController:
    """Return what holds white paper within a camera's limits and those of a configuration; CameraError if nothing is
    left of them, or if the camera has none: it cannot be adjusted."""
    if camera is None:
        raise CameraError("camera.exposure_control: this camera cannot be adjusted: set it to fixed")
    for where, why in nothing_left(config, camera):
        raise CameraError(f"{where}: {why}")
    return ExposureController(config.camera.exposure.white_gray, bounded(config, camera))


def nothing_left(config: Config, camera: ExposureLimits) -> Iterator[Complaint]:
    """Return why a camera's limits and those of a configuration exclude each other."""
    low, high = _gains(config, camera)
    if low > high:
        can = f"{camera.shortest.gain:g} to {camera.longest.gain:g}"
        yield "camera.exposure.gain", f"the camera has {can}: choose from these"
    bound = longest_exposure(config)
    if bound.time_s < camera.shortest.time_s:
        why = f"the camera exposes for {camera.shortest.time_s:g} s at least, and {bound.time_s:.2g} s is the longest"
        yield "camera.exposure_control", f"{why} by {bound.why}: allow more, or set it to fixed"


def bounded(config: Config, camera: ExposureLimits) -> ExposureLimits:
    bound, (low, high) = longest_exposure(config), _gains(config, camera)
    longest_s = _floor(min(bound.time_s, camera.longest.time_s), camera.step.time_s)
    return camera._replace(
        shortest=Exposure(camera.shortest.time_s, low), longest=Exposure(max(longest_s, camera.shortest.time_s), high)
    )


def _gains(config: Config, camera: ExposureLimits) -> tuple[float, float]:
    low, high = config.camera.exposure.gain or (camera.shortest.gain, camera.longest.gain)
    return max(low, camera.shortest.gain), min(high, camera.longest.gain)


def _ratio(db: float) -> float:
    return float(10.0 ** (db / 20.0))


def _floor(value: float, step: float) -> float:
    """Return the next possible setting that is not greater."""
    return math.floor(value / step + _EPS) * step if step else value


def _next(now: float, wanted: float, furthest: float, step: float) -> float:
    """Return the possible setting up to a wanted one; one step more than now, where that is less, if it may go so
    far."""
    following = now + step
    return max(_floor(wanted, step), following if following <= furthest + _EPS * step else now)

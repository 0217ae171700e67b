"""What can happen to a camera and to a tag, by name."""

from enum import IntEnum
from typing import NamedTuple

from robofleet.core.clock import S

NO_TAG = 0xFFFF
_REPEAT_NS = S


class TrackerEvent(IntEnum):
    """Sent in ``TrackerNews``; the comment says what its ``value`` is."""

    TAG_FOUND = 1  # seconds since it was seen last; 0: for the first time
    TAG_LOST = 2  # seconds for which it was predicted
    TAG_TWICE = 3  # two prints of one id: distance between them [m]
    TAG_JUMPED = 4  # further than its robot can drive: distance [m]
    TAG_MISTAKEN = 5  # another id stands where this one was expected: the other id
    TAG_CARRIED = 6  # a jump that stayed, of a kidnapped robot: believed at last; distance [m]
    PRINT_STRETCHED = 7  # its forward over its left, beyond a square [share]; what the heading is, allows for it
    TAG_BOWED = 8  # its ends over its middle [m]; its pose allows for it
    TAG_SIZE = 9  # it appears larger: so much higher than configured it lies, if its side is right [m]
    CAMERA_STALLED = 10  # no image: seconds
    CAMERA_FROZEN = 11  # the same picture again: how many times
    CAMERA_UNPLUGGED = 12  # 0
    CAMERA_RESIZED = 13  # an image of another size: its width [px]
    CAMERA_STRANGE = 14  # not the camera that was calibrated: 0
    CAMERA_ENDED = 15  # no more images in the file: how many there were
    CAMERA_BACK = 16  # good images again: seconds without
    CLOCK_JUMPED = 17  # of the camera, whose stamps are corrected from now on: seconds ahead; less than 0: back
    CAMERA_MOVED = 20  # out of its calibration, beyond what is corrected: largest error of a floor tag [m]
    CAMERA_CORRECTED = 21  # out of its calibration, and corrected: largest error of a floor tag before [m]
    CAMERA_TOO_DARK = 22  # at the limits of exposure and gain: contrast of the tags, or the image's light grey
    CAMERA_TOO_BRIGHT = 23  # white paper is saturated, at the limits of exposure and gain: its grey level
    CAMERA_LIGHT_GOOD = 24  # neither any more: grey level of white paper
    CAMERA_DENOISES = 25  # over time, so that what moves lags, and it is corrected: share of the image before
    CAMERA_BREATHES = 26  # its focal length changes, and is corrected: share of it, from an image to the next
    CAMERA_BLUR = 27  # it changed: now, a standard deviation in the image's middle [px]
    CAMERA_DISAGREES = 30  # with the others, that see the same robots elsewhere: how far [m]; its poses are not used
    CAMERA_AGREES = 31  # with the others again: how far they are apart now [m]
    POSES_SILENT = 32  # nothing from a source that is no camera: seconds
    POSES_BACK = 33  # poses again: seconds without
    BODY_LOST = 34  # the motion capture does not track it: seconds
    BODY_FOUND = 35  # seconds since it was tracked last
    TAG_HEIGHT = 36  # by two cameras: so much higher than configured it lies [m]


class Notice(NamedTuple):
    """One event.

    Attributes:
        event: What happened.
        tag: The tag that it is about. ``NO_TAG``: none.
        value: As the event's comment says.
    """

    event: TrackerEvent
    tag: int = NO_TAG
    value: float = 0.0


_SENTENCES = {
    TrackerEvent.TAG_FOUND: "tag {tag} found",
    TrackerEvent.TAG_LOST: "tag {tag} lost: hidden for {value:.1f} s",
    TrackerEvent.TAG_TWICE: "tag {tag} seen twice, {value:.2f} m apart: take one away",
    TrackerEvent.TAG_JUMPED: "tag {tag} seen {value:.2f} m from where it can be: refused",
    TrackerEvent.TAG_MISTAKEN: "tag {value:.0f} stands where tag {tag} should be: refused",
    TrackerEvent.TAG_CARRIED: "tag {tag} was carried {value:.2f} m",
    TrackerEvent.PRINT_STRETCHED: "tag {tag}: its print is {value:+.2%} longer forward than to its left; allowed for",
    TrackerEvent.TAG_BOWED: "tag {tag} is bowed, its ends {value:+.4f} m above its middle; allowed for",
    TrackerEvent.TAG_SIZE: "tag {tag} appears as if it lay {value:+.4f} m higher than configured: measure its height "
    "and its side",
    TrackerEvent.CAMERA_STALLED: "camera stalled: no image for {value:.2f} s",
    TrackerEvent.CAMERA_FROZEN: "camera frozen: the same picture, or an old or impossible stamp, {value:.0f} times",
    TrackerEvent.CAMERA_UNPLUGGED: "camera unplugged",
    TrackerEvent.CAMERA_RESIZED: "camera sends images of another size: {value:.0f} px wide",
    TrackerEvent.CAMERA_STRANGE: "not the camera that was calibrated: no poses",
    TrackerEvent.CAMERA_ENDED: "no more images after {value:.0f}",
    TrackerEvent.CAMERA_BACK: "camera back after {value:.1f} s",
    TrackerEvent.CLOCK_JUMPED: "the camera's clock jumped by {value:+.3f} s: corrected",
    TrackerEvent.CAMERA_MOVED: "camera moved, floor tags {value:.3f} m off: no poses; calibrate again",
    TrackerEvent.CAMERA_CORRECTED: "camera moved, floor tags {value:.4f} m off: corrected",
    TrackerEvent.CAMERA_TOO_DARK: "too dark for the camera: {value:.0f} grey levels at its limits; switch a lamp on",
    TrackerEvent.CAMERA_TOO_BRIGHT: "too bright for the camera: white paper is at {value:.0f}; shade the arena",
    TrackerEvent.CAMERA_LIGHT_GOOD: "the camera's light is good again: white paper is at {value:.0f}",
    TrackerEvent.CAMERA_DENOISES: "camera mixes {value:.0%} of the image before into each image: corrected, with more "
    "noise; switch its temporal noise reduction off",
    TrackerEvent.CAMERA_BREATHES: "camera's focal length changes by {value:.2%} from one image to the next: corrected; "
    "switch its autofocus off",
    TrackerEvent.CAMERA_BLUR: "camera's blur changed to {value:.2f} px: was its lens touched? If so, "
    "calibrate it again",
    TrackerEvent.CAMERA_DISAGREES: "camera sees robots {value:.4f} m from where others do, was it knocked? "
    "Its poses are not used until it agrees again; calibrate its place",
    TrackerEvent.CAMERA_AGREES: "camera agrees with the others again, to {value:.4f} m",
    TrackerEvent.POSES_SILENT: "no poses for {value:.2f} s: their source is silent",
    TrackerEvent.POSES_BACK: "poses again after {value:.2f} s",
    TrackerEvent.BODY_LOST: "body {tag} is not tracked for {value:.2f} s",
    TrackerEvent.BODY_FOUND: "body {tag} is tracked again after {value:.2f} s",
    TrackerEvent.TAG_HEIGHT: "tag {tag} lies {value:+.4f} m higher than configured: correct its tag_height_m",
}

_CAMERA = "camera "


def describe(event: int, tag: int, value: float, camera: str = "") -> str:
    """Return what happened in a sentence; a number for an event of another version.

    ``camera``: the name of the one that saw it, where there are several.
    """
    sentence = {int(known): text for known, text in _SENTENCES.items()}.get(event, f"event {event}")
    if camera:
        own = sentence.startswith(_CAMERA)
        sentence = f"{_CAMERA}{camera} {sentence.removeprefix(_CAMERA)}" if own else f"camera {camera}: {sentence}"
    return sentence.format(tag=tag, value=value)


class News:
    """Collects what happens; the same event of the same tag is told once a second."""

    def __init__(self) -> None:
        self._happenings: list[Notice] = []
        self._reported_ns: dict[tuple[TrackerEvent, int], int] = {}

    def say(self, event: TrackerEvent, tag: int, value: float, now_ns: int) -> None:
        reported_ns = self._reported_ns.get((event, tag))
        if reported_ns is None or now_ns - reported_ns >= _REPEAT_NS:
            self._reported_ns[event, tag] = now_ns
            self._happenings.append(Notice(event, tag, float(value)))

    def add(self, notice: Notice) -> None:
        """Add what happens once."""
        self._happenings.append(notice)

    def take(self) -> tuple[Notice, ...]:
        taken, self._happenings = tuple(self._happenings), []
        return taken

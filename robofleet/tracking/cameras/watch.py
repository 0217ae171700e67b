"""Detects faults of a camera, image by image, and names them.

A fault is reported once when it begins, and once more, as CAMERA_BACK, when a good image ends it.

A camera's clock may jump: its stamps go back, or run ahead of now. Images with such stamps are not believed; when some
in a row agree on how far it jumped, they are put on this host's clock by the delay that images had before. So for all
who take poses time goes on. A stamp that is old is believed: images that come late are old, and count as that.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import MS, S
from robofleet.tracking.events import News, Notice, TrackerEvent

_STALLED_PERIODS = 5
_STALLED_NS = 250 * MS  # at least: a robot is lost without poses for half a second
_FIRST_IMAGE_NS = 3 * S  # within which a camera that was just opened gives it
_FROZEN_REPEATS = 3  # one may be a driver that hands a buffer out twice
_MOST_AHEAD_NS = 100 * MS  # a stamp, of now
_JUMPED_IMAGES = 3  # in a row, that agree on a jump of the clock
_DELAY_IMAGES = 64  # the least delay of them is what one needs to come
_SAMPLED_ROWS = 64  # one of so many is compared: a few microseconds


class CameraWatch:
    """Watches one camera. ``now_ns`` never goes back."""

    def __init__(self, size: tuple[int, int], period_ns: int, noisy: bool, now_ns: int) -> None:
        """Take the images' (width, height), their period, and whether noise makes two equal ones impossible."""
        self._shape = size[::-1]
        self._period_ns = period_ns
        self._patience_ns = max(_STALLED_PERIODS * period_ns, _STALLED_NS)
        self._noisy = noisy
        self._last: bytes | None = None  # of the newest image's pixels
        self.exposed_ns: int | None = None  # mid-exposure of the newest image that was believed [this host's clock]
        self._ahead_ns = 0  # of the camera's clock, since it jumped
        self._delays_ns: deque[int] = deque(maxlen=_DELAY_IMAGES)  # of those that were believed
        self._apart_ns: deque[int] = deque(maxlen=_JUMPED_IMAGES)  # now minus stamp, of those that cannot be right
        self._repeats = 0
        self._images = 0
        self._good_ns = now_ns  # when the newest good image came
        # When ``wait`` will have something to say [ns]; None: not before an image comes.
        self.deadline_ns: int | None = now_ns + _FIRST_IMAGE_NS
        self._waiting_since_ns = now_ns
        self._lost = False
        self._reported: set[TrackerEvent] = set()  # since all was well
        self._news = News()
        self.news = self._news.take

    def look(self, image: NDArray[np.uint8], exposure_ns: int, now_ns: int) -> bool:
        """Return whether an image that came just now can be believed; ``exposed_ns`` tells then when it was exposed.

        exposure_ns: mid-exposure, as the camera's driver stamped it [this host's clock, as long as it does not jump].
        """
        self._images += 1
        self._waiting_since_ns, self.deadline_ns = now_ns, now_ns + self._patience_ns
        self._lost = False
        if np.shape(image) != self._shape or image.dtype != np.uint8:
            self._say(TrackerEvent.CAMERA_RESIZED, float(np.shape(image)[1]) if np.ndim(image) > 1 else 0.0)
            return False
        possible = not self._seen_before(image) and self._timed(exposure_ns, now_ns)
        if not possible:
            self._repeats += 1
            if self._repeats >= _FROZEN_REPEATS:
                self._say(TrackerEvent.CAMERA_FROZEN, self._repeats)
            return False
        self._repeats = 0
        if self._reported:
            self._news.add(Notice(TrackerEvent.CAMERA_BACK, value=(now_ns - self._good_ns) / S))
            self._reported.clear()
        self._good_ns = now_ns
        return True

    def wait(self, now_ns: int, *, expected: bool) -> None:
        """Note that no image came; ``expected``: nothing keeps the camera from giving one."""
        if self._lost:
            return
        if not expected:
            self._waiting_since_ns, self.deadline_ns = now_ns, None
        elif self.deadline_ns is None:
            self.deadline_ns = self._waiting_since_ns + self._patience_ns
        if self.deadline_ns is not None and now_ns >= self.deadline_ns:
            self.deadline_ns = None
            self._say(TrackerEvent.CAMERA_STALLED, (now_ns - self._waiting_since_ns) / S)

    def lose(self, event: TrackerEvent) -> None:
        """Note that the camera ended, is unplugged or is another one."""
        self._lost, self.deadline_ns = True, None
        self._say(event, self._images if event is TrackerEvent.CAMERA_ENDED else 0.0)

    def _timed(self, exposure_ns: int, now_ns: int) -> bool:
        """Return whether a stamp can be right, as it is or because the camera's clock jumped, and take it."""
        stamp_ns = exposure_ns - self._ahead_ns
        early = self.exposed_ns is not None and stamp_ns <= self.exposed_ns
        if early or stamp_ns > now_ns + _MOST_AHEAD_NS:
            if not self._jumped(now_ns - exposure_ns):
                return False
            stamp_ns = exposure_ns - self._ahead_ns
        self._apart_ns.clear()
        self._delays_ns.append(now_ns - stamp_ns)
        self.exposed_ns = stamp_ns
        return True

    def _jumped(self, apart_ns: int) -> bool:
        """Return whether images in a row agree that the camera's clock jumped; then its stamps are corrected."""
        self._apart_ns.append(apart_ns)
        least_ns = min(self._apart_ns)
        agree = len(self._apart_ns) == _JUMPED_IMAGES and max(self._apart_ns) - least_ns < self._period_ns // 2
        if not agree or not self._delays_ns:
            return False
        before_ns, self._ahead_ns = self._ahead_ns, min(self._delays_ns) - least_ns
        self._news.add(Notice(TrackerEvent.CLOCK_JUMPED, value=(self._ahead_ns - before_ns) / S))
        return True

    def _seen_before(self, image: NDArray[np.uint8]) -> bool:
        """Return whether these are the last image's pixels again."""
        rows = image[len(image) % _SAMPLED_ROWS // 2 :: _SAMPLED_ROWS].tobytes()
        last, self._last = self._last, rows
        return self._noisy and rows == last

    def _say(self, event: TrackerEvent, value: float) -> None:
        if event not in self._reported:
            self._reported.add(event)
            self._news.add(Notice(event, value=float(value)))

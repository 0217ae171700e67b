"""The pictures that a tracker shows of what its camera sees: seldom, or a few a second while somebody looks."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.keys import PICTURE, SAFE_REQUEST
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.bus.messages import Picture
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.core.patterns import TRACKER, tracker_role
from robofleet.tracking.pictures import jpeg

REQUESTED = b"pictures"
_PICTURE_PERIOD_NS = S // 5  # after a request
_REQUEST_HOLDS_NS = 2 * S  # who looks asks again


class _Shot(NamedTuple):
    image: NDArray[np.uint8]
    exposure_ns: int


class Pictures:
    """Chooses the images that are shown, and publishes them when nothing else is to do."""

    def __init__(self, config: Config, bus: Bus, clock: Clock, wake: Wake, epoch: int) -> None:
        camera = config.camera
        tracker = TRACKER if len(config.views) == 1 else tracker_role(camera.name)
        self._size = camera.width, camera.height
        self._period_ns = round(S / camera.picture_rate_hz) if camera.picture_rate_hz else None
        self._refusal = ""
        if config.tracker.source != "camera":
            self._refusal = "refused: there are no pictures, tracker.source is not camera"
        elif self._period_ns is None:
            self._refusal = "refused: camera.picture_rate_hz is 0, so there are no pictures"
        self._publish = bus.publisher(PICTURE, camera.name)
        self._request = bus.serve(SAFE_REQUEST, tracker, wake)
        self._clock, self._epoch = clock, epoch
        self._seq = 0
        self._newest_ns: int | None = None  # exposure of the picture chosen last
        self._requested_until_ns = 0
        self._shot: _Shot | None = None

    @property
    def waits(self) -> bool:
        return self._shot is not None

    def answer(self, now_ns: int) -> None:
        while (request := self._request()) is not None:
            if request.payload != REQUESTED:
                request.reply(f"refused: {request.payload!r} is not {REQUESTED.decode()}".encode())
            elif self._refusal:
                request.reply(self._refusal.encode())
            else:
                self._requested_until_ns = now_ns + _REQUEST_HOLDS_NS
                request.reply(b"ok")

    def offer(self, image: NDArray[np.uint8] | None, exposure_ns: int, now_ns: int) -> None:
        """Take an image, if it is time for one; it is left as it is until ``publish``, or until the next one."""
        if image is None or self._period_ns is None:
            return
        period_ns = min(self._period_ns, _PICTURE_PERIOD_NS) if now_ns < self._requested_until_ns else self._period_ns
        # Counted in whole periods, the mean rate is kept although images come when they like.
        if self.waits or self._newest_ns is None or exposure_ns // period_ns != self._newest_ns // period_ns:
            self._shot = _Shot(image, exposure_ns)
            self._newest_ns = exposure_ns

    def publish(self) -> None:
        shot, self._shot = self._shot, None
        if shot is not None:
            self._seq += 1
            picture = Picture(self._epoch, self._seq, shot.exposure_ns, *self._size, jpeg(shot.image))
            self._publish(PICTURE_LAYOUT.encode(picture))

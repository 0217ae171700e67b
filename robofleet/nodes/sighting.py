"""What the controller makes of its cameras' images: each measured pose goes to the filter, at its own mid-exposure."""

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus
from robofleet.bus.keys import NEWS, POSES
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TrackerNews
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, TickGrid
from robofleet.tracking import measured
from robofleet.tracking.agreement import Agreement, Verdict
from robofleet.tracking.bystanders import Bystanders
from robofleet.tracking.estimator import FleetFilter
from robofleet.tracking.events import NO_TAG, TrackerEvent
from robofleet.tracking.joined import Joined, Seen
from robofleet.tracking.targets import floor_tags_in_view

Array = NDArray[np.float64]
Instants = NDArray[np.int64]

_STALE_TICKS = 15  # poses that echo an older tick come from a network that stood still


class MeasurementUpdate:
    """The newest image of every camera, once a tick. It owns the filter and the bystanders while it is asked.

    Where there are several cameras, it says of each whether it agrees with the others.
    """

    def __init__(self, config: Config, bus: Bus, clock: Clock, epoch: int) -> None:
        self._config, self._clock, self._epoch = config, clock, epoch
        self._rows = measured.rows_of({robot.tag: row for row, robot in enumerate(config.bodies)})
        self._bodies, self._members = len(config.bodies), len(config.members)
        self._images = [bus.newest(POSES, name) for name in config.camera_names]
        self._single = np.empty((self._bodies, measured.COLUMNS)), np.empty(self._bodies, dtype=np.int64)
        self._news = [bus.publisher(NEWS, name) for name in config.camera_names]
        self._used = 0

    def begin(self, fleet_filter: FleetFilter, bystanders: Bystanders) -> None:
        """Start anew with this filter and these bystanders."""
        self._filter, self._bystanders = fleet_filter, bystanders
        self.taken = [(0, 0)] * len(self._images)  # epoch and seq of the newest poses of each camera
        self.exposure_ns = 0  # of the newest image used [tracker's clock]
        self._joined = Joined(fleet_filter, self._believed)
        self._agreement = _agreement(self._config) if len(self._images) > 1 else None

    @property
    def named(self) -> bytes:
        """Epoch and number of the newest image of each camera but the first, for a tick."""
        return np.array(self.taken[1:], np.float64).tobytes() if len(self.taken) > 1 else b""

    def read(self, index: int, grid: TickGrid) -> Instants | None:
        """Correct the filter by what came since the tick before; returns what ``FleetFilter.observe`` does, None
        without any."""
        if self._agreement is None:
            seen = self._next(0, index, grid, *self._single)
            if seen is None:
                return None
            n = self._members
            used = self._filter.observe(seen.instants_ns[:n], seen.poses[:n])
            self._watch_bystanders(seen)
            return used
        images = [self._next(k, index, grid) for k in range(len(self._images))]
        return self._read_several(self._agreement, [seen for seen in images if seen is not None])

    def _read_several(self, agreement: Agreement, images: list[Seen]) -> Instants | None:
        n = self._members
        used = self._joined.observe([Seen(k, poses[:n], instants_ns[:n]) for k, poses, instants_ns in images])
        believed = [seen for seen in images if agreement.believed[seen.camera]]
        for seen in sorted(believed, key=lambda seen: seen.exposed_ns):
            self._watch_bystanders(seen)
        return used if believed else None

    def _believed(self, seen: Seen, expected: Array) -> bool:
        """Return whether an image's camera is believed, and say where that changes."""
        assert self._agreement is not None
        if (verdict := self._agreement.look(seen, expected)) is not None:
            self._say(verdict)
        return bool(self._agreement.believed[seen.camera])

    def _next(
        self, camera: int, index: int, grid: TickGrid, poses: Array | None = None, instants_ns: Instants | None = None
    ) -> Seen | None:
        """Return a camera's newest image, if it can be used; it is written into arrays of all bodies."""
        payload = self._images[camera].take()
        if payload is None or (message := FLEET_POSES.view(payload)) is None:
            return None
        image, image_poses = message
        self.taken[camera] = image.epoch, image.seq
        if not 0 <= index - image.echo_tick <= _STALE_TICKS or not image.echo_tick:
            return None
        exposure_ns, latest_ns = _exposure(image, grid), grid.instant(index + 1)
        if exposure_ns > latest_ns:  # impossible, and the filter would be blind until then
            return None
        if poses is None or instants_ns is None:
            poses, instants_ns = np.empty((self._bodies, measured.COLUMNS)), np.empty(self._bodies, dtype=np.int64)
        measured.placed(image_poses, self._rows, exposure_ns, latest_ns, poses, instants_ns)
        self.exposure_ns = max(self.exposure_ns, image.exposure_ns) if len(self._images) > 1 else image.exposure_ns
        return Seen(camera, poses, instants_ns)

    def _watch_bystanders(self, seen: Seen) -> None:
        if self._bodies > self._members:
            poses = np.ascontiguousarray(seen.poses[self._members :, :3])
            self._bystanders.observe(seen.instants_ns[self._members :], poses)

    def _say(self, verdict: Verdict) -> None:
        self._used += 1
        event = TrackerEvent.CAMERA_AGREES if verdict.believed else TrackerEvent.CAMERA_DISAGREES
        news = TrackerNews(self._epoch, self._used, self._clock.now_ns(), event, NO_TAG, verdict.apart)
        self._news[verdict.camera](TRACKER_NEWS.encode(news))


def _exposure(message: FleetPoses, grid: TickGrid) -> int:
    """Mid-exposure on the controller's clock: the tracker says how long after which tick it was."""
    return grid.instant(message.echo_tick) + message.since_tick_ns


def _agreement(config: Config) -> Agreement:
    """Return what judges the cameras, by the robots that they can see."""
    real = np.array([robot.reality == "real" for robot in config.members])
    fixed = np.array([bool(floor_tags_in_view(view)) for view in config.views])
    return Agreement(real, config.controller.filter.position_noise_m, fixed)

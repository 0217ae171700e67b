"""Where the controller takes the fleet to be: each measured pose goes to the filter, at its own mid-exposure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus
from robofleet.bus.keys import NEWS, POSES
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS, FleetPoses, TrackerNews
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, TickGrid
from robofleet.nodes import fleet
from robofleet.tracking.events import Notice, TrackerEvent
from robofleet.tracking.filter.agreement import Agreement
from robofleet.tracking.filter.estimator import COLUMNS, ages, measurements, rows_of
from robofleet.tracking.filter.joined import Joined, Seen
from robofleet.tracking.filter.parallax import Parallax
from robofleet.tracking.tags.targets import floor_tags_in_view

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Instants = NDArray[np.int64]

_STALE_TICKS = 15  # poses that echo an older tick come from a network that stood still


@dataclass(kw_only=True, slots=True)  # frozen it would take a microsecond more of each tick
class Prediction:
    """Of a tick: N members first, then the bystanders, M bodies in all; poses: x, y [m], psi [rad; world]."""

    now: Array  # (N, 3) poses at the tick
    poses: Array  # (M, 3) when the tick's commands act
    turning: Array  # (M, 2) the wheels' speeds then, as modelled [rad/s]; 0 of bystanders
    pushed: Array | None  # (M, 2) velocities of the bystanders [m/s; world], 0 of members; None: there are none
    unseen_s: Array  # (M,) age of the newest image used; infinite: never seen
    lost: Flags  # (N,) who was not seen for too long
    disturbance: Array  # (N, 2) velocities of the points ahead beyond what was asked [m/s; world]


class FleetEstimate:
    """The filter of the members, and the bystanders: corrected by the newest image of every camera, once a tick.

    Where there are several cameras, it says of each whether it agrees with the others.
    """

    def __init__(self, config: Config, bus: Bus, clock: Clock, epoch: int) -> None:
        self._config, self._clock, self._epoch = config, clock, epoch
        self._rows = rows_of({robot.tag: row for row, robot in enumerate(config.bodies)})
        self._bodies, self._members = len(config.bodies), len(config.members)
        self._images = [bus.newest(POSES, name) for name in config.camera_names]
        self._single = np.empty((self._bodies, COLUMNS)), np.empty(self._bodies, dtype=np.int64)
        self._news = [bus.publisher(NEWS, name) for name in config.camera_names]
        self._seq = 0  # of the newest news
        c = config.controller
        self._point_ahead_m, self._offset_free = c.point_ahead_m, c.disturbance == "estimated"
        self._lost_after_s = c.filter.lost_after_s
        self._undisturbed = np.zeros((self._members, 2))

    def begin(self) -> None:
        """Know nothing of the fleet."""
        self._filter, self._bystanders = fleet.fleet_filter(self._config), fleet.bystanders(self._config)
        self.taken = [(0, 0)] * len(self._images)  # epoch and seq of the newest poses of each camera
        self.exposure_ns = 0  # of the newest image used [tracker's clock]
        self._joined = Joined(self._filter, self._believed)
        self._parallax = Parallax.of(self._config)
        self._agreement = _agreement(self._config, self._parallax) if len(self._images) > 1 else None

    @property
    def named(self) -> bytes:
        """Epoch and number of the newest image of each camera but the first, for a tick."""
        return np.array(self.taken[1:], np.float64).tobytes() if len(self.taken) > 1 else b""

    def measure(self, index: int, grid: TickGrid) -> Instants | None:
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

    def predict(self, tick_ns: int) -> Prediction:
        """Return where everybody is at a tick, and when the tick's commands act."""
        now, poses, turning = self._filter.predict(tick_ns)
        unseen_s = ages(self._filter.measured_ns, tick_ns)
        lost = unseen_s > self._lost_after_s
        w = self._filter.disturbance(poses, self._point_ahead_m) if self._offset_free else self._undisturbed
        pushed = None
        if self._bodies > self._members:
            others = self._bystanders
            still = np.zeros_like(others.velocities)
            poses = np.concatenate([poses, others.predict(tick_ns)])
            pushed = np.concatenate([np.zeros_like(turning), others.velocities])
            turning = np.concatenate([turning, still])
            unseen_s = np.concatenate([unseen_s, ages(others.measured_ns, tick_ns)])
        return Prediction(
            now=now, poses=poses, turning=turning, pushed=pushed, unseen_s=unseen_s, lost=lost, disturbance=w
        )

    def command(self, tick_ns: int, wheels: Array) -> None:
        """Remember a tick's commands (N, 2) [rad/s]: by them the next tick predicts."""
        self._filter.command(tick_ns, wheels)

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
            event = TrackerEvent.CAMERA_AGREES if verdict.believed else TrackerEvent.CAMERA_DISAGREES
            self._say(verdict.camera, Notice(event, value=verdict.apart))
        for row, higher in self._parallax.news():
            self._say(seen.camera, Notice(TrackerEvent.TAG_HEIGHT, self._config.members[row].tag, higher))
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
            poses, instants_ns = np.empty((self._bodies, COLUMNS)), np.empty(self._bodies, dtype=np.int64)
        measurements(image_poses, self._rows, exposure_ns, latest_ns, poses, instants_ns)
        self.exposure_ns = max(self.exposure_ns, image.exposure_ns) if len(self._images) > 1 else image.exposure_ns
        return Seen(camera, poses, instants_ns)

    def _watch_bystanders(self, seen: Seen) -> None:
        if self._bodies > self._members:
            poses = np.ascontiguousarray(seen.poses[self._members :, :3])
            self._bystanders.observe(seen.instants_ns[self._members :], poses)

    def _say(self, camera: int, notice: Notice) -> None:
        self._seq += 1
        self._news[camera](TRACKER_NEWS.encode(TrackerNews(self._epoch, self._seq, self._clock.now_ns(), *notice)))


def _exposure(message: FleetPoses, grid: TickGrid) -> int:
    """Mid-exposure on the controller's clock: the tracker says how long after which tick it was."""
    return grid.instant(message.echo_tick) + message.since_tick_ns


def _agreement(config: Config, parallax: Parallax) -> Agreement:
    """Return what judges the cameras, by the robots that they can see."""
    real = np.array([robot.reality == "real" for robot in config.members])
    fixed = np.array([bool(floor_tags_in_view(view)) for view in config.views])
    return Agreement(real, config.controller.filter.position_noise_m, fixed, parallax)

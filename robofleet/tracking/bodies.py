"""From the bodies of a motion capture to the robots' poses: by name, from six degrees of freedom to the plane."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from robofleet.bus.messages import TagPose
from robofleet.config.calibrated import TagOffset
from robofleet.config.mocap import MocapSettings
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.tracking.events import News, Notice, TrackerEvent
from robofleet.tracking.offset import centre_from_tag

_LOST_AFTER_NS = 100 * MS  # without a pose
_MOST_REPEATS = 5  # of one pose, bit by bit, in a row: a measured one has noise
_LEAST_LENGTH = 0.5  # of a quaternion: 1, but for rounding; 0: no pose


class Body(NamedTuple):
    """A body as a system gives it: position in the system's unit and axes, and the quaternion of its rotation."""

    x: float
    y: float
    z: float
    qx: float
    qy: float
    qz: float
    qw: float


def planar(body: Body, settings: MocapSettings) -> tuple[float, float, float] | None:
    """Return a body's x, y [m] and heading in (-pi, pi] [world frame]; None if it has no pose.

    A body's x axis points forward (REP 103): its heading is that of this axis, seen from above.
    """
    length = math.hypot(body.qx, body.qy, body.qz, body.qw)
    if not (math.isfinite(sum(body)) and length > _LEAST_LENGTH):
        return None
    x, y, z, w = (q / length for q in body[3:])
    ahead = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)  # the body's x axis
    if settings.up == "y":  # y up, z to the right of x
        here, forward = (body.x, -body.z), (ahead[0], -ahead[2])
    else:
        here, forward = (body.x, body.y), (ahead[0], ahead[1])
    if math.hypot(*forward) < _LEAST_LENGTH:
        return None  # it stands on end
    origin, unit = settings.origin, settings.unit_m
    c, s = math.cos(origin.psi), math.sin(origin.psi)
    psi = math.remainder(math.atan2(forward[1], forward[0]) + origin.psi, math.tau)
    turned = c * here[0] - s * here[1], s * here[0] + c * here[1]
    return origin.x_m + unit * turned[0], origin.y_m + unit * turned[1], psi


class _Seen:
    """What is remembered of one robot's body."""

    def __init__(self, tag: int, offset: TagOffset) -> None:
        self.tag, self.offset = tag, offset
        self.last: Body | None = None
        self.repeats = 0
        self.tracked_ns: int | None = None
        self.lost = False


class FleetBodies:
    """Knows a fleet's bodies by their names, and tells which are lost and found."""

    def __init__(self, config: Config) -> None:
        self._settings = settings = config.tracker.mocap
        self._seen = {robot.body_name: _Seen(robot.tag, robot.tag_offset) for robot in config.seen}
        self._others = frozenset(settings.others)
        self._noisy = settings.position_sigma_m > 0
        across, turned = settings.position_sigma_m**2, settings.heading_sigma_rad**2
        known = across > 0 and turned > 0
        self._covariance = (across, 0.0, across, 0.0, 0.0, turned) if known else ()
        self._news = News()
        self.news = self._news.take

    def poses(self, bodies: Mapping[str, Body], instant_ns: int) -> tuple[tuple[TagPose, ...], int]:
        """Return the robots' poses of one frame, and how many bodies are nobody's."""
        found = []
        for name, seen in self._seen.items():
            body = bodies.get(name)
            pose = planar(body, self._settings) if body is not None and self._moves(seen, body) else None
            if pose is None:
                self._miss(seen, instant_ns)
                continue
            if seen.lost and seen.tracked_ns is not None:
                without_s = (instant_ns - seen.tracked_ns) / S
                self._news.add(Notice(TrackerEvent.BODY_FOUND, seen.tag, without_s))
            seen.tracked_ns, seen.lost = instant_ns, False
            centre = centre_from_tag(*pose, seen.offset)
            found.append(TagPose(seen.tag, 0, 0, *centre, *self._covariance))
        strange = sum(name not in self._seen and name not in self._others for name in bodies)
        return tuple(found), strange

    def _moves(self, seen: _Seen, body: Body) -> bool:
        """Return whether a pose is a new measurement: some systems repeat the last one of a body that they lost."""
        seen.repeats = seen.repeats + 1 if body == seen.last else 0
        seen.last = body
        return not self._noisy or seen.repeats < _MOST_REPEATS

    def _miss(self, seen: _Seen, instant_ns: int) -> None:
        if not seen.lost and seen.tracked_ns is not None and instant_ns - seen.tracked_ns >= _LOST_AFTER_NS:
            seen.lost = True
            self._news.add(Notice(TrackerEvent.BODY_LOST, seen.tag, (instant_ns - seen.tracked_ns) / S))

"""Every distance that is kept, each derived from the one before it. Pure.

From a body to another one, to an obstacle, and to the edge of the floor, for a GTernal with the default settings:

=====================  =====  =========================================================================================
what                   [mm]   from
=====================  =====  =========================================================================================
``CLOSEST_M``            5    monitor: two bodies so near are too close, whatever the poses' errors (2 mm each) hide
``least_room_m``        10    arming, on the spot: what a faulty robot takes until it is stopped (``wiggle.room_m``,
                              then 3 mm), and the pose's error
``gap_m``               10    barrier, in truth: what is asked for, at least what arming needs beyond the pose's error
``apart_at_rest``       14    barrier, by the poses: ``gap_m`` and both poses' errors; 12 from an obstacle or an edge
``room_m``              44    arming, along an arc: as on the spot, of the faster and longer stroke
``apart``               57    planning: ``apart_at_rest`` and how far a robot at top speed is believed to go that stands
=====================  =====  =========================================================================================

So robots that the barrier has brought to rest can be armed again where they stand, whatever stopped them. The barrier
and planning hold a point ``ahead`` in front of the axle, and their distances are between such points.
"""

from dataclasses import dataclass
from typing import NamedTuple

from robofleet.safety import wiggle
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.solids import Solid

CLOSEST_M = 0.005
_POSE_ERROR_M = 0.002  # of one that stands
_STOP_M = 0.003  # from the image that shows it, 100 ms old, to rest; tests/safety/test_arming.py measures it
_MARGIN_M = 0.01  # the same along an arc, which is five times as fast


@dataclass(frozen=True)
class Keepout:
    """What the barrier keeps."""

    gap: float  # between two bodies, and from obstacles and edges [m]
    ahead: float  # of the point q in front of the axle [m]
    rate: float  # gamma: how fast a distance may be used up [1/s]
    pose_error: float  # of an estimated pose [m]
    age: float  # of the newest image at a tick, at most [s]
    lost_after: float  # then a robot that is not seen is made to stand [s]
    point_ahead: float  # l: of the point whose velocity is changed least [m]
    tick: float  # control step [s]
    arena: tuple[float, float]  # size [m]
    solids: tuple[Solid, ...] = ()  # obstacles, and what lies outside a floor that is a polygon


class Body(NamedTuple):
    """One robot: its drive, its disc [m], and from a tick to when its command acts [s]."""

    drive: DifferentialDrive
    radius: float
    delay: float


def least_room_m(wheel_radius: float) -> float:
    """Return the room that a robot must have around its body to be tried on the spot [m]."""
    return wiggle.room_m(wheel_radius, wiggle.LEFT) + _STOP_M + _POSE_ERROR_M


def room_m(wheel_radius: float) -> float:
    """Return the room that a robot must have around its body to be tried along an arc [m]."""
    return wiggle.room_m(wheel_radius) + _MARGIN_M


def apart_at_rest(keepout: Keepout, first: Body, other: Body) -> float:
    """Return the least distance of the points q of two robots that stand [m]."""
    return first.radius + other.radius + keepout.gap + 2 * (keepout.ahead + keepout.pose_error)


def from_edge(keepout: Keepout, body: Body) -> float:
    """Return the least distance of a robot's point q from an obstacle, and from the edge of the floor [m]."""
    return body.radius + keepout.gap + keepout.ahead + keepout.pose_error


def apart(keepout: Keepout, first: Body, other: Body) -> float:
    """Return D: the least distance of two robots' points q, one of which has its top speed [m]."""
    believed = max(b.drive.max_speed * believed_for(keepout, b) for b in (first, other))
    return apart_at_rest(keepout, first, other) + believed


def believed_for(keepout: Keepout, body: Body) -> float:
    """Return for how long a robot is believed to drive that in truth stands [s]."""
    return keepout.age + body.delay + body.drive.motor_lag

"""A wheel that turns by itself: its output is zero, and it does not come to rest. Pure.

Encoders tell it at the driver, poses at the supervisor where a robot has none. Both wait, since three things look like
it for a while: a wheel that comes to rest (a motor's lag, 0.25 s from top speed), a reading that is old because the
line was cut (0.5 s, then the driver says so), and a hand that nudges a robot. What turned all the time, without one
moment of rest, is none of these. Who pushes a robot on for longer is taken for a motor: nobody can tell.
"""

import math
from typing import NamedTuple

from robofleet.safety.view import NEVER, RobotView

_MS = 1_000_000

TURNING_RAD_S = 0.5  # 8 mm/s of the smallest wheels; a count that flickers, in means over 0.1 s, is a third of it
RESTS_WITHIN_NS = 800 * _MS  # a lag from top speed, and a reading as old as one may be
HEARD_WITHIN_NS = 100 * _MS  # 10 loops of a driver: who did not look did not see the wheel all the time

WINDOW_NS = 250 * _MS
WINDOWS = 4  # in a row: a second
ROLLED_M = 0.005  # in a window, of the body's middle or its edge: 20 mm/s, ten times what poses' noise makes of rest
_SIDEWAYS_M, _SIDEWAYS = 0.003, 0.2  # a wheel rolls along its robot's heading; a hand that carries a robot does not


def turning_since_ns(since_ns: int, looked_ns: int, commanded: bool, measured: float, now_ns: int) -> int:
    """Return since when a wheel turns that is commanded to stand; the present where none does [driver's clock, ns].

    Args:
        since_ns: What was returned when that was looked at last.
        looked_ns: When it was.
        commanded: Whether a wheel is commanded to turn.
        measured: Speed of the faster wheel, as measured [rad/s].
        now_ns: The present.
    """
    continuous = looked_ns <= now_ns <= looked_ns + HEARD_WITHIN_NS
    if commanded or not abs(measured) > TURNING_RAD_S or not continuous:
        return now_ns
    return since_ns


def runs(since_ns: int, now_ns: int) -> bool:
    """Return whether a wheel that turns since then turns by itself."""
    return now_ns - since_ns >= RESTS_WITHIN_NS


class Rolling(NamedTuple):
    """How a robot without encoders moved while it was told to stand, by the images in which it was seen."""

    seen_ns: int = NEVER  # the image at which this window begins [supervisor's clock]
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in it
    windows: int = 0  # before, each with a motion the same way; below 0: backwards, or clockwise on the spot

    @property
    def runs(self) -> bool:
        """Whether a wheel turns by itself."""
        return abs(self.windows) >= WINDOWS


def counts(robot: RobotView) -> bool:
    """Whether the encoders of a robot, or of a row, have counted anything."""
    return robot.left_angle != 0.0 or robot.right_angle != 0.0 or robot.left_speed != 0.0 or robot.right_speed != 0.0


def is_seen_standing(robot: RobotView) -> bool:
    """Whether a robot, or a row, is seen and told to stand."""
    return robot.left_output == 0.0 and robot.right_output == 0.0 and robot.seen_ns != NEVER


def watch(before: Rolling, robot: RobotView, radius: float) -> Rolling:
    """Return what the newest view adds; ``radius`` of the body [m]."""
    if counts(robot) or not is_seen_standing(robot):
        return Rolling()
    since_ns = robot.seen_ns - before.seen_ns
    if before.seen_ns == NEVER or not 0 <= since_ns < 2 * WINDOW_NS:
        return Rolling(robot.seen_ns, robot.pose)
    if since_ns < WINDOW_NS:
        return before
    way = _way(before.pose, robot.pose, radius)
    onward = before.windows if before.windows * way > 0 else 0
    return Rolling(robot.seen_ns, robot.pose, onward + way)


def _way(before: tuple[float, float, float], after: tuple[float, float, float], radius: float) -> int:
    """Return which way a robot rolled between two poses: 1, -1, or 0 where it did not."""
    turn = math.remainder(math.remainder(after[2], math.tau) - math.remainder(before[2], math.tau), math.tau)
    heading = before[2] + turn / 2.0
    x, y = after[0] - before[0], after[1] - before[1]
    ahead = x * math.cos(heading) + y * math.sin(heading)
    aside = y * math.cos(heading) - x * math.sin(heading)
    edge = radius * turn
    furthest = ahead if abs(ahead) >= abs(edge) else edge
    if not abs(furthest) >= ROLLED_M or abs(aside) > _SIDEWAYS_M + _SIDEWAYS * abs(ahead):
        return 0
    return 1 if furthest > 0.0 else -1

"""A wheel that turns by itself: faster than it is commanded, or the other way, for longer than any lag. Pure.

Encoders tell it at the driver, poses at the supervisor where a robot has none. Both wait, since three things look like
it for a while: a wheel that slows down (a motor's lag, 0.25 s from top speed), a reading that is old because the
line was cut (0.5 s, then the driver says so), and a hand that nudges a robot. What was too fast all the time, the same
way, is none of these. A wheel that is slower than commanded does not turn by itself: it saturates, sticks, or stalls.
Who pushes a robot on for longer is taken for a motor: nobody can tell.
"""

import math
from typing import NamedTuple

from robofleet.safety.view import NEVER, RobotView

_MS = 1_000_000

FASTER = 1.375  # than commanded, with TURNING_RAD_S: the wiggle lets an encoder pass that counts 1.35 times too much
TURNING_RAD_S = 0.5  # 8 mm/s of the smallest wheels; a count that flickers, in means over 0.1 s, is a third of it
RESTS_WITHIN_NS = 800 * _MS  # a lag from top speed, and a reading as old as one may be
HEARD_WITHIN_NS = 100 * _MS  # 10 loops of a driver: who did not look did not see the wheel all the time

WINDOW_NS = 250 * _MS
WINDOWS = 4  # in a row: a second
ROLLED_M = 0.005  # in a window, of the body's middle or its edge: 20 mm/s, ten times what poses' noise makes of rest
_SIDEWAYS_M, _SIDEWAYS = 0.003, 0.2  # a wheel rolls along its robot's heading; a hand that carries a robot does not


def direction(output: float, measured: float) -> int:
    """Return which way a wheel turns that does not obey, 1 or -1; 0 if it does, as commanded and measured [rad/s]."""
    if measured > FASTER * max(0.0, output) + TURNING_RAD_S:
        return 1
    return -1 if measured < FASTER * min(0.0, output) - TURNING_RAD_S else 0


def turning_since_ns(since_ns: int, looked_ns: int, before: int, after: int, now_ns: int) -> int:
    """Return since when a wheel turns by itself; the present where it does not [driver's clock, ns].

    Args:
        since_ns: What was returned when that was looked at last.
        looked_ns: When it was.
        before: Its direction then.
        after: Its direction now.
        now_ns: The present.
    """
    continuous = looked_ns <= now_ns <= looked_ns + HEARD_WITHIN_NS
    return since_ns if after and after != -before and continuous else now_ns


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

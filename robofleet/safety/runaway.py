"""A wheel that does not obey: it turns by itself (faster than commanded, or the other way), or hardly turns. Pure.

Encoders tell it at the driver, poses at the supervisor where a robot has none. Both wait for longer than any lag, since
three things look like a wheel that turns by itself for a while: one that slows down (a motor's lag, 0.25 s from top
speed), a reading that is old because the line was cut (0.5 s, then the driver says so), and a hand that nudges a robot.
What was too fast all the time, the same way, is none of these. A wheel that is slower than commanded does not turn by
itself: it saturates, sticks, or stalls. Who pushes a robot on for longer is taken for a motor: nobody can tell.
"""

import math
from typing import NamedTuple

from robofleet.safety.rolled import Wheels, rolled
from robofleet.safety.view import NEVER, RobotView

_MS = 1_000_000

FASTER = 1.375  # than commanded, with TURNING_RAD_S: the wiggle lets an encoder pass that counts 1.35 times too much
TURNING_RAD_S = 0.5  # 8 mm/s of the smallest wheels; a count that flickers, in means over 0.1 s, is a third of it
RESTS_WITHIN_NS = 800 * _MS  # a lag from top speed, and a reading as old as one may be
HEARD_WITHIN_NS = 100 * _MS  # 10 loops of a driver: who did not look did not see the wheel all the time

STALLED_RAD_S = 2.0  # of a command: three times what a wheel of the worst shipped robot needs to start from rest
SLOWER = 0.625  # than commanded, less TURNING_RAD_S, and it is stalled: a low battery takes a tenth

WINDOW_NS = 250 * _MS
WINDOWS = 4  # in a row: a second
ROLLED_M_S = 0.02  # of a wheel's tread, more than commanded: ten times what poses' noise makes of rest
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


def stalls(output: float, measured: float) -> bool:
    """Return whether a wheel stands, or turns much slower than it is commanded [rad/s]."""
    ahead = measured if output > 0.0 else -measured
    return abs(output) >= STALLED_RAD_S and ahead <= SLOWER * abs(output) - TURNING_RAD_S


class Rolling(NamedTuple):
    """How the wheels of a robot without encoders obey, by the images in which it was seen.

    A wheel obeys if it rolls as what was commanded in this window or in the one before: lags and images are younger
    than that.
    """

    seen_ns: int = NEVER  # the image at which this window begins [supervisor's clock]
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0)  # in it
    output_angles: Wheels = (0.0, 0.0)  # the gate's outputs, added up until then [rad]
    commanded: Wheels = (0.0, 0.0)  # mean of the window before [rad/s]
    by_itself: tuple[int, int] = (0, 0)  # windows before, each with a motion the same way; below 0: backwards
    stalled: tuple[int, int] = (0, 0)  # windows before in which the wheel was much too slow

    @property
    def runs(self) -> bool:
        """Whether a wheel turns by itself."""
        return max(map(abs, self.by_itself)) >= WINDOWS

    @property
    def stands(self) -> bool:
        """Whether a wheel stands, or turns much slower than it is commanded."""
        return max(self.stalled) >= WINDOWS


def counts(robot: RobotView) -> bool:
    """Whether the encoders of a robot, or of a row, have counted anything."""
    return robot.left_angle != 0.0 or robot.right_angle != 0.0 or robot.left_speed != 0.0 or robot.right_speed != 0.0


def watch(before: Rolling, robot: RobotView, radius: float, base: float) -> Rolling:
    """Return what the newest view adds; radius of its wheels and base [m]."""
    if counts(robot) or robot.seen_ns == NEVER:
        return Rolling()
    x, y, psi = robot.pose
    pose, angles = (x, y, math.remainder(psi, math.tau)), (robot.left_told, robot.right_told)
    since_ns = robot.seen_ns - before.seen_ns
    if before.seen_ns == NEVER or not 0 <= since_ns < 2 * WINDOW_NS:
        return Rolling(robot.seen_ns, pose, angles)
    if since_ns < WINDOW_NS:
        return before
    since_s = since_ns / 1e9
    left, right = ((now - then) / since_s for now, then in zip(angles, before.output_angles, strict=True))
    speeds = [wheel / since_s for wheel in rolled(before.pose, pose, radius, base)]
    by_hand = _is_carried(before.pose, pose)
    wheels = [
        _obeying(*of_wheel, ROLLED_M_S / radius, by_hand)
        for of_wheel in zip((left, right), before.commanded, speeds, before.by_itself, before.stalled, strict=True)
    ]
    (left_runs, left_stalls), (right_runs, right_stalls) = wheels
    return Rolling(robot.seen_ns, pose, angles, (left, right), (left_runs, right_runs), (left_stalls, right_stalls))


def _obeying(
    commanded: float, before: float, measured: float, by_itself: int, stalled: int, slack: float, by_hand: bool
) -> tuple[int, int]:
    """Return in how many windows in a row a wheel turned by itself, and in how many it was stalled."""
    fastest, slowest = max(commanded, before, 0.0), min(commanded, before, 0.0)
    way = 0
    if not by_hand and measured >= FASTER * fastest + slack:
        way = 1
    if not by_hand and measured <= FASTER * slowest - slack:
        way = -1
    slow = not way and stalls(commanded, measured) and stalls(before, measured)
    return way + (by_itself if by_itself * way > 0 else 0), stalled + 1 if slow else 0


def _is_carried(before: tuple[float, float, float], after: tuple[float, float, float]) -> bool:
    """Return whether a robot was moved across its heading, as no wheel moves it."""
    heading = before[2] + math.remainder(after[2] - before[2], math.tau) / 2.0
    x, y = after[0] - before[0], after[1] - before[1]
    ahead = x * math.cos(heading) + y * math.sin(heading)
    aside = y * math.cos(heading) - x * math.sin(heading)
    return abs(aside) > _SIDEWAYS_M + _SIDEWAYS * abs(ahead)

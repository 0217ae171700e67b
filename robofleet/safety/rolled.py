"""What one stroke shows: which wheel the driver turns, in which direction, and how far it rolls.

Turn and travel of the tag give what each wheel rolled; the wheels were asked for unequal shares, so that no two faults
look alike.

Tolerances. A healthy robot rolls 0.96 to 1.03 of what its encoders count (3 % of spread, slip), the mean of its wheels;
one with a wheel radius 20 % off, either way, less than 0.86 or more than 1.15. Poses with 0.3 mm and 4 mrad of noise,
three to a standing, give that mean to 1.1 % (one sigma): 12 % from 1 is off by 8 sigmas in health, and a robot that
is worn by a tenth, which an offset-free controller copes with, may pass. One wheel's
own ratio is known to 1.9 %, hence 13 %.
"""

import math
from typing import NamedTuple

from robofleet.safety.supervisor import Event

Pose = tuple[float, float, float]  # x, y [m], psi [rad]; world
Wheels = tuple[float, float]  # left, right
Diagnosis = tuple[Event, float]  # and its detail

_MEAN_GAIN, _WHEEL_GAIN = 0.12, 0.13
_UNCOUNTED_GAIN = 0.15  # without encoders, from what was asked, which is known to a few percent
_ENCODER_GAIN = 0.35  # what is counted over what was asked


class Leg(NamedTuple):
    """One stroke: what each wheel was asked for, what it counted (0 without encoders), what it rolled [rad]."""

    commanded: Wheels
    counted: Wheels
    rolled: Wheels


def rolled(before: Pose, after: Pose, radius: float, base: float) -> Wheels:
    """Return what each wheel rolled if the robot went along an arc [rad]; wheel radius and base [m]."""
    turn = math.remainder(after[2] - before[2], math.tau)
    heading, half = before[2] + turn / 2.0, turn / 2.0
    chord = (after[0] - before[0]) * math.cos(heading) + (after[1] - before[1]) * math.sin(heading)
    arc = chord * (half / math.sin(half) if half else 1.0)
    return (arc - base * half) / radius, (arc + base * half) / radius


def mean_of(forth: Leg, back: Leg) -> Leg:
    """Return both strokes as one forwards: what they share is measured twice."""
    return Leg(*(((f[0] - b[0]) / 2.0, (f[1] - b[1]) / 2.0) for f, b in zip(forth, back, strict=True)))


def wiring_fault(leg: Leg) -> Diagnosis | None:
    """Return the fault between the driver and the floor that explains best what was rolled."""
    l, r = leg.commanded
    explanations = (
        (Event.NOTHING, (l, r)),
        (Event.DID_NOT_MOVE, (0.0, r)),  # the nearest one too if neither wheel rolled
        (Event.DID_NOT_MOVE, (l, 0.0)),
        (Event.LEFT_REVERSED, (-l, r)),
        (Event.RIGHT_REVERSED, (l, -r)),
        (Event.BOTH_REVERSED, (-l, -r)),
        (Event.WHEELS_SWAPPED, (r, l)),
        (Event.WHEELS_SWAPPED, (-r, l)),
        (Event.WHEELS_SWAPPED, (r, -l)),
        (Event.WHEELS_SWAPPED, (-r, -l)),
    )
    event, _ = min(explanations, key=lambda explanation: math.dist(explanation[1], leg.rolled))
    if event:
        return event, 0.0
    ratio = _furthest(leg.counted, leg.commanded)
    return (Event.ENCODER_WRONG, ratio) if any(leg.counted) and abs(ratio - 1.0) > _ENCODER_GAIN else None


def gain_fault(leg: Leg) -> Diagnosis | None:
    """Return that the robot, or one of its wheels, rolls another distance than believed."""
    counts = any(leg.counted)
    expected = leg.counted if counts else leg.commanded
    along = sum(math.copysign(1.0, b) * a for a, b in zip(leg.rolled, expected, strict=True))  # each as it was told
    mean, furthest = along / sum(map(abs, expected)), _furthest(leg.rolled, expected)
    if abs(mean - 1.0) > (_MEAN_GAIN if counts else _UNCOUNTED_GAIN):
        return Event.WRONG_GAIN, mean
    return (Event.WRONG_GAIN, furthest) if abs(furthest - 1.0) > (_WHEEL_GAIN if counts else _UNCOUNTED_GAIN) else None


def _furthest(wheels: Wheels, expected: Wheels) -> float:
    """Return the ratio that is furthest from 1, of the wheels of which anything is expected."""
    ratios = (a / b for a, b in zip(wheels, expected, strict=True) if b)
    return max(ratios, key=lambda ratio: abs(ratio - 1.0), default=1.0)

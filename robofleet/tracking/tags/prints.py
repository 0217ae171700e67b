"""Names prints that are off, as far as their learnt shapes (``shape.py``) say so for certain: stretched, bowed, of
another size.

A tag that is higher appears larger, by its way up over the way to the camera; so does a larger print. One camera cannot
tell the two apart, whatever the robot does. So a size is told as a height, and only where it is more than the print's
side can be wrong by; two cameras that see the robot tell the height itself (``filter/parallax.py``).
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.tags.shape import BOW, SHEAR, SIZE, STRETCH, Shapes
from robofleet.tracking.tags.targets import Target

_STRETCHED = 0.0015  # [share] that is named: it turns a heading by no more than the noise
_BOWED_M = 0.0003  # likewise
_HIGHER_M = 0.003  # of which a tenth is certain enough, where the side is exact
_CERTAIN = 0.1  # largest standard deviation of what is named, over it
_OTHERWISE = 0.2  # it is named again where it changed by so much
_QUARTER = 0.25  # a bow over the side, in the curvature a^2 [sides]


class _Measure(NamedTuple):
    """How far a print is off."""

    event: TrackerEvent
    value: float
    sigma: float
    expected: float  # size of what is worth a notice
    limit: float  # beyond which it is named


class PrintMonitor:
    """Says what is off about each target's print: once, and again where that changes, or is known better by a third."""

    def __init__(self, shapes: Shapes, targets: Sequence[Target], camera_height_m: float) -> None:
        self._shapes, self._targets, self._camera_height_m = shapes, targets, camera_height_m
        self._named: dict[tuple[TrackerEvent, int], _Measure] = {}

    def forget(self, i: int) -> None:
        """Name a target's print anew: it may be another."""
        self._named = {key: value for key, value in self._named.items() if key[1] != i}

    def news(self, i: int) -> Iterator[tuple[TrackerEvent, float]]:
        """Yield what is new about a target's print, and by how much it is off."""
        for measure in self._measures(i):
            size, before = abs(measure.value), self._named.get((measure.event, i))
            certain = measure.sigma < _CERTAIN * max(size, measure.expected)
            if size > measure.limit and certain and (before is None or _is_news(measure, before)):
                self._named[measure.event, i] = measure
                yield measure.event, measure.value

    def _measures(self, i: int) -> Iterator[_Measure]:
        shape, sigma, target = self._shapes.values[i], np.sqrt(np.diag(self._shapes.spreads[i])), self._targets[i]
        stretch = math.copysign(2.0 * math.hypot(shape[STRETCH], shape[SHEAR]), shape[STRETCH])
        doubt = 2.0 * max(sigma[STRETCH], sigma[SHEAR])
        yield _Measure(TrackerEvent.PRINT_STRETCHED, stretch, doubt, _STRETCHED, _STRETCHED)
        a, b, twist = shape[BOW:]
        most = math.copysign(abs(a + b) / 2.0 + math.hypot((a - b) / 2.0, twist / 2.0), a + b)
        over = _QUARTER * target.whole
        yield _Measure(TrackerEvent.TAG_BOWED, over * most, over * max(sigma[BOW:]), _BOWED_M, _BOWED_M)
        away = self._camera_height_m - target.height
        higher = away * (1.0 - 1.0 / (1.0 + shape[SIZE]))
        larger = abs(stretch) if abs(stretch) > _STRETCHED else 0.0  # what stretched it may have made it larger, too
        limit = away * (target.side_tolerance / target.side + larger)
        yield _Measure(TrackerEvent.TAG_SIZE, higher, away * sigma[SIZE], _HIGHER_M, limit)


def _is_news(measure: _Measure, before: _Measure) -> bool:
    changed = abs(measure.value - before.value) > max(_OTHERWISE * abs(before.value), 3.0 * measure.sigma)
    return changed or measure.sigma < 0.7 * before.sigma

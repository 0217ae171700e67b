"""Encoder counts of a ros_arduino_bridge: commanded counts with their rounding, and measured counts."""

from collections import deque
from typing import NamedTuple

from robofleet.vehicles.interface import STOP, WheelSpeeds

_SPEED_NS = 100_000_000  # over which speeds are means: with 2000 counts a turn, one of them is 0.03 rad/s


class Rounding:
    """One wheel's counts per frame, whole, such that in the long run it turns as far as it was told to."""

    def __init__(self) -> None:
        self._speed, self._given, self._owed = 0.0, 0, 0.0

    def __call__(self, speed: float, frames: float) -> int:
        """Return the counts to send for ``speed``, ``frames`` of the speed loop after the last call (1 at most)."""
        self._owed += frames * (self._speed - self._given)
        self._speed, self._given = speed, round(speed + self._owed) if speed else 0
        return self._given


class _Sample(NamedTuple):
    at_ns: int
    counts: tuple[int, int]  # left, right; 32 bits
    turned: tuple[int, int]  # since the first ones [counts]


class Encoders:
    """What the wheels have turned, from counts that may be wrong, and that a wrong letter may have set to 0."""

    def __init__(self, counts_per_rad: float, max_wheel_speed: float) -> None:
        self._counts_per_rad, self._fastest = counts_per_rad, 2.0 * max_wheel_speed
        self._samples: deque[_Sample] = deque()
        self._doubted: _Sample | None = None

    @property
    def at_ns(self) -> int:
        """When the newest counts were asked for that can be true."""
        return self._samples[-1].at_ns

    @property
    def angles(self) -> WheelSpeeds:
        """Turned since the first counts [rad]."""
        left, right = self._samples[-1].turned
        return WheelSpeeds(left / self._counts_per_rad, right / self._counts_per_rad)

    @property
    def speeds(self) -> WheelSpeeds:
        """Mean over the last tenth of a second [rad/s]."""
        first, last = self._samples[0], self._samples[-1]
        if last.at_ns == first.at_ns:
            return STOP
        per_count = 1e9 / (self._counts_per_rad * (last.at_ns - first.at_ns))
        left, right = (now - then for now, then in zip(last.turned, first.turned, strict=True))
        return WheelSpeeds(left * per_count, right * per_count)

    def take(self, at_ns: int, left: int, right: int) -> None:
        """Take counts, unless no wheel can have turned so far; two that fit each other are believed."""
        if not self._samples:
            self._samples.append(_Sample(at_ns, (left, right), (0, 0)))
            return
        last = self._samples[-1]
        new = _Sample(at_ns, (left, right), last.turned)
        moves = self._moves(last, new)
        if moves is None and self._doubted is not None:
            moves = self._moves(self._doubted, new)
        if moves is None:
            self._doubted = new
            return
        self._doubted = None
        self._samples.append(new._replace(turned=(last.turned[0] + moves[0], last.turned[1] + moves[1])))
        while self._samples[1].at_ns <= at_ns - _SPEED_NS:
            self._samples.popleft()

    def _moves(self, before: _Sample, after: _Sample) -> tuple[int, int] | None:
        """Return how far the wheels have turned between them [counts]; None: no wheel can."""
        left, right = (_wrapped(b - a) for a, b in zip(before.counts, after.counts, strict=True))
        reach = 2.0 + self._fastest * self._counts_per_rad * (after.at_ns - before.at_ns) * 1e-9
        return (left, right) if max(abs(left), abs(right)) <= reach else None


def _wrapped(difference: int) -> int:
    """Return a difference of two integers of 32 bits."""
    return (difference + 0x80000000) % 0x100000000 - 0x80000000

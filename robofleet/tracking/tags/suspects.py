"""Prints that read as a tag but lie where that tag cannot be; decides which of them are accepted in the end."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robofleet.core.clock import S
from robofleet.tracking.tags.photometric import Found
from robofleet.tracking.tags.targets import Target

SAME = 0.5  # two places closer than this are of one print [sides]
_PATIENCE = 2  # after so many sightings, about a sweep apart, a print is believed,
_PATIENCE_NS = 3 * S  # and of a tag that was known, after so long: the run has ended by then
_DOUBT_NS = 10 * S  # without a second print, until one of a tag that had one is believed
_KICKED = 2.5  # a tag that lies still is believed so far from where it lay: who watches the camera judges it [sides]
_SLIP = 1.5  # a robot may be faster than its limit: pushed, downhill, a worn wheel


@dataclass
class _Suspect:
    centre: complex
    seen_ns: int
    sweep: float  # of the newest sighting that counted
    sightings: int = 0
    second: bool = False  # it was seen while the tag itself was seen elsewhere: never believed


class Suspects:
    """One print a tag: the newest."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self._same = SAME * np.array([target.side for target in targets])
        self._near = [(_KICKED if target.max_speed == 0.0 else SAME) * target.side for target in targets]
        self._drives_on_ns = [round(target.drives_on_s * S) for target in targets]
        self._speeds = _SLIP * np.array([target.max_speed for target in targets])
        self._suspects: dict[int, _Suspect] = {}
        self._displaced: set[int] = set()
        self._doubted_ns: dict[int, int] = {}  # when a tag was seen twice last, and nothing told which one it is

    def reach(self, target: int, elapsed_ns: int) -> float:
        """Return how far a tag can be from where it was a while ago [m]; below 0 if nothing is known of it any more."""
        if target in self._doubted_ns:
            return -1.0
        return self._near[target] if target in self._displaced else self._range(target, elapsed_ns)

    def same(self, tag: Found, centre: complex) -> bool:
        return bool(abs(tag.centre - centre) < self._same[tag.target])

    def cleared(self, target: int) -> None:
        """Forget a print that was only waiting: the tag itself was found."""
        self._displaced.discard(target)
        self._doubted_ns.pop(target, None)
        suspect = self._suspects.get(target)
        if suspect is not None and not suspect.second:
            del self._suspects[target]

    def doubt(self, target: int, now_ns: int) -> None:
        """Note that there are two prints of a tag, and either may be it."""
        self._doubted_ns[target] = now_ns
        self._suspects.pop(target, None)

    def displaced(self, target: int) -> None:
        """Note that a tag stands where another one was expected: they were exchanged, and it did not drive there."""
        self._displaced.add(target)

    def second(self, tag: Found, now_ns: int) -> None:
        """Remember a second print: the tag itself is seen elsewhere."""
        self._suspects[tag.target] = _Suspect(tag.centre, now_ns, 0.0, second=True)

    def is_second(self, tag: Found, now_ns: int) -> bool:
        """Return whether this is a print that was a second one before; it may have moved since."""
        suspect = self._suspects.get(tag.target)
        if suspect is None or not suspect.second or not self._follows(suspect, tag, now_ns):
            return False
        suspect.centre, suspect.seen_ns = tag.centre, now_ns
        return True

    def rival(self, tag: Found, now_ns: int) -> complex | None:
        """Return where another print of the same tag was seen lately that cannot be this one."""
        suspect = self._suspects.get(tag.target)
        return None if suspect is None or self._follows(suspect, tag, now_ns) else suspect.centre

    def sighted(self, tag: Found, now_ns: int, sweep: float, hidden_ns: int | None) -> bool:
        """Count a sighting; true when there were enough, and no other print in between.

        hidden_ns: since the tag was measured; None for one that never was.
        """
        suspect = self._suspects.get(tag.target)
        if suspect is None or not self._follows(suspect, tag, now_ns):
            suspect = self._suspects[tag.target] = _Suspect(tag.centre, now_ns, sweep - 1.0)
        suspect.centre, suspect.seen_ns = tag.centre, now_ns
        if sweep - suspect.sweep > 0.5:  # tiles overlap: one print is seen in two of a sweep
            suspect.sweep = sweep
            suspect.sightings += 1
        doubted_ns = self._doubted_ns.get(tag.target)
        if doubted_ns is not None and now_ns - doubted_ns < _DOUBT_NS:
            return False
        return suspect.sightings > _PATIENCE and (hidden_ns is None or hidden_ns > _PATIENCE_NS)

    def _follows(self, suspect: _Suspect, tag: Found, now_ns: int) -> bool:
        return abs(tag.centre - suspect.centre) <= self._range(tag.target, now_ns - suspect.seen_ns)

    def _range(self, target: int, elapsed_ns: int) -> float:
        """Return how far a print can have been driven in a while [m]."""
        return float(
            self._speeds[target] * min(max(elapsed_ns, 0), self._drives_on_ns[target]) * 1e-9 + self._near[target]
        )

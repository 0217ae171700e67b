"""What the figures of a run need of every tick, message and image: sums, extremes, counts and delays, which add up.

So a long run is looked at part by part, and its figures are those of all ticks.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array

_MOST_VALUES = 1 << 18  # different ones: more durations lie closer together than matters


@dataclass(frozen=True)
class Distribution:
    """The different durations in ascending order [ns], and how many there are of each."""

    values: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(cls, durations_ns: Any) -> "Distribution":
        return cls(*np.unique(np.asarray(durations_ns, np.int64), return_counts=True))

    @classmethod
    def joined(cls, parts: Sequence["Distribution"]) -> "Distribution":
        """Return several together; too many different durations are rounded down to multiples of a power of two."""
        values = np.concatenate([part.values for part in parts])
        counts = np.concatenate([part.counts for part in parts])
        order = np.argsort(values, kind="stable")  # it merges what is sorted already
        joined, bits = _merged(values[order], counts[order]), 0
        while len(joined.values) > _MOST_VALUES:
            bits += 1
            joined = _merged(joined.values >> bits << bits, joined.counts)
        return joined

    def __len__(self) -> int:
        return int(self.counts.sum())

    @property
    def largest(self) -> int:
        """The largest duration [ns]; 0 of none."""
        return int(self.values[-1]) if len(self.values) else 0

    def percentiles(self, percents: Sequence[float]) -> NDArray[np.float64]:
        """Return percentiles of at least one duration [ns], between two of them as ``numpy.percentile`` does."""
        ends = np.cumsum(self.counts)
        ranks = np.asarray(percents) / 100 * (ends[-1] - 1)
        low, high = (
            self.values[np.searchsorted(ends, rank, side="right")].astype(np.float64)
            for rank in (np.floor(ranks), np.ceil(ranks))
        )
        return np.asarray(low + ranks % 1 * (high - low))


def _merged(values: NDArray[np.int64], counts: NDArray[np.int64]) -> Distribution:
    """Return a distribution of ascending values that may repeat."""
    first = np.flatnonzero(np.diff(values, prepend=values[:1] - 1))
    return Distribution(values[first], np.add.reduceat(counts, first) if len(first) else counts)


class Moment(NamedTuple):
    """Something that happened."""

    first_ns: int
    last_ns: int  # the same, where it took no time
    who: str
    what: str


class Delays(NamedTuple):
    """How long after mid-exposure: the poses were sent, a tick took them, a command of theirs reached a wheel."""

    poses: Distribution
    tick: Distribution
    wheel: Distribution


class Mean(NamedTuple):
    """Values of which the mean is wanted."""

    total: float = 0.0
    many: int = 0

    @property
    def value(self) -> float | None:
        """The mean; None of nothing."""
        return self.total / self.many if self.many else None


class Images(NamedTuple):
    """What a camera saw."""

    frames: int = 0
    first_ns: int = 0  # mid-exposure
    newest_ns: int = 0
    measured: int = 0  # tags
    members: int = 0  # of those, tags of robots in a group
    strange: int = 0  # tags of nobody, also where they are only predicted
    refused: int = 0  # by the newest image's count


class Counted(NamedTuple):
    """The first and the newest count of something that is counted on."""

    first: int
    newest: int


@dataclass(frozen=True)
class Reduced:
    """A run, or a part of it."""

    begun: bool  # whether the fleet ran in it, or before
    ended_ns: int  # stamp of the newest tick of the run, those of its holds too; 0: it has not begun
    ticks: int
    delays: Delays
    compute: Distribution
    lateness: Distribution
    work: Distribution  # of the trackers, for each image
    overruns: Counted | None
    nearest_m: Array | None  # smallest distance of each pair of bodies (P,), NaN: not known; None: no truth was told
    obstacle_m: float  # smallest distance of a body from an obstacle, NaN: not known; infinite: there is none
    off2: Mean  # squares of the filter's errors [m^2]
    turn2: Mean  # [rad^2]
    off_max_m: float
    saturated: Mean
    measured: Mean
    filtered: Mean
    images: dict[str, Images]  # of each camera
    stops: list[dict[str, Any]]
    moments: list[Moment]
    rejected: list[Counted | None]  # of each robot
    standing: Array  # poses of the bystanders (B, 3), NaN: not known
    peaks: dict[str, list[dict[str, Any]]]  # each group's own figures, of each part


def joined(parts: Sequence[Reduced]) -> Reduced:
    """Return the parts of a run together, which come in order."""
    first = next((k for k, part in enumerate(parts) if part.begun), 0)
    counted = parts[first:]  # what images showed in the checks before does not count
    known = [part.nearest_m for part in parts if part.nearest_m is not None]
    standing = parts[0].standing
    for part in parts:
        standing = np.where(np.isfinite(part.standing), part.standing, standing)
    return Reduced(
        begun=parts[-1].begun,
        ended_ns=max(part.ended_ns for part in parts),
        ticks=sum(part.ticks for part in parts),
        delays=Delays(
            Distribution.joined([part.delays.poses for part in counted]),
            Distribution.joined([part.delays.tick for part in parts]),
            Distribution.joined([part.delays.wheel for part in parts]),
        ),
        compute=Distribution.joined([part.compute for part in parts]),
        lateness=Distribution.joined([part.lateness for part in parts]),
        work=Distribution.joined([part.work for part in counted]),
        overruns=_counted([part.overruns for part in parts]),
        nearest_m=np.minimum.reduce(known) if known else None,
        obstacle_m=float(np.min([part.obstacle_m for part in parts])),
        off2=_mean([part.off2 for part in parts]),
        turn2=_mean([part.turn2 for part in parts]),
        off_max_m=max(part.off_max_m for part in parts),
        saturated=_mean([part.saturated for part in parts]),
        measured=_mean([part.measured for part in parts]),
        filtered=_mean([part.filtered for part in parts]),
        images={name: _seen([part.images[name] for part in counted]) for name in parts[0].images},
        stops=sorted((stop for part in parts for stop in part.stops), key=lambda stop: stop["t_s"]),
        moments=[moment for part in parts for moment in part.moments],
        rejected=[_counted(counts) for counts in zip(*(part.rejected for part in parts), strict=True)],
        standing=standing,
        peaks={name: [own for part in parts for own in part.peaks[name]] for name in parts[0].peaks},
    )


def _mean(parts: Sequence[Mean]) -> Mean:
    return Mean(sum(part.total for part in parts), sum(part.many for part in parts))


def _counted(parts: Sequence[Counted | None]) -> Counted | None:
    known = [part for part in parts if part is not None]
    return Counted(known[0].first, known[-1].newest) if known else None


def _seen(parts: Sequence[Images]) -> Images:
    known = [part for part in parts if part.frames]
    if not known:
        return Images()
    together = (sum(part[k] for part in known) for k in range(len(Images._fields)))
    return Images(*together)._replace(
        first_ns=known[0].first_ns, newest_ns=known[-1].newest_ns, refused=known[-1].refused
    )

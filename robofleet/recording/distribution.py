"""How often each duration was measured: exact percentiles of many integers in little memory."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MOST_VALUES = 1 << 18  # different ones: more durations lie closer together than matters


@dataclass(frozen=True)
class Distribution:
    """The different durations in ascending order [ns], and how many there are of each."""

    values: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(cls, durations_ns: Any) -> "Distribution":
        """Return the distribution of durations."""
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
        """Return how many durations there are."""
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

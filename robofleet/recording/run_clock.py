"""The two clocks of a run, by name: run time and clock time. Both count from the run's first tick.

Run time is what ``run.duration_s`` counts: it stands still while the run is held. Clock time goes on.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.messages import TickRecord
from robofleet.core.arrays import Array
from robofleet.safety.supervisor import Phase

_SAME_S = 0.05  # times that are closer are shown as one


class RunClock(NamedTuple):
    """The run time that belongs to each stamp of the controller's clock."""

    start_ns: int
    stamps_ns: NDArray[Any]  # of ticks of the run (K,)
    run_s: Array  # their run times (K,)
    step_s: float  # of run time from such a tick to the next one

    def clock_time_s(self, stamps_ns: Any) -> Array:
        return np.asarray((np.asarray(stamps_ns) - self.start_ns) / 1e9)

    def run_time_s(self, stamps_ns: Any) -> Array:
        """Return run times; NaN before the start. From one tick of the run to the next, time passes for one step."""
        stamps_ns = np.asarray(stamps_ns)
        if not len(self.stamps_ns):
            return np.full(stamps_ns.shape, np.nan)
        tick = np.searchsorted(self.stamps_ns, stamps_ns, side="right") - 1
        at = np.maximum(tick, 0)
        passed_s = np.minimum((stamps_ns - self.stamps_ns[at]) / 1e9, self.step_s)
        next_s = np.append(self.run_s[1:], np.inf)[at]
        return np.asarray(np.where(tick < 0, np.nan, np.minimum(self.run_s[at] + passed_s, next_s)))


class LiveClock:
    """The two times of a run that is on, from the ticks as they come. Both stand when it has ended."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._before = False  # a tick before the start was heard
        self._start_ns: int | None = None
        self.run_s: float | None = None  # None: the run has not begun
        self.clock_s: float | None = None  # None also for who came too late to know

    def take(self, record: TickRecord) -> None:
        if record.run_tick >= 0:
            if self._start_ns is None and (self._before or record.run_tick == 0):
                self._start_ns = record.stamp_ns - round(record.run_tick * self._tick_s * 1e9)
            self.run_s = record.run_tick * self._tick_s
        is_on = record.run_tick >= 0 or record.phase == Phase.HOLD
        self._before = self._before or not is_on
        if is_on and self.run_s is not None and self._start_ns is not None:
            self.clock_s = (record.stamp_ns - self._start_ns) / 1e9

    def begin(self) -> None:
        """Begin anew: the run has not started."""
        self._start_ns = self.run_s = self.clock_s = None


def time_words(run_s: float, clock_s: float | None, whole_s: float | None = None) -> str:
    """Return a time of a run: "20.7 s run time", or "20.7 s of 88 s run time" where it is known how long the run takes.

    With the clock time where a hold made it another one.
    """
    same = clock_s is None or abs(clock_s - run_s) < _SAME_S
    whole = "" if whole_s is None else f" of {whole_s:g} s"
    return f"{run_s:.1f} s{whole} run time" + ("" if same else f" ({clock_s:.1f} s clock time)")

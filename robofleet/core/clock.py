"""The only module that reads time. Processes are given a Clock; pure code is given ``t`` and ``dt``.

Instants are integer nanoseconds on a clock that also runs while the machine is suspended. Two hosts' instants are
never compared.
"""

import time
from datetime import UTC, datetime
from typing import Protocol

_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
_TIME_ERROR, _LARGEST_TIMEX = 5, 512  # of adjtimex: what it returns without synchronisation; more than its bytes
_SPIN_NS = 500_000  # the kernel may wake a sleeper this late; the rest is spun

US = 1_000  # [ns]
MS = 1_000_000  # [ns]
S = 1_000_000_000  # [ns]


class Clock(Protocol):
    """Where a process gets its time from."""

    def now_ns(self) -> int:
        """Return this host's instant [ns]."""

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        """Return at ``instant_ns`` or just after; ``precise`` spins through the last half millisecond."""


class WallClock:
    """Real time."""

    def now_ns(self) -> int:
        """Return CLOCK_BOOTTIME [ns]."""
        return time.clock_gettime_ns(_CLOCK)

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        """Sleep to an absolute instant."""
        margin = _SPIN_NS if precise else 0
        while (remaining := instant_ns - self.now_ns() - margin) > 0:
            time.sleep(remaining / S)
        while self.now_ns() < instant_ns:
            pass


class SimulatedClock:
    """A clock that moves only when it is told to. It begins at 0; many fields read 0 as "never"."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """Read the clock.

        Returns:
            The simulated time [ns].
        """
        return self._now_ns

    def advance_to(self, instant_ns: int) -> None:
        """Move the clock forwards.

        Args:
            instant_ns: The new time [ns].

        Raises:
            ValueError: Where it is earlier than the clock's.
        """
        if instant_ns < self._now_ns:
            raise ValueError(f"the clock stands at {self._now_ns} ns and cannot go back to {instant_ns} ns")
        self._now_ns = instant_ns

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        """Do nothing where the time has come: a process in lockstep never waits.

        Args:
            instant_ns: The time [ns].
            precise: Has no effect.

        Raises:
            RuntimeError: Where the time is in the future.
        """
        if instant_ns > self._now_ns:
            raise RuntimeError("a process of a lockstep run tried to wait")


class TickGrid:
    """Fixed instants ``origin + k * period``. An overrun skips to the next one: ticks are never made up in a burst."""

    def __init__(self, origin_ns: int, period_ns: int) -> None:
        self.origin_ns = origin_ns
        self.period_ns = period_ns

    def instant(self, index: int) -> int:
        """Return the instant of a tick [ns]."""
        return self.origin_ns + index * self.period_ns

    def index_at(self, now_ns: int) -> int:
        """Return the newest tick that is due at ``now_ns``."""
        return (now_ns - self.origin_ns) // self.period_ns


def from_monotonic(stamp_ns: int) -> int:
    """Return the kernel's stamp on CLOCK_MONOTONIC as an instant of ``WallClock`` [ns]."""
    offsets = []
    for _ in range(3):  # the tightest pair of readings counts: this process may be interrupted between two
        before_ns, now_ns, after_ns = time.monotonic_ns(), time.clock_gettime_ns(_CLOCK), time.monotonic_ns()
        offsets.append((after_ns - before_ns, now_ns - (before_ns + after_ns) // 2))
    return stamp_ns + min(offsets)[1]


def stopwatch_ns() -> int:
    """Return an instant for measuring how long code took, in every mode [ns]."""
    return time.perf_counter_ns()


def processor_ns() -> int:
    """Return how long this thread was on a processor: what other processes take is not in it."""
    return time.thread_time_ns()


def cpu_ns() -> int:
    """Return how long the processors have worked for this process [ns]."""
    return time.process_time_ns()


def epoch_ns() -> int:
    """Return what makes an instant of ``WallClock`` a date: add it, and it counts from 1970 [ns]."""
    return time.time_ns() - time.clock_gettime_ns(_CLOCK)


def utc_now() -> datetime:
    return datetime.now(UTC)


def clock_name() -> str:
    return "CLOCK_BOOTTIME" if hasattr(time, "CLOCK_BOOTTIME") else "CLOCK_MONOTONIC"


def date_is_synchronised() -> bool | None:
    """Return whether something keeps the date right (NTP, say), as the kernel knows it; None: it does not tell."""
    import ctypes  # noqa: PLC0415 - `robofleet stop` is in a hurry

    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_LARGEST_TIMEX))  # all zeros: it changes nothing
    except (AttributeError, OSError):
        return None
    return None if state < 0 else bool(state != _TIME_ERROR)

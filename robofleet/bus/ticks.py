"""Where the controller's ticks fall on this host's clock, without comparing two hosts' stamps."""

from collections import deque

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.keys import TICK
from robofleet.bus.messages import TICK_RECORD

_WINDOW_TICKS = 64  # the least delayed one of them tells


class TickFollower:
    """Follows the controller's ticks by the arrival of their records.

    A record arrives after its tick by the time the bus takes. Over a window the least delayed one gives the grid's
    place on this clock, late by the shortest of these times.
    """

    def __init__(self, bus: Bus, period_ns: int, wake: Wake) -> None:
        self._period_ns = period_ns
        self._ticks = bus.newest(TICK, wake=wake)
        self._run_tick = -1
        self._origins: deque[int] = deque(maxlen=_WINDOW_TICKS)
        self.newest = 0  # number of the newest tick known; 0: none yet
        self.began_ns = 0  # when the newest run began, on the same clock; 0: none has
        self.newest_stamp_ns = 0  # its instant on the CONTROLLER's clock: a simulated trigger line, on one host

    def update(self) -> None:
        payload = self._ticks.take()
        head = None if payload is None else TICK_RECORD.decode_head(payload)
        if head is None:
            return
        tick, run_tick, stamp_ns = head.tick, head.run_tick, head.stamp_ns
        if tick < self.newest:
            self._origins.clear()  # another controller
        self.newest, self.newest_stamp_ns = tick, stamp_ns
        if run_tick >= 0:
            if run_tick < self._run_tick or not self.began_ns:
                self.began_ns = stamp_ns - run_tick * self._period_ns
            self._run_tick = run_tick
        self._origins.append(self._ticks.arrival_ns - tick * self._period_ns)

    def instant(self, tick: int) -> int:
        """Return when a tick falls on this host's clock [ns]."""
        return min(self._origins) + tick * self._period_ns

    def nearest(self, instant_ns: int) -> int:
        """Return the number of the tick nearest to an instant of this host's clock."""
        return round((instant_ns - min(self._origins)) / self._period_ns)

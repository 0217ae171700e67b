"""When a simulated camera exposes: a fixed time before every tick, or by its own clock."""

from typing import Protocol

from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S


class Ticks(Protocol):
    """The controller's newest tick: number, and instant on the one clock of a simulation's host [ns]."""

    newest: int
    newest_stamp_ns: int
    began_ns: int  # the run's first tick; 0: none yet


class Trigger:
    """Gives mid-exposures one after the other; each is given once."""

    def __init__(self, config: Config, ticks: Ticks, clock: Clock) -> None:
        self._ticks = ticks
        self._locked = config.camera.trigger == "tick"
        self._lead_ns = round(config.camera.trigger_lead_s * S)
        self._tick_ns = round(config.controller.tick_s * S)
        self._period_ns = round(S / config.camera.rate_hz)
        self._exposed_tick = 0
        self._pending: tuple[int, int] | None = None  # tick that triggered, mid-exposure [ns]: given, not yet read
        self._next_free_ns = clock.now_ns() + self._period_ns

    def next_ns(self) -> int | None:
        """Return the next mid-exposure [ns]; None while the tick that it follows has not come."""
        if not self._locked:
            return self._next_free_ns
        if self._pending is None and self._ticks.newest != self._exposed_tick:
            exposure_ns = self._ticks.newest_stamp_ns + self._tick_ns - self._lead_ns
            self._pending = self._ticks.newest, exposure_ns
        return None if self._pending is None else self._pending[1]

    def fire(self, now_ns: int) -> None:
        """Go on to the exposure after this one; with a clock of its own, those missed until ``now_ns`` are skipped."""
        if self._pending is not None:
            self._exposed_tick, _ = self._pending
            self._pending = None
        self._next_free_ns += self._period_ns * max(1, (now_ns - self._next_free_ns) // self._period_ns)

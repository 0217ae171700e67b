"""When a simulated camera exposes: a fixed time before every tick, or by its own clock."""

from typing import Protocol

from robofleet.clock import Clock, S
from robofleet.config.tree import Config


class Ticks(Protocol):
    """The controller's newest tick: number, and instant on the one clock of a simulation's host [ns]."""

    newest: int
    newest_stamp_ns: int


class Trigger:
    """Gives mid-exposures one after the other; each is given once."""

    def __init__(self, config: Config, ticks: Ticks, clock: Clock) -> None:
        self._ticks = ticks
        self._locked = config.camera.trigger == "tick"
        self._lead_ns = round(config.camera.trigger_lead_s * S)
        self._tick_ns = round(config.controller.tick_s * S)
        self._period_ns = round(S / config.camera.rate_hz)
        self._exposed_tick = 0
        self._next_free_ns = clock.now_ns() + self._period_ns

    def next_ns(self) -> int | None:
        """Return the next mid-exposure [ns]; None while the tick that it follows has not come."""
        if not self._locked:
            return self._next_free_ns
        if self._ticks.newest <= self._exposed_tick:
            return None
        return self._ticks.newest_stamp_ns + self._tick_ns - self._lead_ns

    def fire(self, now_ns: int) -> None:
        """Go on to the exposure after this one; with a clock of its own, those missed until ``now_ns`` are skipped."""
        self._exposed_tick = self._ticks.newest
        self._next_free_ns += self._period_ns * max(1, (now_ns - self._next_free_ns) // self._period_ns)

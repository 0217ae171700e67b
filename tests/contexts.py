"""What cameras and pose sources are made from."""

from typing import Any

import numpy as np

from robofleet.bus.bus import MemoryBus
from robofleet.bus.ticks import TickFollower
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.tracking.sources import PoseContext


def context(config: Config, clock: Clock, **changes: Any) -> PoseContext:
    """Return the context on a bus in memory where nothing is said; ``changes``: of its fields."""
    bus = changes.get("bus") or MemoryBus(config.arena.name, clock, 0)
    fields: dict[str, Any] = {
        "bus": bus, "ticks": TickFollower(bus, round(config.controller.tick_s * S), lambda _: None),
        "rng": np.random.default_rng(1), "extra_delay_ns": 0, "wake": lambda _: None, "real_time": False,
        "around": lambda feed: feed,
    }  # fmt: skip
    return PoseContext(config=config, clock=clock, **(fields | changes))

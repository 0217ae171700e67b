"""Joins a bus within a time: Zenoh itself would wait for ever for a router that is stopped, or not there."""

import threading
from collections.abc import Callable, Sequence

from robofleet.bus.credentials import Credentials
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.core.clock import Clock, S

_POLL_S = 0.02


def joined(
    arena: str,
    endpoint: str | Sequence[str],
    process: str,
    clock: Clock,
    within_s: float,
    meanwhile: Callable[[], None] | None = None,
    credentials: Credentials | None = None,
) -> ZenohBus:
    """Return the bus, to be closed; TimeoutError where nobody answers. ``meanwhile`` may raise too."""
    buses: list[ZenohBus] = []

    def join() -> None:
        buses.append(ZenohBus(arena, endpoint, process, clock, credentials=credentials))

    joining = threading.Thread(target=join, daemon=True)
    joining.start()
    end_ns = clock.now_ns() + round(within_s * S)
    while not buses and clock.now_ns() < end_ns:
        joining.join(_POLL_S)
        if meanwhile is not None:
            meanwhile()
    if not buses:
        raise TimeoutError(f"nobody answers at {endpoint}")
    return buses[0]

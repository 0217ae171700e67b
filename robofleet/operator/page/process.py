"""The page's process: one of a run, or one that somebody starts by hand beside it."""

import asyncio
import os
import socket
from collections.abc import Callable
from pathlib import Path

from robofleet.bus.bus import Bus
from robofleet.bus.joining import joined
from robofleet.config.tree import Config
from robofleet.core.clock import WallClock
from robofleet.nodes.node import Lifeline
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.ending import STAYS_MIN, Ending
from robofleet.operator.page.page_address import Addresses
from robofleet.operator.page.server import Served, serve
from robofleet.runs.companion import STAYS

_NICE = 5  # the page waits for the run, never the other way round
_EXIT_WITHIN_S = STAYS_MIN * 60.0 + 5.0  # of the run's end, whatever happens
_JOIN_WITHIN_S = 60.0  # the router is the first process of a run


def of_run(
    config: Config, folder: Path, descriptor: int, listening: socket.socket, name: str, keys: PageKeys | None
) -> None:
    """Serve the page that a launcher has started; it stays for as long as somebody looks, ten minutes at most.

    ``name`` is how browsers call this host; ``keys``: None where it is this computer's own.
    """
    os.nice(_NICE)
    clock = WallClock()
    lifeline = Lifeline(descriptor, exit_within_s=_EXIT_WITHIN_S)

    def end_with_the_run() -> None:
        if lifeline.cut:
            raise SystemExit

    bus = joined(config.arena.name, config.bus.endpoint, "web", clock, _JOIN_WITHIN_S, end_with_the_run)
    served = Served(
        config, folder, bus, clock, name, over=lambda: lifeline.cut, keys=keys, line=lambda: lifeline.newest_line,
        stays=lambda: lifeline.say(STAYS),
    )  # fmt: skip
    try:
        with lifeline.logged("web", config.arena.name):
            asyncio.run(serve(served, listening, lambda at: lifeline.ready(at.line()), lambda: lifeline.by_signal))
    finally:
        bus.close()


def by_hand(
    config: Config,
    folder: Path,
    bus: Bus,
    listening: socket.socket,
    name: str,
    keys: PageKeys | None,
    over: Callable[[], bool],
    announce: Callable[[Addresses], str],
) -> Ending:
    """Serve the page of a run that is on until Ctrl-C, or until that run is over and nobody looks."""
    os.nice(_NICE)
    lifeline = Lifeline(None)
    served = Served(config, folder, bus, WallClock(), name, over, keys, by_hand=True)
    return asyncio.run(serve(served, listening, lambda at: lifeline.ready(announce(at)), lambda: lifeline.cut))
